//! The refiner in burn: a compact network for all objects that knows the rendering's depth and says how sure it is
//! ([`RefinerConfig`] says what it is made of).
//!
//! Input: the rendering (N, 5, S, S): red, green, blue in [-1, 1], relative depth, mask ([`pseudoflow_network::reference_geometry`]);
//! the photograph's crop (N, 3, S, S). S is a multiple of 16.

mod batch;
mod encoder;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod train;
mod update;

pub use batch::{DeviceRefinerBatch, RefinerBatch};
pub(crate) use train::coarse_loss;

use crate::guard::guarded_on;
use crate::model::{Parameter, Source, Trainable, pictures, read_together};
use crate::ops;
use crate::raft::{Conv, Pyramid};
use burn::tensor::{Device, Tensor, activation};
use encoder::{Features, GlobalLook, Trunk};
use pseudoflow_network::layout::refiner::{LEVELS, RADIUS, WIDTHS};
use pseudoflow_network::{REFERENCE_CHANNELS, RefinerConfig, Result, Weights};
use update::Update;

/// The refiner with its weights on a device. On a device with autodiff every trained tensor requires a gradient.
#[derive(Debug)]
pub struct Refiner {
    trunk: Trunk,
    match_fine: Conv,
    global: GlobalLook,
    context: Conv,
    update: Update,
    parameters: Vec<Parameter>,
}

/// What the refiner says about a batch.
#[derive(Debug)]
pub struct Refinement {
    /// The first flow and that of each iteration but the last, (N, 2, S/8, S/8), px at 1/8, for the training.
    pub coarse: Vec<Tensor<4>>,
    /// (N, 5, S, S): flow x and y, px of the crop, defined on the rendering; logit of the confidence; raw scale of the unsure
    /// component; logit of the visibility.
    pub prediction: Tensor<4>,
}

impl Refiner {
    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    pub fn new(weights: &Weights, config: &RefinerConfig, device: &Device) -> Result<Self> {
        let source = Source::new(weights, config, device)?;
        let conv = |name: &str| Conv::new(source.conv(name), 1);
        let trunk = Trunk::new(&source);
        let match_fine = conv("match.fine");
        let global = GlobalLook::new(&source);
        let context = conv("context");
        let update = Update::new(&source);
        Ok(Self { trunk, match_fine, global, context, update, parameters: source.into_parameters() })
    }

    /// Refines with `iterations` looks: rendering (N, 5, S, S), crop (N, 3, S, S).
    pub fn forward(&self, reference: Tensor<4>, real: Tensor<4>, iterations: usize) -> Refinement {
        let features = self.trunk.forward(reference, real);
        let pyramid = self.pyramid(&features);
        let (first, global) = self.global.forward(&features.coarse);
        let [fine_reference, _] = features.halves(&features.fine);
        let context = self.context.forward(Tensor::cat(vec![fine_reference, ops::double(global)], 1), false);
        let mut hidden = context.clone().narrow(1, 0, WIDTHS.hidden).tanh();
        let context = self.update.context(activation::relu(context.narrow(1, WIDTHS.hidden, WIDTHS.context)));
        // Coarse pixels of the first flow are twice as large.
        let mut flow = ops::double(first) * 2.0;
        let mut coarse = vec![flow.clone()];
        for i in 0..iterations {
            flow = flow.detach();
            let motion = self.update.motion(pyramid.lookup(&flow), flow.clone());
            hidden = self.update.hidden(hidden, motion, context.clone());
            flow = flow + self.update.delta(&hidden);
            if i + 1 < iterations {
                coarse.push(flow.clone());
            }
        }
        Refinement { coarse, prediction: self.finish(flow, &hidden) }
    }

    /// The prediction at full size.
    fn finish(&self, flow: Tensor<4>, hidden: &Tensor<4>) -> Tensor<4> {
        let all = Tensor::cat(vec![flow * 8.0, self.update.certainty(hidden)], 1);
        ops::upsample_convex(all, self.update.mask(hidden))
    }

    fn pyramid(&self, features: &Features) -> Pyramid {
        let [reference, real] = features.halves(&self.match_fine.forward(features.fine.clone(), false));
        Pyramid::new(reference, real, RADIUS, LEVELS)
    }

    /// [`Self::forward`] on plain slices of `n` pairs of side `size_px`; returns the prediction's values (n, 5, S, S).
    ///
    /// # Errors
    /// The size is not allowed, a slice has another length, or a GPU failed.
    pub fn infer_slices(
        &self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        iterations: usize,
        device: &Device,
    ) -> Result<Vec<f32>> {
        RefinerConfig::check_size(size_px)?;
        let tensor = |name, data, channels| pictures(name, data, [n, channels, size_px, size_px], device);
        guarded_on(device, || {
            let [reference, real] = [tensor("reference", reference, REFERENCE_CHANNELS)?, tensor("real", real, 3)?];
            let prediction = self.forward(reference, real, iterations).prediction;
            Ok(read_together([prediction])?.remove(0))
        })
    }
}

impl Trainable for RefinerConfig {
    type Network = Refiner;

    fn build(&self, weights: &Weights, device: &Device) -> Result<Refiner> {
        Refiner::new(weights, self, device)
    }

    fn parameters(network: &Refiner) -> &[Parameter] {
        &network.parameters
    }
}
