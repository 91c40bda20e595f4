//! Rectangles of other detectors (`vision_msgs/Detection2DArray`).

use pseudoflow_msgs::Rectangle;
use pseudoflow_msgs::ros::{Detection2D, Naming};

/// Why a detection is no rectangle that can be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RectangleError {
    /// It does not say what it is around.
    #[error("detection `{0}` has no results: the detector must fill results[0] with a class")]
    Empty(String),
    /// An object that is not in the set.
    #[error("class_id `{0}` is no object of the set")]
    UnknownClass(String),
    /// A score that is no number.
    #[error("the score of `{0}` is {1}")]
    Score(String, f64),
    /// A number is not finite or a side not positive.
    #[error("`{class_id}`: {size:?} pixels about {middle:?} is no rectangle")]
    NotARectangle {
        /// What it is around.
        class_id: String,
        /// Middle, pixels.
        middle: [f64; 2],
        /// Width and height, pixels.
        size: [f64; 2],
    },
    /// Nothing of it is in the image.
    #[error("`{class_id}` about {middle:?} lies outside the image")]
    Outside {
        /// What it is around.
        class_id: String,
        /// Middle, pixels.
        middle: [f64; 2],
    },
}

impl RectangleError {
    /// The reason in a word or two, for counting.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Empty(_) => "empty",
            Self::UnknownClass(_) => "unknown object",
            Self::Score(..) => "score",
            Self::NotARectangle { .. } => "rectangle",
            Self::Outside { .. } => "outside",
        }
    }
}

/// The rectangle of a detection in an image of width and height. What reaches beyond the image stays: it is around what is not
/// seen too.
///
/// # Errors
/// When it says nothing that can be used.
pub fn rectangle_of(
    detection: &Detection2D,
    (width, height): (u32, u32),
    naming: &Naming,
) -> Result<Rectangle, RectangleError> {
    let said = detection.results.iter().map(|r| &r.hypothesis).reduce(|a, b| if b.score > a.score { b } else { a });
    let said = said.ok_or_else(|| RectangleError::Empty(detection.id.clone()))?;
    let class_id = || said.class_id.clone();
    let known = naming.object_id(&said.class_id).filter(|id| naming.is_known(*id));
    let object_id = known.ok_or_else(|| RectangleError::UnknownClass(class_id()))?;
    if !said.score.is_finite() {
        return Err(RectangleError::Score(class_id(), said.score));
    }
    let middle = [detection.bbox.center.position.x, detection.bbox.center.position.y];
    let size = [detection.bbox.size_x, detection.bbox.size_y];
    if !(middle.iter().chain(&size).all(|v| v.is_finite()) && size.iter().all(|v| *v > 0.0)) {
        return Err(RectangleError::NotARectangle { class_id: class_id(), middle, size });
    }
    let edge = |k: usize, sign: f64| middle[k] + sign * size[k] / 2.0;
    let inside = |k: usize, all: u32| edge(k, 1.0) > -0.5 && edge(k, -1.0) < f64::from(all) - 0.5;
    if !(inside(0, width) && inside(1, height)) {
        return Err(RectangleError::Outside { class_id: class_id(), middle });
    }
    let [left, top, right, bottom] = [edge(0, -1.0), edge(1, -1.0), edge(0, 1.0), edge(1, 1.0)].map(|v| v as f32);
    Ok(Rectangle { object_id, score: said.score.clamp(0.0, 1.0) as f32, left, top, right, bottom })
}
