//! The networks without an engine: what they are made of, their weights, and their export as ONNX. `pseudoflow-learning` computes
//! and trains them with burn; ONNX Runtime and rten run what [`FlowNetwork::export`] writes.

mod config;
mod detector;
mod device;
mod error;
mod flow_network;
pub mod layout;
mod model;
mod onnx;
mod refiner;
pub mod storage;
mod upsampling;
mod weights;

pub use config::{Architecture, NetworkConfig};
pub use detector::{CORNERS, Cell, DetectorConfig, Grid, STRIDES, SURFACE_UNIT};
pub use device::ComputeDevice;
pub use error::{NetworkError, Result, io_error};
pub use flow_network::FlowNetwork;
pub use model::{BATCH_NORM_EPSILON, Init, Model, TensorSpec};
pub use onnx::{ExportOptions, Pictures, export_detector, export_onnx, export_refiner, is_refiner_onnx};
pub use refiner::{REFERENCE_CHANNELS, RefinerConfig, reference_geometry};
pub use upsampling::align_corners_matrix;
pub use weights::{NamedTensor, Weights, WeightsInfo};
