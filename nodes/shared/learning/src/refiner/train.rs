//! The refiner's loss on synthetic pairs.

use super::{Refinement, Refiner, RefinerBatch};
use crate::guard::guarded_on;
use crate::loss::values;
use crate::model::Trainable;
use crate::ops;
use crate::refiner::batch::DeviceRefinerBatch;
use crate::train::{StepStats, TrainState};
use crate::{ExtraLoss, ExtraLossAt};
use burn::tensor::{Device, Tensor};
use pseudoflow_network::Weights;
use pseudoflow_network::{RefinerConfig, Result};

/// Weight of the visibility's cross entropy in the loss.
const VISIBILITY_WEIGHT: f32 = 1.0;
/// Weight of the coarse flows' L1 distance, px at full size, in the loss.
const COARSE_WEIGHT: f32 = 1.0;

/// [`crate::ops::mixture_loss`] of the prediction plus the L1 distance of the first flow and of each iteration's, px of the
/// crop, the later the weightier (`gamma`).
pub(crate) fn refiner_loss(refinement: &Refinement, batch: &DeviceRefinerBatch, gamma: f32) -> Tensor<1> {
    let fine = ops::mixture_loss(refinement.prediction.clone(), batch.target.clone(), VISIBILITY_WEIGHT);
    coarse_terms(refinement, batch, gamma).fold(fine, |sum, term| sum + term)
}

/// L1 distance of the first flow and of each iteration's but the last, px of the crop.
pub(crate) fn coarse_loss(refinement: &Refinement, batch: &DeviceRefinerBatch, gamma: f32) -> Tensor<1> {
    let none = Tensor::zeros([1], &batch.coarse_flow.device());
    coarse_terms(refinement, batch, gamma).fold(none, |sum, term| sum + term)
}

fn coarse_terms(refinement: &Refinement, batch: &DeviceRefinerBatch, gamma: f32) -> impl Iterator<Item = Tensor<1>> {
    let last = refinement.coarse.len();
    refinement.coarse.iter().enumerate().map(move |(k, flow)| {
        let weight = COARSE_WEIGHT * gamma.powi((last - k) as i32) * 8.0 / batch.coarse_sum;
        ops::masked_l1(flow.clone(), batch.coarse_flow.clone(), batch.coarse_weight.clone()) * weight
    })
}

impl TrainState<RefinerConfig> {
    /// One step on synthetic pairs of side [`RefinerConfig::size_px`]. `epe` of the returned is over what is seen.
    ///
    /// # Errors
    /// The batch has wrong lengths or values, or loss or gradient are not finite: the weights then stay as they were.
    pub fn train_step(&mut self, batch: &RefinerBatch<'_>) -> Result<StepStats> {
        self.train_step_with(batch, None)
    }

    /// As [`Self::train_step`], plus a loss that the caller computes from the last flows (n, 2, S, S), px.
    ///
    /// # Errors
    /// As [`Self::train_step`].
    ///
    /// # Panics
    /// When the extra loss's gradient has another length than the flows.
    pub fn train_step_with(&mut self, batch: &RefinerBatch<'_>, extra: Option<ExtraLossAt<'_>>) -> Result<StepStats> {
        let device = self.device().autodiff();
        let data = guarded_on(&device, || batch.to_device(self.network.size_px, &device))?;
        let (iterations, gamma) = (self.network.iterations_train, self.config.gamma);
        let mut extra_value = 0.0;
        let (stats, measured) = self.step_measuring(|refiner| {
            let refinement = refiner.forward(data.reference.clone(), data.real.clone(), iterations);
            let epe = visible_error(&refinement, &data);
            let own = refiner_loss(&refinement, &data, gamma);
            let all = match extra {
                Some(extra) => {
                    let (value, term) = ExtraLoss::at(refinement.prediction.narrow(1, 0, 2), extra);
                    extra_value = value;
                    own.clone() + term
                }
                None => own.clone(),
            };
            (all, vec![epe, own])
        })?;
        Ok(StepStats { epe: measured[0], loss: measured[1] + extra_value, ..stats })
    }
}

/// Mean end point error of the prediction over what is seen, px; a tensor of shape (1).
fn visible_error(refinement: &Refinement, data: &DeviceRefinerBatch) -> Tensor<1> {
    let flow = refinement.prediction.clone().narrow(1, 0, 2).detach();
    let difference = flow - data.target.clone().narrow(1, 0, 2);
    let length = (difference.clone() * difference).sum_dim(1).sqrt();
    let mask = data.target.clone().narrow(1, 2, 1);
    (length * mask.clone()).sum() / mask.sum().clamp_min(1.0)
}

impl Refiner {
    /// Mean end point error of these weights on a batch of pairs of side [`RefinerConfig::size_px`], over what is seen, px, computed
    /// on the processor.
    ///
    /// # Errors
    /// The batch has wrong lengths or values, or the weights belong to another architecture.
    pub fn error_px(config: &RefinerConfig, weights: &Weights, batch: &RefinerBatch<'_>) -> Result<f32> {
        let device = Device::flex();
        let data = batch.to_device(config.size_px, &device)?;
        let refiner = config.build(weights, &device)?;
        let refinement = refiner.forward(data.reference.clone(), data.real.clone(), config.iterations_infer);
        Ok(values(visible_error(&refinement, &data))[0])
    }
}
