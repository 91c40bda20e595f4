//! What goes into a tracker and what comes out.

use crate::evidence::Evidence;
use crate::track::Phase;
use pseudoflow_contour::ContourModel;
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::{Mesh, RgbImage};
use std::fmt;
use std::sync::Arc;

/// An object that can be followed.
#[derive(Debug, Clone)]
pub struct KnownObject {
    /// Its id in the set.
    pub id: u32,
    /// Its mesh.
    pub mesh: Arc<Mesh>,
    /// Its contour from all sides.
    pub contour: ContourModel,
    /// Its diameter, metres.
    pub diameter_m: f64,
}

/// A frame of the camera.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Its number; grows.
    pub index: u64,
    /// Its time, nanoseconds; grows.
    pub stamp_ns: i64,
    /// The pixels.
    pub rgb: &'a RgbImage,
    /// The camera.
    pub intrinsics: Intrinsics,
}

/// Who found a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CorrectionKind {
    /// A search, which knows nothing of the track: rough.
    Found,
    /// The network's look that was asked for.
    Look {
        /// Whether the look was judged better than the pose that it began from, or that pose right.
        accepted: bool,
        /// Probability that the pose of the look is right, 0..1.
        score: f64,
    },
}

/// A pose that others have found in an earlier frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// The object.
    pub object_id: u32,
    /// The frame that it was found in.
    pub frame: u64,
    /// Its pose there.
    pub camera_from_object: Pose,
    /// Who found it.
    pub kind: CorrectionKind,
}

/// An object in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The object.
    pub object_id: u32,
    /// Its pose.
    pub camera_from_object: Pose,
    /// Whether the frame shows it there; else it is only believed to be there.
    pub measured: bool,
    /// Probability that the pose is right to a tenth of the diameter.
    pub confidence: f64,
    /// Row-major 6 x 6, tangent of `pseudoflow-contour`'s `retract`; grows while the pose is not measured.
    pub covariance: [f64; 36],
    /// Where its tracking stands.
    pub phase: Phase,
    /// Frames in a row in which it was seen, and in which it was not.
    pub good_frames: u32,
    /// See `good_frames`.
    pub bad_frames: u32,
    /// What the picture says.
    pub evidence: Evidence,
}

/// Why a frame could not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameProblem {
    /// Its time is not after that of the frame before.
    OutOfOrder,
    /// It is black, or of one colour.
    Dark,
}

impl fmt::Display for FrameProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OutOfOrder => "older than one before it: not used",
            Self::Dark => "black or of one colour: objects are held where they are believed to be",
        })
    }
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Every object that was ever found; none when the frame is out of order.
    pub estimates: Vec<Estimate>,
    /// Why the frame could not be used.
    pub problem: Option<FrameProblem>,
}
