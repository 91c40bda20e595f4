//! The networks in burn, with CPU kernels of their own: RAFT (Teed and Deng, ECCV 2020, arXiv 2003.12039), the compact [`Refiner`] for all
//! objects, and the [`Detector`] that finds objects; their losses, optimiser, training state and ONNX export.
//!
//! Begin with [`FlowNetwork`], which knows a network by its name or by its weights, and [`Weights`]. Training: [`TrainState`]. What
//! runs an exported network: `pseudoflow-inference`.
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
mod guard;
mod kernels;
mod labels;
mod loss;
mod memory;
mod model;
mod onnx;
pub mod ops;
mod optim;
mod raft;
mod refiner;
mod train;
mod weights;

pub use burn::tensor::{Device, Tensor};
pub use config::{Architecture, NetworkConfig};
pub use detector::{
    CORNERS, Cell, DetectionLoss, Detector, DetectorConfig, DetectorOutput, Grid, InstanceTruth, LossWeights, STRIDES,
    SURFACE_UNIT, SceneTruth, Trunk, detection_loss,
};
pub use device::{ComputeDevice, OpenDevice};
pub use error::{NetworkError, Result};
pub use flow_network::{BuiltFlow, FlowNetwork};
pub use labels::ExtraLoss;
pub use loss::{DeviceBatch, FlowBatch, MAX_FLOW_PX, end_point_error, sequence_loss};
pub use model::{Init, Model, Parameter, TensorSpec};
pub use onnx::{ExportOptions, Pictures, export_detector, export_onnx, export_refiner, is_refiner_onnx};
pub use optim::{AdamWConfig, OneCycle, Plateau, Schedule};
pub use raft::Raft;
pub use refiner::{
    DeviceRefinerBatch, REFERENCE_CHANNELS, Refinement, Refiner, RefinerBatch, RefinerConfig, reference_geometry,
};
pub use train::{StepStats, TrainConfig, TrainState};
pub use weights::{NamedTensor, Weights, WeightsInfo};
