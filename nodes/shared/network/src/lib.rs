//! The flow network: RAFT in burn with own CPU kernels, its losses, optimiser, training state and ONNX export.

mod config;
mod error;
mod kernels;
pub mod ops;
mod raft;
mod weights;

pub use config::{Architecture, NetworkConfig};
pub use error::{NetworkError, Result};
pub use raft::Raft;
pub use weights::{NamedTensor, Weights, WeightsInfo};
