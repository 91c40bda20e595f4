//! The operations of the network on burn tensors: own kernels on the CPU (Flex), stock operations elsewhere.
//!
//! Both forms are differentiable and equal up to rounding; the tests hold them together.

mod columns;
mod extension;
pub(crate) mod stock;
#[cfg(test)]
mod tests;

use crate::kernels::{self, Kernel};
use burn::backend::{Dispatch, DispatchDevice};
use burn::tensor::{Device, Tensor};
use extension::KernelBackend;
use std::sync::Arc;

/// True if a device runs the own kernels.
pub(crate) fn has_kernels(device: &Device) -> bool {
    match device.as_dispatch() {
        DispatchDevice::Flex(_) => true,
        DispatchDevice::Autodiff(inner) => matches!(inner.clone().inner(), DispatchDevice::Flex(_)),
        #[allow(unreachable_patterns)]
        _ => false,
    }
}

/// Every pixel becomes four.
pub(crate) fn double(x: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let wide: Tensor<6> = x.reshape([n, c, h, 1, w, 1]);
    wide.expand([n, c, h, 2, w, 2]).reshape([n, c, 2 * h, 2 * w])
}

/// Runs a kernel on one tensor.
fn run1<const A: usize, const R: usize>(a: Tensor<A>, kernel: impl Kernel + 'static) -> Tensor<R> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::kernel1(a.into_dispatch(), Arc::new(kernel)))
}

/// Runs a kernel on two tensors.
fn run2<const A: usize, const B: usize, const R: usize>(
    a: Tensor<A>,
    b: Tensor<B>,
    kernel: impl Kernel + 'static,
) -> Tensor<R> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::kernel2(a.into_dispatch(), b.into_dispatch(), Arc::new(kernel)))
}

/// Runs a kernel on three tensors.
fn run3<const A: usize, const B: usize, const C: usize, const R: usize>(
    a: Tensor<A>,
    b: Tensor<B>,
    c: Tensor<C>,
    kernel: impl Kernel + 'static,
) -> Tensor<R> {
    let [a, b, c] = [a.into_dispatch(), b.into_dispatch(), c.into_dispatch()];
    Tensor::from_dispatch(<Dispatch as KernelBackend>::kernel3(a, b, c, Arc::new(kernel)))
}

/// Stride, padding and activation of a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvSpec {
    /// Step in both directions.
    pub stride: usize,
    /// Zeros added above and below, left and right.
    pub pad: [usize; 2],
    /// Clamp the result at zero.
    pub relu: bool,
}

/// Convolution: x (N, C, H, W), w (O, C, kh, kw), b (O) to (N, O, H', W').
pub fn conv2d(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, spec: ConvSpec) -> Tensor<4> {
    if !has_kernels(&x.device()) {
        return columns::conv2d(x, w, b, spec);
    }
    run3(x, w, b, kernels::Conv { stride: spec.stride, pad: spec.pad, relu: spec.relu })
}

/// Weights of a 3x3 convolution of stride 1, prepared once for several calls of [`conv3x3`].
#[derive(Debug, Clone)]
pub struct Prepared3x3 {
    weight: Tensor<4>,
    bias: Tensor<1>,
    /// Winograd's form of the weights on the CPU.
    transformed: Option<Arc<Vec<f32>>>,
}

impl Prepared3x3 {
    /// From w (O, C, 3, 3) and b (O).
    pub fn new(weight: Tensor<4>, bias: Tensor<1>) -> Self {
        let transformed = has_kernels(&weight.device()).then(|| {
            let data = weight.clone().detach().into_data();
            let data = data.try_into_vec::<f32>().expect("the network works in f32");
            Arc::new(kernels::transform_weights(&data))
        });
        Self { weight, bias, transformed }
    }
}

/// 3x3 convolution with stride 1 and padding 1: x (N, C, H, W) to (N, O, H, W).
pub fn conv3x3(x: Tensor<4>, prepared: &Prepared3x3, relu: bool) -> Tensor<4> {
    let (weight, bias) = (prepared.weight.clone(), prepared.bias.clone());
    match &prepared.transformed {
        Some(transformed) => run3(x, weight, bias, kernels::WinogradConv { transformed: transformed.clone(), relu }),
        None => columns::conv2d(x, weight, bias, ConvSpec { stride: 1, pad: [1, 1], relu }),
    }
}

/// Instance normalisation without affine part (epsilon 1e-5): x (N, C, H, W) to the same shape.
pub fn instance_norm(x: Tensor<4>, relu: bool) -> Tensor<4> {
    if !has_kernels(&x.device()) {
        return stock::instance_norm(x, relu);
    }
    run1(x, kernels::InstanceNorm { relu })
}

/// `max(a + b, 0)`.
pub fn add_relu(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&a.device()) {
        return burn::tensor::activation::relu(a + b);
    }
    run2(a, b, kernels::AddRelu)
}

/// RAFT's lookup: pyramid (N, h w, Q) and coordinates (N, 2, h, w), px of level 0, to (N, L (2 r + 1)^2, h, w).
/// `levels` lists height and width of each level; Q is the sum of their areas. The coordinates get no gradient.
pub fn lookup(pyramid: Tensor<3>, coords: Tensor<4>, radius: usize, levels: &[[usize; 2]]) -> Tensor<4> {
    if !has_kernels(&pyramid.device()) {
        return stock::lookup(pyramid, coords, radius, levels);
    }
    run2(pyramid, coords, kernels::Lookup { radius, levels: levels.to_vec() })
}

/// `sigmoid(a_r + c_r) h`: a and c (N, 2 C, h, w) hold update and reset gate, h is (N, C, h, w).
pub fn reset_gate(a: Tensor<4>, c: Tensor<4>, h: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&h.device()) {
        return stock::reset_gate(a, c, h);
    }
    run3(a, c, h, kernels::ResetGate)
}

/// `(1 - z) h + z q` with `z = sigmoid(a_z + c_z)`, `q = tanh(a_q + c_q)`; `gates` is the (a, c) of both gates as in
/// [`reset_gate`], `candidate` the (a, c) of q.
pub fn gru_blend(gates: [Tensor<4>; 2], candidate: [Tensor<4>; 2], h: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&h.device()) {
        return stock::gru_blend(gates, candidate, h);
    }
    let [az, cz, aq, cq] = [gates, candidate].concat().try_into().expect("two and two");
    let [az, cz, aq, cq, h] = [az, cz, aq, cq, h].map(Tensor::into_dispatch);
    Tensor::from_dispatch(<Dispatch as KernelBackend>::kernel5(az, cz, aq, cq, h, Arc::new(kernels::GruBlend)))
}

/// Eight times bilinear with `align_corners`, values times 8: (N, 2, h, w) to (N, 2, 8 h, 8 w).
pub fn upsample_bilinear(flow: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&flow.device()) {
        return stock::upsample_bilinear(flow);
    }
    run1(flow, kernels::Upsample)
}

/// `sum of mask (|dx| + |dy|)`: flow and target (N, 2, H, W), mask (N, 1, H, W).
pub fn masked_l1(flow: Tensor<4>, target: Tensor<4>, mask: Tensor<4>) -> Tensor<1> {
    if !has_kernels(&flow.device()) {
        return stock::masked_l1(flow, target, mask);
    }
    run3(flow, target, mask, kernels::MaskedL1)
}

/// [`reset_gate`]'s unit without a reset gate: `(1 - z) h + z q` with `z = sigmoid(a_z + c_z)`, `q = tanh(a_q + c_q)`; a and c
/// (N, 2 C, h, w) hold gate and candidate, h is (N, C, h, w).
pub fn gated_update(a: Tensor<4>, c: Tensor<4>, h: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&h.device()) {
        return stock::gated_update(a, c, h);
    }
    run3(a, c, h, kernels::GatedUpdate)
}

/// Learned upsampling by eight: x (N, C, h, w) and logits (N, 9 * 64, h, w) in RAFT's order to (N, C, 8 h, 8 w).
pub fn upsample_convex(x: Tensor<4>, logits: Tensor<4>) -> Tensor<4> {
    if !has_kernels(&x.device()) {
        return stock::upsample_convex(x, logits);
    }
    run2(x, logits, kernels::ConvexUpsample)
}

/// The loss of a flow that says how sure it is: prediction (N, 5, H, W) and target (N, 4, H, W) as the refiner has them
/// ([`crate::RefinerBatch`]) to a tensor of shape (1).
pub fn mixture_loss(prediction: Tensor<4>, target: Tensor<4>, visibility_weight: f32) -> Tensor<1> {
    if !has_kernels(&prediction.device()) {
        return stock::mixture_loss(prediction, target, visibility_weight);
    }
    run2(prediction, target, kernels::MixtureLoss { visibility_weight })
}
