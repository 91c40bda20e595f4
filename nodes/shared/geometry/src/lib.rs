//! Rigid transforms, pinhole cameras and crops: the conventions that every other crate stands on.
//!
//! - SI units: metres, radians, seconds. BOP files are in millimetres and are converted where they are read.
//! - `a_from_b` is a transform that takes coordinates of `b` to coordinates of `a`; `point_in_camera` is a point.
//! - Camera frames are optical: x right, y down, z forward.
//! - Pixel centres lie at integer coordinates (OpenCV, BOP): the top left pixel covers `[-0.5, 0.5]` in x and y.
//!
//! Begin with [`Pose`], [`Intrinsics`] and [`Crop`]:
//!
//! ```
//! use nalgebra::{Point3, Vector3};
//! use pseudoflow_geometry::{Crop, Intrinsics, Pose};
//!
//! // Half a metre before the camera, turned by a quarter about the optical axis.
//! let camera_from_object = Pose::new(Vector3::new(0.0, 0.0, 0.5), Vector3::z() * std::f64::consts::FRAC_PI_2);
//! let point_in_camera = camera_from_object * Point3::new(0.1, 0.0, 0.0);
//! assert!((point_in_camera - Point3::new(0.0, 0.1, 0.5)).norm() < 1e-12);
//!
//! let camera = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
//! let pixel = camera.project(&point_in_camera).expect("before the camera");
//! assert!((pixel.x - 319.5).abs() < 1e-9 && (pixel.y - 359.5).abs() < 1e-9);
//!
//! // A crop has intrinsics of its own, so that a pose in the crop is the pose in the image.
//! let crop = Crop { x0: 200.0, y0: 200.0, side: 256.0, size_px: 128 };
//! let in_crop = crop.intrinsics(&camera).project(&point_in_camera).expect("before the camera");
//! assert!((in_crop - crop.crop_from_image(&pixel)).norm() < 1e-9);
//! ```

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
