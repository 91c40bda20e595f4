//! The networks without an engine: what they are made of, their weights, and their export as ONNX. RAFT (Teed and Deng, ECCV 2020,
//! arXiv 2003.12039), the compact refiner for all objects, and the network that finds objects. `pseudoflow-learning` computes and
//! trains them with burn; ONNX Runtime and rten run what [`FlowNetwork::export`] writes (`pseudoflow-inference`).
//!
//! Begin with [`FlowNetwork`], which knows a network by its name or by its weights, and [`Weights`].
//!
//! ```
//! use pseudoflow_network::{ExportOptions, FlowNetwork};
//!
//! let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/weights/refiner.safetensors");
//! let network = FlowNetwork::of_weights(file.as_ref())?;
//! assert!(network.is_refiner());
//! let weights = network.load(file.as_ref())?;
//! let onnx = network.export(&weights, ExportOptions { size_px: 128, iterations: 4, batch: None })?;
//! assert!(onnx.len() > 1_000_000);
//! # Ok::<(), pseudoflow_network::NetworkError>(())
//! ```

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
pub use upsampling::{UPSAMPLING, align_corners_matrix};
pub use weights::{NamedTensor, Weights, WeightsInfo};
