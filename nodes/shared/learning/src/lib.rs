//! The networks in burn, with CPU kernels of their own: they compute and learn. RAFT (Teed and Deng, ECCV 2020, arXiv 2003.12039), the
//! compact [`Refiner`] for all objects, and the [`Detector`] that finds objects; their losses, optimiser and training state. What
//! they are made of and their weights are `pseudoflow-network`'s.
//!
//! Begin with [`TrainState`], a training that is saved whole, and [`Trainable`], which builds a network from weights.
//!
//! ```
//! use pseudoflow_learning::{Device, Trainable as _};
//! use pseudoflow_network::{FlowNetwork, Weights};
//!
//! let network = FlowNetwork::named("nano")?;
//! let weights = Weights::random(&network, 1);
//! let raft = network.build(&weights, &Device::flex())?;
//! let grey = vec![0.0; 3 * 64 * 64];
//! let (flow_px, certainty) = raft.infer([&grey, &grey], 1, 64, 2, &Device::flex())?;
//! assert_eq!(flow_px.len(), 2 * 64 * 64);
//! assert!(certainty.is_none(), "only the refiner says how sure it is");
//! # Ok::<(), pseudoflow_network::NetworkError>(())
//! ```

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
pub use labels::{ExtraLoss, ExtraLossAt};
pub use loss::{DeviceBatch, FlowBatch, MAX_FLOW_PX, end_point_error, sequence_loss};
pub use model::{Parameter, Trainable};
pub use optim::{AdamWConfig, OneCycle, Plateau, Schedule};
pub use raft::Raft;
pub use refiner::{DeviceRefinerBatch, Refinement, Refiner, RefinerBatch};
pub use train::{StepStats, TrainConfig, TrainState};
