//! Training of any flow network on labels that are flows themselves (docs/method.md, L_flow), and on a loss from outside.
//!
//! A label says where a surface point is seen, never that one is hidden, and it stands where flows agreed, hence where the
//! network was sure already. So labels teach the flow alone: visibility and confidence of the refiner keep what synthetic
//! pairs, whose truth is whole, taught them.

use crate::flow_network::BuiltFlow;
use crate::guard::guarded_on;
use crate::loss::{DeviceBatch, FlowBatch, sequence_loss, values};
use crate::ops;
use crate::refiner::{DeviceRefinerBatch, Refinement, RefinerBatch, coarse_loss};
use crate::train::{StepStats, TrainState};
use burn::tensor::{Device, Tensor, TensorData};
use pseudoflow_network::FlowNetwork;
use pseudoflow_network::Result;

/// A loss on the last flows that is computed outside of the network.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtraLoss {
    /// Its value.
    pub value: f32,
    /// Its gradient with respect to each flow value (n, 2, S, S).
    pub gradient: Vec<f32>,
}

/// Computes an [`ExtraLoss`] at the last flows (n, 2, S, S), px.
pub type ExtraLossAt<'a> = &'a dyn Fn(&[f32]) -> ExtraLoss;

impl ExtraLoss {
    /// Computes a loss at flows (n, 2, S, S): its value, and a term (shape (1)) that is linear in the flow, so that its gradient is the
    /// loss's; the term's own value means nothing.
    ///
    /// # Panics
    /// When the gradient has another length than the flows.
    pub(crate) fn at(flow: Tensor<4>, loss: impl FnOnce(&[f32]) -> Self) -> (f32, Tensor<1>) {
        let (shape, device, flow_px) = (flow.dims(), flow.device(), values(flow.clone()));
        let Self { value, gradient } = loss(&flow_px);
        assert_eq!(gradient.len(), flow_px.len(), "one gradient for each flow value");
        (value, (flow * Tensor::from_data(TensorData::new(gradient, shape), &device)).sum())
    }
}

/// Labels on a device, as a network takes them.
#[allow(clippy::large_enum_variant, reason = "one exists for each step")]
enum DeviceLabels {
    Raft(DeviceBatch),
    Refiner(DeviceRefinerBatch),
}

/// What a network makes of labelled pairs.
struct Attempt {
    /// The last flow (n, 2, S, S), px.
    flow: Tensor<4>,
    /// Distance of all its flows from the labels, shape (1).
    loss: Tensor<1>,
    /// Mean end point error of the last flow, px, shape (1), without a gradient.
    epe: Tensor<1>,
}

impl DeviceLabels {
    fn of(network: &FlowNetwork, batch: &FlowBatch<'_>, size_px: usize, device: &Device) -> Result<Self> {
        Ok(match network {
            FlowNetwork::Raft(_) => Self::Raft(batch.to_device(size_px, device)?),
            FlowNetwork::Refiner(_) => Self::Refiner(labelled(batch).to_device(size_px, device)?),
        })
    }
}

/// Labels as pairs whose points are seen where there is a label, and unknown elsewhere.
fn labelled<'a>(batch: &FlowBatch<'a>) -> OwnedLabels<'a> {
    let visible = batch.mask.iter().map(|&m| if m > 0.0 { 1.0 } else { -1.0 }).collect();
    OwnedLabels { batch: *batch, visible }
}

struct OwnedLabels<'a> {
    batch: FlowBatch<'a>,
    visible: Vec<f32>,
}

impl OwnedLabels<'_> {
    fn to_device(&self, size_px: usize, device: &Device) -> Result<DeviceRefinerBatch> {
        let FlowBatch { reference, real, flow, n, .. } = self.batch;
        RefinerBatch { reference, real, flow, visible: &self.visible, n }.to_device(size_px, device)
    }
}

impl BuiltFlow {
    fn attempt(&self, labels: &DeviceLabels, iterations: usize, gamma: f32) -> Attempt {
        match (self, labels) {
            (Self::Raft(raft), DeviceLabels::Raft(data)) => {
                let flows = raft.forward(data.reference.clone(), data.real.clone(), iterations);
                let (loss, last) = (sequence_loss(&flows, data, gamma), flows[iterations - 1].clone());
                Attempt { epe: crate::loss::device_end_point_error(&last, data), flow: last, loss }
            }
            (Self::Refiner(refiner), DeviceLabels::Refiner(data)) => {
                let refinement = refiner.forward(data.reference.clone(), data.real.clone(), iterations);
                refiner_attempt(&refinement, data, gamma)
            }
            _ => unreachable!("labels are made for the network that learns from them"),
        }
    }
}

fn refiner_attempt(refinement: &Refinement, data: &DeviceRefinerBatch, gamma: f32) -> Attempt {
    let part = |first: usize, count: usize| data.target.clone().narrow(1, first, count);
    let (label, mask) = (part(0, 2), part(2, 1));
    let count = mask.clone().sum().clamp_min(1.0);
    let flow = refinement.prediction.clone().narrow(1, 0, 2);
    let fine = ops::masked_l1(flow.clone(), label.clone(), mask.clone()) / count.clone();
    let difference = flow.clone().detach() - label;
    let length = (difference.clone() * difference).sum_dim(1).sqrt();
    Attempt { loss: fine + coarse_loss(refinement, data, gamma), epe: (length * mask).sum() / count, flow }
}

impl TrainState<FlowNetwork> {
    /// One step on pairs of side `size_px`: `flow_weight` times the distance of the network's flows from the labels, plus a
    /// loss that the caller computes from the last flows (n, 2, S, S), with its gradient there. `loss` of the returned is the
    /// sum of both. The batch's reference has [`FlowNetwork::reference_channels`] channels.
    ///
    /// # Errors
    /// The batch has wrong lengths or values, or loss or gradient are not finite: the weights then stay as they were.
    ///
    /// # Panics
    /// When the gradient has another length than the flows.
    pub fn train_step_with(
        &mut self,
        batch: &FlowBatch<'_>,
        size_px: usize,
        flow_weight: f32,
        extra: impl FnOnce(&[f32]) -> ExtraLoss,
    ) -> Result<StepStats> {
        let device = self.device().autodiff();
        let labels = guarded_on(&device, || DeviceLabels::of(&self.network, batch, size_px, &device))?;
        let (iterations, gamma) = (self.network.iterations_train(), self.config.gamma);
        let mut extra_value = f32::NAN;
        let (stats, measured) = self.step_measuring(|network| {
            let attempt = network.attempt(&labels, iterations, gamma);
            let flow_loss = attempt.loss * flow_weight;
            let (value, term) = ExtraLoss::at(attempt.flow, extra);
            extra_value = value;
            (flow_loss.clone() + term, vec![attempt.epe, flow_loss])
        })?;
        Ok(StepStats { epe: measured[0], loss: measured[1] + extra_value, ..stats })
    }
}
