//! Flow and depth to a pose (paper, section 3.1 and the end of 4.1; method.md, pipeline step 5).
//!
//! Each foreground pixel of the reference gives a 3D point (depth unprojected, object frame) and the crop pixel
//! where the flow says it is seen. [`Solver`] finds the pose that explains most of them: P3P or EPnP in RANSAC,
//! then Levenberg-Marquardt under Tukey's loss. [`gate`] judges, without any ground truth, whether the new pose
//! should replace the initial one.
//!
//! Frames: object points in metres in the object's frame; pixels of the crop, centres at integers, seen by the crop's
//! intrinsics K'. A pose is `camera_from_object` and is the same for the crop and the full image.
//!
//! Nothing here but [`PnpNode`] knows a middleware, and nothing a clock or a global random source: same input and seed,
//! same bits.

mod config;
mod correspondence;
mod covariance;
mod epnp;
mod error;
pub mod gate;
mod lanes;
mod lm;
mod node;
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
pub use error::PnpError;
pub use node::{Judgement, PnpNode, PnpNodeConfig};
pub use p3p::p3p;
pub use solver::{PnpResult, PnpStatus, Solver, UNKNOWN_VARIANCE};
