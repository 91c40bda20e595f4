//! What weights, optimiser and checkpoints need to know of a network: the flow network and the initializer's share them.

use crate::error::{NetworkError, Result};
use crate::weights::{NamedTensor, Weights};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use std::cell::RefCell;
use std::collections::HashMap;

/// How a tensor starts when a network is trained from scratch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Init {
    /// Normal with standard deviation sqrt(2 / fan out).
    KaimingNormal,
    /// Uniform in +-1 / sqrt(fan in), the given number: PyTorch's default for weights and biases.
    Uniform(usize),
    /// A constant.
    Constant(f32),
}

/// One tensor of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct TensorSpec {
    /// Name, unique in the network.
    pub name: String,
    /// Shape, outermost first.
    pub shape: Vec<usize>,
    /// How it starts.
    pub init: Init,
}

/// A configured architecture, and how it is built from weights.
pub trait Model: Clone {
    /// The network with its weights on a device.
    type Network;

    /// Name, written into the weights.
    fn name(&self) -> &str;

    /// Fingerprint of what decides the weights' meaning.
    fn hash(&self) -> String;

    /// All tensors in a fixed order.
    fn layout(&self) -> Vec<TensorSpec>;

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    fn check(&self) -> Result<()>;

    /// Builds the network; the device decides backend and autodiff.
    ///
    /// # Errors
    /// The weights belong to another architecture.
    fn build(&self, weights: &Weights, device: &Device) -> Result<Self::Network>;

    /// The trained tensors of a network.
    fn parameters(network: &Self::Network) -> &[Parameter];
}

/// A trained tensor as the network uses it.
#[derive(Debug, Clone)]
pub enum Parameter {
    /// Weights of a convolution.
    Conv(String, Tensor<4>),
    /// A bias, scale or shift.
    Vector(String, Tensor<1>),
}

impl Parameter {
    /// Name and gradient, row-major; zeros where the loss does not touch the tensor.
    pub(crate) fn gradient(&self, grads: &Gradients) -> (String, Vec<f32>) {
        let values = |data: TensorData| data.try_into_vec::<f32>().expect("the network works in f32");
        match self {
            Self::Conv(name, t) => {
                let grad = t.grad(grads).map(|g| values(g.into_data()));
                (name.clone(), grad.unwrap_or_else(|| vec![0.0; t.dims().iter().product()]))
            }
            Self::Vector(name, t) => {
                let grad = t.grad(grads).map(|g| values(g.into_data()));
                (name.clone(), grad.unwrap_or_else(|| vec![0.0; t.dims()[0]]))
            }
        }
    }
}

/// Gradients of all trained tensors by name, row-major.
pub(crate) fn gradients<M: Model>(network: &M::Network, grads: &Gradients) -> HashMap<String, Vec<f32>> {
    M::parameters(network).iter().map(|parameter| parameter.gradient(grads)).collect()
}

/// Gives the parts of a network their tensors by name.
pub(crate) struct Source<'a> {
    tensors: HashMap<&'a str, &'a NamedTensor>,
    parameters: RefCell<Vec<Parameter>>,
    device: &'a Device,
}

/// Added to stored variances, as PyTorch does.
pub(crate) const BATCH_NORM_EPSILON: f32 = 1e-5;

impl<'a> Source<'a> {
    /// Checks that the weights have every tensor of the model.
    pub(crate) fn new(weights: &'a Weights, model: &impl Model, device: &'a Device) -> Result<Self> {
        let tensors: HashMap<_, _> = weights.tensors().iter().map(|t| (t.name.as_str(), t)).collect();
        for spec in model.layout() {
            if tensors.get(spec.name.as_str()).is_none_or(|t| t.shape != spec.shape) {
                let found =
                    tensors.get(spec.name.as_str()).map_or("is missing".into(), |t| format!("has {:?}", t.shape));
                return Err(NetworkError::WeightsMismatch {
                    origin: format!("weights of `{}`", weights.info.network),
                    network: model.name().to_owned(),
                    tensor: spec.name,
                    problem: format!("{found}, the network needs shape {:?}", spec.shape),
                });
            }
        }
        Ok(Self { tensors, parameters: RefCell::default(), device })
    }

    /// The tensors that were handed out, in that order.
    pub(crate) fn into_parameters(self) -> Vec<Parameter> {
        self.parameters.into_inner()
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

/// Fingerprint (FNV-1a, 64 bit, hex) of a text.
pub(crate) fn fingerprint(text: &str) -> String {
    let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}
