//! Rigid transforms, pinhole cameras and crops: the conventions that every other crate stands on.
//!
//! - SI units: metres, radians, seconds. BOP files are in millimetres and are converted where they are read.
//! - `a_from_b` is a transform that takes coordinates of `b` to coordinates of `a`; `point_in_camera` is a point.
//! - Camera frames are optical: x right, y down, z forward.
//! - Pixel centres lie at integer coordinates (OpenCV, BOP): the top left pixel covers `[-0.5, 0.5]` in x and y.

mod camera;
mod crop;
mod jitter;
mod pose;
mod symmetry;

pub use camera::{Intrinsics, IntrinsicsError};
pub use crop::Crop;
pub use jitter::{Jitter, standard_normal};
pub use pose::{
    Pose, PoseError, exp_se3, log_se3, pose_from_quaternion, pose_from_row_major, quaternion_xyzw, rotation_angle_rad,
    rotation_row_major,
};
pub use symmetry::{ContinuousSymmetry, Symmetries};
