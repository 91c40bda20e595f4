//! The flow node: for each reference view, the flow from the rendering to the real crop (paper eq. 4; method.md,
//! step 4).
//!
//! Two engines run the same ONNX file: ONNX Runtime, loaded from the machine (`libonnxruntime`), and rten, which
//! is part of the binary. Which one runs is logged, and never changes by itself after the start.

mod engine;
mod error;
mod images;
mod node;
mod onnxruntime;
mod rten_engine;

pub use engine::{Backend, EngineConfig, ExecutionProvider, FlowEngine, open};
pub use error::FlowError;
pub use images::{interleave, normalise};
pub use node::{FlowConfig, FlowNode, Lockstep, Network, load_model};
