//! The networks that train on synthetic pairs.

use super::data::Batch;
use crate::PretrainError;
use pseudoflow_learning::{Raft, Refiner, StepStats, TrainState, Trainable};
use pseudoflow_network::{NetworkConfig, NetworkError, RefinerConfig, Weights};

/// A network that trains on synthetic pairs.
pub(crate) trait PairNetwork: Trainable {
    /// Whether it takes the depth of its references.
    const TAKES_GEOMETRY: bool;

    /// Side of its crops, pixels.
    fn size_px(&self) -> usize;

    /// One step on a batch, whatever its crop size.
    fn train(state: &mut TrainState<Self>, batch: &Batch) -> Result<StepStats, NetworkError>
    where
        Self: Sized;

    /// Mean end point error on a batch with given weights, pixels of its crops.
    fn error_px(&self, weights: &Weights, batch: &Batch) -> Result<f32, PretrainError>;
}

impl PairNetwork for NetworkConfig {
    const TAKES_GEOMETRY: bool = false;

    fn size_px(&self) -> usize {
        self.size_px
    }

    fn train(state: &mut TrainState<Self>, batch: &Batch) -> Result<StepStats, NetworkError> {
        let own_px = std::mem::replace(&mut state.network.size_px, batch.size_px);
        let stats = state.train_step(&batch.view());
        state.network.size_px = own_px;
        stats
    }

    fn error_px(&self, weights: &Weights, batch: &Batch) -> Result<f32, PretrainError> {
        let network = Self { size_px: batch.size_px, ..self.clone() };
        Ok(Raft::error_px(&network, weights, &batch.view())?)
    }
}

impl PairNetwork for RefinerConfig {
    const TAKES_GEOMETRY: bool = true;

    fn size_px(&self) -> usize {
        self.size_px
    }

    fn train(state: &mut TrainState<Self>, batch: &Batch) -> Result<StepStats, NetworkError> {
        let own_px = std::mem::replace(&mut state.network.size_px, batch.size_px);
        let stats = match &batch.pose_loss {
            Some(loss) => state.train_step_with(&batch.refiner_view(), Some(&|flow_px| loss.of(flow_px))),
            None => state.train_step(&batch.refiner_view()),
        };
        state.network.size_px = own_px;
        stats
    }

    fn error_px(&self, weights: &Weights, batch: &Batch) -> Result<f32, PretrainError> {
        let network = Self { size_px: batch.size_px, ..self.clone() };
        Ok(Refiner::error_px(&network, weights, &batch.refiner_view())?)
    }
}
