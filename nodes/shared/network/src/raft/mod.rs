//! RAFT (Teed and Deng, "RAFT: Recurrent All-Pairs Field Transforms for Optical Flow", ECCV 2020) as method.md,
//! "Flow", states it: features of both images, context of the *reference* only, flow from zero, detached between
//! iterations.

mod conv;
mod correlation;
mod encoder;
mod layout;
#[cfg(test)]
mod parity;
mod update;
mod upsample;

pub(crate) use layout::{Init, LEVELS, TensorSpec};

use crate::config::{Architecture, NetworkConfig, check_size};
use crate::error::{NetworkError, Result};
use crate::ops;
use crate::weights::{NamedTensor, Weights};
use burn::tensor::{Device, Tensor, TensorData, activation};
use correlation::Pyramid;
use encoder::Encoder;
use std::collections::HashMap;
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

/// A trained tensor as the network uses it.
#[derive(Debug, Clone)]
enum Parameter {
    Conv(String, Tensor<4>),
    Vector(String, Tensor<1>),
}

/// Gives the parts of the network their tensors by name.
pub(crate) struct Source<'a> {
    arch: Architecture,
    tensors: HashMap<&'a str, &'a NamedTensor>,
    parameters: std::cell::RefCell<Vec<Parameter>>,
    device: &'a Device,
}

/// Added to stored variances, as PyTorch does.
pub(crate) const BATCH_NORM_EPSILON: f32 = 1e-5;

impl<'a> Source<'a> {
    fn new(weights: &'a Weights, config: &NetworkConfig, device: &'a Device) -> Result<Self> {
        let tensors: HashMap<_, _> = weights.tensors().iter().map(|t| (t.name.as_str(), t)).collect();
        for spec in config.arch.layout() {
            if tensors.get(spec.name.as_str()).is_none_or(|t| t.shape != spec.shape) {
                let found =
                    tensors.get(spec.name.as_str()).map_or("is missing".into(), |t| format!("has {:?}", t.shape));
                return Err(NetworkError::WeightsMismatch {
                    origin: format!("weights of `{}`", weights.info.network),
                    network: config.name.clone(),
                    tensor: spec.name,
                    problem: format!("{found}, the network needs shape {:?}", spec.shape),
                });
            }
        }
        Ok(Self { arch: config.arch, tensors, parameters: Default::default(), device })
    }

    fn tensor<const D: usize>(&self, name: &str) -> Tensor<D> {
        let tensor = self.tensors[name];
        Tensor::from_data(TensorData::new(tensor.data.clone(), tensor.shape.clone()), self.device)
    }

    fn trained<const D: usize>(&self, name: &str) -> Tensor<D> {
        let tensor = self.tensor(name);
        if self.device.is_autodiff() { tensor.require_grad() } else { tensor }
    }

    fn vector(&self, name: String) -> Tensor<1> {
        let tensor = self.trained(&name);
        self.parameters.borrow_mut().push(Parameter::Vector(name, tensor.clone()));
        tensor
    }

    /// Weight and bias of convolution `name`.
    pub(crate) fn conv(&self, name: &str) -> (Tensor<4>, Tensor<1>) {
        let weight_name = format!("{name}.weight");
        let weight = self.trained(&weight_name);
        self.parameters.borrow_mut().push(Parameter::Conv(weight_name, weight.clone()));
        (weight, self.vector(format!("{name}.bias")))
    }

    /// Scale and shift of batch norm `name` with its stored statistics; `None` if the network has no such norm.
    pub(crate) fn batch_norm(&self, name: &str) -> Option<[Tensor<1>; 2]> {
        self.tensors.get(format!("{name}.running_var").as_str())?;
        let [mean, var] = ["running_mean", "running_var"].map(|part| self.tensor::<1>(&format!("{name}.{part}")));
        let scale = self.vector(format!("{name}.weight")) / (var + BATCH_NORM_EPSILON).sqrt();
        let shift = self.vector(format!("{name}.bias")) - mean * scale.clone();
        Some([scale, shift])
    }
}

impl Raft {
    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    pub fn new(weights: &Weights, config: &NetworkConfig, device: &Device) -> Result<Self> {
        let source = Source::new(weights, config, device)?;
        let arch = source.arch;
        let feature_encoder = Encoder::new(&source, "fnet", arch, true);
        let context_encoder = Encoder::new(&source, "cnet", arch, false);
        let update = UpdateBlock::new(&source, arch);
        let parameters = source.parameters.into_inner();
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
    /// The size is not allowed or a slice has another length.
    pub fn infer_slices(
        &self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        iterations: usize,
        device: &Device,
    ) -> Result<Vec<f32>> {
        check_size(size_px)?;
        let image = |name: &str, data: &[f32]| {
            let shape = [n, 3, size_px, size_px];
            if data.len() != shape.iter().product::<usize>() {
                return Err(NetworkError::Batch(format!("`{name}` has {} values, {shape:?} needed", data.len())));
            }
            Ok(Tensor::<4>::from_data(TensorData::new(data.to_vec(), shape), device))
        };
        let flow = self.infer(image("reference", reference)?, image("real", real)?, iterations);
        Ok(flow.into_data().try_into_vec::<f32>().expect("the network works in f32"))
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
        Pyramid::new(both.clone().narrow(0, 0, n), both.narrow(0, n, n), self.arch.widths().radius)
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

    /// Gradients of all trained tensors by name, row-major; zeros for tensors that the loss does not touch.
    pub(crate) fn gradients(&self, grads: &burn::tensor::Gradients) -> HashMap<String, Vec<f32>> {
        let values = |data: TensorData| data.try_into_vec::<f32>().expect("the network works in f32");
        let entries = self.parameters.iter().map(|parameter| match parameter {
            Parameter::Conv(name, t) => {
                let grad = t.grad(grads).map(|g| values(g.into_data()));
                (name.clone(), grad.unwrap_or_else(|| vec![0.0; t.dims().iter().product()]))
            }
            Parameter::Vector(name, t) => {
                let grad = t.grad(grads).map(|g| values(g.into_data()));
                (name.clone(), grad.unwrap_or_else(|| vec![0.0; t.dims()[0]]))
            }
        });
        entries.collect()
    }
}
