//! Poses from points and the pixels that see them (paper, section 3.1 and the end of 4.1; docs/method.md, pipeline step 5).
//!
//! [`Solver`] finds the pose that explains most correspondences: P3P or EPnP in RANSAC, then Levenberg-Marquardt under
//! Tukey's loss. [`JointSolver`] joins flow, contour and rough pose in one cost. [`PixelBuffer`] makes correspondences of a flow field on a rendering.
//!
//! Frames: object points in metres in the object's frame; pixels, centres at integers, seen by given intrinsics. A pose is
//! `camera_from_object`.
//!
//! Nothing here knows a middleware, a clock or a global random source: same input and seed, same bits.
//!
//! Begin with [`Solver`]:
//!
//! ```
//! use nalgebra::{Point3, Vector3};
//! use pseudoflow_geometry::{Intrinsics, Pose};
//! use pseudoflow_solver::{Correspondences, PnpConfig, Solver};
//!
//! let camera = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
//! let truth = Pose::new(Vector3::new(0.05, 0.0, 0.7), Vector3::new(0.4, -0.9, 0.2));
//! // Points on a screw, and the pixels that see them.
//! let points: Vec<[f32; 3]> = (0..100).map(|i| 0.2 * i as f32).map(|t| [0.06 * t.cos(), 0.06 * t.sin(), 0.01 * t]).collect();
//! let see = |p: &[f32; 3]| camera.project(&(truth * Point3::from(*p).cast::<f64>())).expect("before the camera");
//! let pixels: Vec<[f32; 2]> = points.iter().map(see).map(|pixel| [pixel.x as f32, pixel.y as f32]).collect();
//!
//! let rough = Pose::translation(0.0, 0.0, 0.8);
//! let mut solver = Solver::new(PnpConfig::default())?;
//! let found = solver.solve(&Correspondences::new(&points, &pixels)?, &camera, &rough, 1);
//! assert!(found.status.is_ok() && found.rms_px < 0.01, "{}", found.status);
//! # Ok::<(), pseudoflow_solver::PnpError>(())
//! ```

mod config;
mod correspondence;
mod covariance;
mod epnp;
mod error;
mod joint;
mod lanes;
mod lm;
mod normal;
mod p3p;
mod points;
#[cfg(test)]
mod properties;
mod ransac;
mod score;
mod sensitivity;
mod solver;

#[cfg(test)]
mod testing;

pub use config::{MinimalSolver, PnpConfig};
pub use correspondence::{Correspondences, FlowField, PixelBuffer};
pub use epnp::{EpnpError, epnp};
pub use error::{JointError, PnpError};
pub use joint::{FlowConfig, FlowEvidence, JointConfig, JointResult, JointSolver, JointTask};
pub use p3p::p3p;
pub use sensitivity::{PoseErrorSlope, PosedPixels, pose_error_slope};
pub use solver::{PnpResult, PnpStatus, Solver, UNKNOWN_VARIANCE};
