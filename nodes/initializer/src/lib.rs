//! The initializer node: objects of a set are found in an image, each with a first pose (method.md, pipeline step 1; Hu et
//! al., "Wide-Depth-Range 6D Object Pose Estimation in Space", CVPR 2021).
//!
//! The network says for every cell which object it shows and where the corners of that object's box are ([`votes`]); cells
//! that mean the same instance vote together, and RANSAC-PnP makes a pose of their votes ([`detect`]).

pub mod detect;
mod error;
mod fit;
mod network;
mod node;
pub mod track;
pub mod votes;

pub use error::InitializerError;
pub use fit::Fit;
pub use network::{Answer, DetectorNetwork};
pub use node::{InitializerConfig, InitializerNode};
