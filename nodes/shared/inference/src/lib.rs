//! Runs the networks of the house, given as ONNX files.
//!
//! Two engines run the same file: ONNX Runtime, loaded from the machine (`libonnxruntime`), and rten, which is part of
//! the binary. Which one runs is logged, and never changes by itself after the start.

mod engine;
mod error;
mod images;
mod onnxruntime;
mod rten_engine;

pub use engine::{Backend, Engine, EngineConfig, ExecutionProvider, Input, Output, open};
pub use error::InferenceError;
pub use images::normalise;
