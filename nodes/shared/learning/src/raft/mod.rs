//! RAFT (Teed and Deng, "RAFT: Recurrent All-Pairs Field Transforms for Optical Flow", ECCV 2020) as docs/method.md,
//! "Flow", states it: features of both images, context of the *reference* only, flow from zero, detached between
//! iterations.

mod conv;
mod correlation;
mod encoder;
#[cfg(test)]
mod parity;
mod update;
mod upsample;

pub(crate) use conv::Conv;
pub(crate) use correlation::{Pyramid, grid};
pub(crate) use encoder::{Block, Norm, forward_normed, normed_conv};

use crate::guard::guarded_on;
use crate::model::{Parameter, Source, Trainable, pictures, read_together};
use crate::ops;
use burn::tensor::{Device, Tensor, activation};
use encoder::Encoder;
use pseudoflow_network::layout::raft::LEVELS;
use pseudoflow_network::{Architecture, NetworkConfig, Result, Weights};
use update::UpdateBlock;

/// RAFT with its weights on a device. On a device with autodiff every trained tensor requires a gradient.
#[derive(Debug)]
pub struct Raft {
    arch: Architecture,
    feature_encoder: Encoder,
    context_encoder: Encoder,
    update: UpdateBlock,
    parameters: Vec<Parameter>,
}

impl Raft {
    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    pub fn new(weights: &Weights, config: &NetworkConfig, device: &Device) -> Result<Self> {
        let source = Source::new(weights, config, device)?;
        let arch = config.arch;
        let feature_encoder = Encoder::new(&source, "fnet", arch, true);
        let context_encoder = Encoder::new(&source, "cnet", arch, false);
        let update = UpdateBlock::new(&source, arch);
        let parameters = source.into_parameters();
        Ok(Self { arch, feature_encoder, context_encoder, update, parameters })
    }

    /// Flow after each iteration, px at full size: images (N, 3, S, S) in [-1, 1], S a multiple of 8, to
    /// `iterations` fields (N, 2, S, S), defined on the reference.
    pub fn forward(&self, reference: Tensor<4>, real: Tensor<4>, iterations: usize) -> Vec<Tensor<4>> {
        let mut flows = Vec::with_capacity(iterations);
        self.iterate(reference, real, iterations, |_, flow, hidden| flows.push(self.upsample(flow, hidden)));
        flows
    }

    /// The flow after the last iteration, as [`Self::forward`].
    pub fn infer(&self, reference: Tensor<4>, real: Tensor<4>, iterations: usize) -> Tensor<4> {
        let [n, _, h, w] = reference.dims();
        let mut last = Tensor::zeros([n, 2, h, w], &reference.device());
        self.iterate(reference, real, iterations, |i, flow, hidden| {
            if i + 1 == iterations {
                last = self.upsample(flow, hidden);
            }
        });
        last
    }

    /// [`Self::infer`] on plain slices of `n` NCHW image pairs of side `size_px`; returns (n, 2, S, S).
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
        NetworkConfig::check_size(size_px)?;
        let image = |name, data| pictures(name, data, [n, 3, size_px, size_px], device);
        guarded_on(device, || {
            let flow = self.infer(image("reference", reference)?, image("real", real)?, iterations);
            Ok(read_together([flow])?.remove(0))
        })
    }

    /// Calls `each(i, flow at 1/8 (N, 2, S/8, S/8), hidden state)` after each iteration.
    fn iterate(
        &self,
        reference: Tensor<4>,
        real: Tensor<4>,
        iterations: usize,
        mut each: impl FnMut(usize, &Tensor<4>, &Tensor<4>),
    ) {
        let [n, _, h, w] = reference.dims();
        let pyramid = self.pyramid(reference.clone(), real);
        let (mut hidden, context) = self.context(reference);
        let context = self.update.context(&context);
        let mut flow = Tensor::zeros([n, 2, h / 8, w / 8], &hidden.device());
        for i in 0..iterations {
            flow = flow.detach();
            let motion = self.update.motion(pyramid.lookup(&flow), flow.clone());
            hidden = self.update.hidden(hidden, &motion, &context);
            flow = flow + self.update.delta(&hidden);
            each(i, &flow, &hidden);
        }
    }

    /// Correlation of reference and real image; both go through the encoder as one batch.
    fn pyramid(&self, reference: Tensor<4>, real: Tensor<4>) -> Pyramid {
        let n = reference.dims()[0];
        let both = self.feature_encoder.forward(Tensor::cat(vec![reference, real], 0));
        Pyramid::new(both.clone().narrow(0, 0, n), both.narrow(0, n, n), self.arch.widths().radius, LEVELS)
    }

    /// First hidden state and context of the reference.
    fn context(&self, reference: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
        let widths = self.arch.widths();
        let both = self.context_encoder.forward(reference);
        let hidden = both.clone().narrow(1, 0, widths.hidden).tanh();
        (hidden, activation::relu(both.narrow(1, widths.hidden, widths.context)))
    }

    fn upsample(&self, flow: &Tensor<4>, hidden: &Tensor<4>) -> Tensor<4> {
        match self.update.mask(hidden) {
            Some(mask) => upsample::convex(flow.clone(), mask),
            None => ops::upsample_bilinear(flow.clone()),
        }
    }
}

impl Trainable for NetworkConfig {
    type Network = Raft;

    fn build(&self, weights: &Weights, device: &Device) -> Result<Raft> {
        Raft::new(weights, self, device)
    }

    fn parameters(network: &Raft) -> &[Parameter] {
        &network.parameters
    }
}
