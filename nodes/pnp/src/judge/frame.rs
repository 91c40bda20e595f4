use serde::{Deserialize, Serialize};

/// What is said of a frame: one line of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgedFrame {
    /// Its number in the run.
    pub frame: u64,
    /// BOP scene; 0 where there is none.
    pub scene_id: u32,
    /// BOP image.
    pub image_id: u32,
    /// In the order of the initial poses, all hypotheses of an instance among them.
    pub instances: Vec<JudgedInstance>,
    /// Object and instance of initial poses that could not be rendered.
    pub skipped: Vec<(u32, u32)>,
}

/// One initial pose, and what was made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgedInstance {
    /// BOP object.
    pub object_id: u32,
    /// Number of the instance.
    pub instance: u32,
    /// Confidence of the initial pose, as it came.
    pub score: f64,
    /// `camera_from_object`: unit quaternion x, y, z, w and metres.
    pub initial: ([f64; 4], [f64; 3]),
    /// The crop: x0, y0 (edges) and side, pixels of the camera's image.
    pub crop: [f64; 3],
    /// By the flow of the first network.
    pub before: Judged,
    /// By that of the second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<Judged>,
}

impl JudgedInstance {
    /// Object and instance.
    #[must_use]
    pub fn identity(&self) -> (u32, u32) {
        (self.object_id, self.instance)
    }

    /// How much better the pictures agree with the second network's pose; 0 without a second.
    #[must_use]
    pub fn gain(&self) -> f64 {
        self.after.as_ref().map_or(0.0, |after| after.seen() - self.before.seen())
    }
}

/// A refined pose and what flow and pictures say about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Judged {
    /// Whether PnP found a pose; without one this is the initial pose.
    pub solved: bool,
    /// `camera_from_object`: unit quaternion x, y, z, w and metres.
    pub pose: ([f64; 4], [f64; 3]),
    /// Share of the flow that the pose explains.
    pub inlier_ratio: f64,
    /// Correlation of the rendering with the crop, -1 to 1; 0 where nothing was solved or measured.
    pub photometric: f64,
    /// Contrast across the contour, 0 to 1; 0 where nothing was solved or measured.
    pub silhouette: f64,
}

impl Judged {
    /// How well the pictures agree with the pose, -1 to 2.
    #[must_use]
    pub fn seen(&self) -> f64 {
        self.photometric + self.silhouette
    }

    /// Agreement of flow and pictures, -1 to 3; 0 where nothing was solved.
    #[must_use]
    pub fn agreement(&self) -> f64 {
        if self.solved { self.inlier_ratio + self.photometric + self.silhouette } else { 0.0 }
    }
}
