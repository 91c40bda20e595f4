//! A network in burn: built from weights, with the trained tensors that gradients belong to.

use burn::tensor::{Device, Gradients, Tensor, TensorData, Transaction};
use pseudoflow_network::{BATCH_NORM_EPSILON, Model, NamedTensor, NetworkError, Result, Weights};
use std::cell::RefCell;
use std::collections::HashMap;

/// A configured architecture that burn computes.
pub trait Trainable: Model {
    /// The network with its weights on a device.
    type Network;

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
    fn name(&self) -> &str {
        match self {
            Self::Conv(name, _) | Self::Vector(name, _) => name,
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Conv(_, t) => t.dims().iter().product(),
            Self::Vector(_, t) => t.dims()[0],
        }
    }

    /// Row after row in one dimension; `None` where the loss does not touch the tensor.
    fn gradient(&self, grads: &Gradients) -> Option<Tensor<1>> {
        match self {
            Self::Conv(_, t) => t.grad(grads).map(|grad| grad.reshape([self.len()])),
            Self::Vector(_, t) => t.grad(grads),
        }
    }
}

/// Row-major values of tensors by their names.
pub(crate) type ByName = HashMap<String, Vec<f32>>;

/// Gradients of all trained tensors by name, row-major, zeros where the loss does not touch one; and `others`, which
/// are read with them: a GPU is waited for once.
///
/// # Errors
/// The device failed.
pub(crate) fn gradients_with<M: Trainable>(
    network: &M::Network,
    grads: &Gradients,
    others: Vec<Tensor<1>>,
) -> Result<(ByName, Vec<Vec<f32>>)> {
    let found: Vec<_> = M::parameters(network).iter().map(|p| (p, p.gradient(grads))).collect();
    let count = others.len();
    let mut others = read_together(others.into_iter().chain(found.iter().filter_map(|(_, grad)| grad.clone())))?;
    let mut read = others.split_off(count).into_iter();
    let by_name = found.iter().map(|(parameter, grad)| {
        let values = grad.as_ref().and_then(|_| read.next());
        (parameter.name().to_owned(), values.unwrap_or_else(|| vec![0.0; parameter.len()]))
    });
    Ok((by_name.collect(), others))
}

/// Pictures (n, channels, S, S) on a device from a plain slice; `name` is named in the error.
///
/// # Errors
/// The slice has another length.
pub(crate) fn pictures(name: &str, data: &[f32], shape: [usize; 4], device: &Device) -> Result<Tensor<4>> {
    if data.len() != shape.iter().product::<usize>() {
        return Err(NetworkError::Batch(format!("`{name}` has {} values, {shape:?} needed", data.len())));
    }
    Ok(Tensor::from_data(TensorData::new(data.to_vec(), shape), device))
}

/// The values of several tensors in one transfer.
///
/// # Errors
/// The device failed.
pub(crate) fn read_together<const D: usize>(tensors: impl IntoIterator<Item = Tensor<D>>) -> Result<Vec<Vec<f32>>> {
    // Gradients are plain, what the loss was made of is not: a transfer takes one kind.
    let tensors: Vec<Tensor<D>> = tensors.into_iter().map(Tensor::inner).collect();
    let device = tensors.first().map(|t| format!("{:?}", t.device())).unwrap_or_default();
    let read = tensors.into_iter().fold(Transaction::default(), Transaction::register);
    let data = read.try_execute().map_err(|e| NetworkError::DeviceFailed { device, cause: e.to_string() })?;
    Ok(data.into_iter().map(|data| data.try_into_vec::<f32>().expect("the network works in f32")).collect())
}

/// Gives the parts of a network their tensors by name.
pub(crate) struct Source<'a> {
    tensors: HashMap<&'a str, &'a NamedTensor>,
    parameters: RefCell<Vec<Parameter>>,
    device: &'a Device,
}

impl<'a> Source<'a> {
    /// Checks that the weights have every tensor of the model.
    pub(crate) fn new(weights: &'a Weights, model: &impl Model, device: &'a Device) -> Result<Self> {
        model.check_weights(weights)?;
        let tensors = weights.tensors().iter().map(|t| (t.name.as_str(), t)).collect();
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
