//! The pnp node: flow and depth to a pose (paper, section 3.1 and the end of 4.1; docs/method.md, pipeline step 5).
//!
//! Each foreground pixel of the reference gives a 3D point (depth unprojected, object frame) and the crop pixel
//! where the flow says it is seen; [`pseudoflow_solver::Solver`] finds the pose that explains most of them. [`gate`] judges,
//! without any ground truth, whether the new pose should replace the initial one.
//!
//! With `stages: joint` the contour of the object in the camera's image and the rough pose count as well, in one cost
//! ([`pseudoflow_solver::JointSolver`]); with `stages: region` there is no flow at all, and no network is needed.
//!
//! The [`judge`] node says how well the pictures agree with the poses of one or two networks, without any truth.

mod config;
mod crop_solver;
pub mod gate;
mod joint;
pub mod judge;
mod node;
mod views;

pub use config::PnpNodeConfig;
pub use joint::Stages;
pub use node::{Look, PnpNode, Refinement};
