//! The flow network: RAFT in burn with own CPU kernels, its losses, optimiser, training state and ONNX export.

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
