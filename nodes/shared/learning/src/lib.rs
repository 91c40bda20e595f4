//! The networks in burn: own CPU kernels, losses, optimiser and training state. What the networks are made of and their weights are
//! `pseudoflow-network`'s.

mod detector;
mod device;
mod flow_network;
mod guard;
mod kernels;
mod labels;
mod loss;
mod memory;
mod model;
#[cfg(test)]
mod onnx_tests;
pub mod ops;
mod optim;
mod raft;
mod refiner;
mod train;

pub use burn::tensor::{Device, Tensor};
pub use detector::{
    DetectionLoss, Detector, DetectorOutput, InstanceTruth, LossWeights, SceneTruth, Trunk, detection_loss,
};
pub use device::OpenDevice;
pub use flow_network::BuiltFlow;
pub use labels::ExtraLoss;
pub use loss::{DeviceBatch, FlowBatch, MAX_FLOW_PX, end_point_error, sequence_loss};
pub use model::{Parameter, Trainable};
pub use optim::{AdamWConfig, OneCycle, Plateau, Schedule};
pub use raft::Raft;
pub use refiner::{DeviceRefinerBatch, Refinement, Refiner, RefinerBatch};
pub use train::{StepStats, TrainConfig, TrainState};
