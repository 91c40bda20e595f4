use std::fmt;

/// Whether a contour says where an object is, and if not, why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RegionStatus {
    /// It does.
    Ok,
    /// The start has a number that is not finite.
    NotFinite,
    /// The start puts the object behind the camera or outside the image.
    NotInView,
    /// Too little of the contour is in the image and not hidden: the object fills the image, or others hide it.
    NoContour {
        /// Lines that could be read.
        lines: usize,
    },
    /// The object has the colours of what is around it.
    OneColour {
        /// How much of the colours of both sides is the same, 0..1.
        overlap: f32,
    },
}

impl RegionStatus {
    /// Whether the contour says where the object is.
    #[must_use]
    pub fn is_ok(&self) -> bool {
        *self == Self::Ok
    }
}

impl fmt::Display for RegionStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ok => write!(f, "ok"),
            Self::NotFinite => write!(f, "the pose is not finite"),
            Self::NotInView => write!(f, "the object is behind the camera or outside the image"),
            Self::NoContour { lines } => write!(f, "only {lines} contour points are seen"),
            Self::OneColour { overlap } => {
                write!(f, "object and surroundings share {:.0} % of their colours", overlap * 100.0)
            }
        }
    }
}
