//! The flow node: for each reference view, the flow from the rendering to the real crop (paper eq. 4; docs/method.md,
//! step 4).
//!
//! The network is an ONNX file, run by [`pseudoflow_inference`], or weights that burn (feature `burn`) runs on a GPU: `device` says where.

#[cfg_attr(not(feature = "burn"), path = "no_burn.rs")]
mod burn_engine;
mod engine;
mod error;
mod images;
mod loaded;
mod node;

pub use error::FlowError;
pub use images::interleave;
pub use node::{FlowConfig, FlowNode, Lockstep, Network, load_model};
