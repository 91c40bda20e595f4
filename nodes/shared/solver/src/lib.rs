//! Poses from points and the pixels that see them (paper, section 3.1 and the end of 4.1; docs/method.md, pipeline step 5).
//!
//! [`Solver`] finds the pose that explains most correspondences: P3P or EPnP in RANSAC, then Levenberg-Marquardt under
//! Tukey's loss. [`JointSolver`] joins flow, contour and rough pose in one cost. [`PixelBuffer`] makes correspondences of a flow field on a rendering.
//!
//! Frames: object points in metres in the object's frame; pixels, centres at integers, seen by given intrinsics. A pose is
//! `camera_from_object`.
//!
//! Nothing here knows a middleware, a clock or a global random source: same input and seed, same bits.

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
mod solver;

#[cfg(test)]
mod testing;

pub use config::{MinimalSolver, PnpConfig};
pub use correspondence::{Correspondences, FlowField, PixelBuffer};
pub use epnp::{EpnpError, epnp};
pub use error::{JointError, PnpError};
pub use joint::{FlowConfig, FlowEvidence, JointConfig, JointResult, JointSolver, JointTask};
pub use p3p::p3p;
pub use solver::{PnpResult, PnpStatus, Solver, UNKNOWN_VARIANCE};
