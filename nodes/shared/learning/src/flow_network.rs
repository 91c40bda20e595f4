//! The networks that find flow, in burn.

use crate::model::{Parameter, Trainable};
use crate::raft::Raft;
use crate::refiner::Refiner;
use burn::tensor::Device;
use pseudoflow_network::{FlowNetwork, NetworkConfig, RefinerConfig, Result, Weights};

/// A [`FlowNetwork`] with its weights on a device. One exists for each engine: its size does not matter.
#[allow(clippy::large_enum_variant, reason = "made once, never moved about")]
#[derive(Debug)]
pub enum BuiltFlow {
    /// A RAFT.
    Raft(Raft),
    /// The refiner.
    Refiner(Refiner),
}

impl Trainable for FlowNetwork {
    type Network = BuiltFlow;

    fn build(&self, weights: &Weights, device: &Device) -> Result<BuiltFlow> {
        Ok(match self {
            Self::Raft(raft) => BuiltFlow::Raft(Raft::new(weights, raft, device)?),
            Self::Refiner(refiner) => BuiltFlow::Refiner(Refiner::new(weights, refiner, device)?),
        })
    }

    fn parameters(network: &BuiltFlow) -> &[Parameter] {
        match network {
            BuiltFlow::Raft(raft) => NetworkConfig::parameters(raft),
            BuiltFlow::Refiner(refiner) => RefinerConfig::parameters(refiner),
        }
    }
}

impl BuiltFlow {
    /// Flow (n, 2, S, S), px, and of the refiner certainty (n, 2, S, S), 0..1, as [`pseudoflow_network::export_refiner`] has them; references as the
    /// network takes them.
    ///
    /// # Errors
    /// The size is not allowed or a slice has another length.
    pub fn infer(
        &self,
        [reference, real]: [&[f32]; 2],
        n: usize,
        size_px: usize,
        iterations: usize,
        device: &Device,
    ) -> Result<(Vec<f32>, Option<Vec<f32>>)> {
        match self {
            Self::Raft(raft) => Ok((raft.infer_slices(reference, real, n, size_px, iterations, device)?, None)),
            Self::Refiner(refiner) => {
                let all = refiner.infer_slices(reference, real, n, size_px, iterations, device)?;
                Ok(split(&all, size_px * size_px))
            }
        }
    }
}

/// Flow, and visibility and confidence, from a refiner's prediction (n, 5, S, S).
fn split(prediction: &[f32], area: usize) -> (Vec<f32>, Option<Vec<f32>>) {
    let mut flow = Vec::with_capacity(prediction.len() / 5 * 2);
    let mut certainty = Vec::with_capacity(prediction.len() / 5 * 2);
    let sigmoid = |logit: &f32| 1.0 / (1.0 + (-logit).exp());
    for image in prediction.chunks_exact(5 * area) {
        flow.extend_from_slice(&image[..2 * area]);
        certainty.extend(image[4 * area..].iter().map(sigmoid));
        certainty.extend(image[2 * area..3 * area].iter().map(sigmoid));
    }
    (flow, Some(certainty))
}
