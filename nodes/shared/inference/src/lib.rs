//! Runs the networks of the house, given as ONNX files.
//!
//! Two engines run the same file: ONNX Runtime, loaded from the machine (`libonnxruntime`), and rten, which is part of
//! the binary. Which one runs is logged, and never changes by itself after the start.
//!
//! Begin with [`open`]:
//!
//! ```no_run
//! use pseudoflow_inference::{EngineConfig, Input, Output, open};
//!
//! let onnx = std::fs::read("nano.onnx")?; // pseudoflow export --weights nano.safetensors --out nano.onnx
//! let mut engine = open(&onnx, &EngineConfig::default())?;
//! println!("{}", engine.describe());
//! let picture = vec![0.0; 3 * 128 * 128];
//! let [reference, real] = ["reference", "real"].map(|name| Input { name, shape: &[1, 3, 128, 128], data: &picture });
//! let mut flow_px = vec![0.0; 2 * 128 * 128];
//! engine.run(&[reference, real], &mut [Output { name: "flow", data: &mut flow_px }])?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod engine;
mod error;
mod images;
mod onnxruntime;
mod rten_engine;

pub use engine::{Backend, Engine, EngineConfig, ExecutionProvider, Input, Output, open};
pub use error::InferenceError;
pub use images::normalise;
