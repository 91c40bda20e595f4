//! CPU kernels with their gradients, on plain `f32` slices: no framework in here.
//!
//! All tensors are row-major NCHW. Work is split by image, channel or plane, never by thread, and partial sums are
//! added in a fixed order: results have the same bits for every number of threads.

mod blend;
mod conv;
mod convex;
mod gemm;
mod l1;
mod lookup;
mod math;
mod mixture;
mod norm;
mod scratch;
mod simd;
mod update;
mod upsample;
mod winograd;

pub(crate) use blend::{GruBlend, ResetGate};
pub(crate) use conv::Conv;
pub(crate) use convex::ConvexUpsample;
pub(crate) use l1::MaskedL1;
pub(crate) use lookup::Lookup;
pub(crate) use mixture::{MAX_LOG_SCALE, MixtureLoss, SURE_SCALE_PX};
pub(crate) use norm::{AddRelu, InstanceNorm};
pub(crate) use simd::vectorize;
pub(crate) use update::GatedUpdate;
pub(crate) use upsample::Upsample;
pub(crate) use winograd::{WinogradConv, transform_weights};

/// An owned tensor.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    /// Shape, outermost first.
    pub(crate) shape: Vec<usize>,
    /// Row-major values.
    pub(crate) data: Vec<f32>,
}

impl Array {
    /// Zeros of a shape.
    pub(crate) fn zeros(shape: &[usize]) -> Self {
        Self { shape: shape.to_vec(), data: vec![0.0; shape.iter().product()] }
    }
}

/// A borrowed tensor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<'a> {
    /// Shape, outermost first.
    pub(crate) shape: &'a [usize],
    /// Row-major values.
    pub(crate) data: &'a [f32],
}

impl View<'_> {
    /// The four sides of an NCHW tensor.
    pub(crate) fn nchw(&self) -> [usize; 4] {
        [self.shape[0], self.shape[1], self.shape[2], self.shape[3]]
    }
}

/// What the backward pass of a kernel gets.
pub(crate) struct BackwardCall<'a> {
    /// The inputs of the forward pass.
    pub(crate) inputs: &'a [View<'a>],
    /// Its output.
    pub(crate) output: View<'a>,
    /// What it kept.
    pub(crate) kept: &'a [f32],
    /// Gradient of the loss by the output.
    pub(crate) grad: &'a [f32],
    /// Which inputs need a gradient.
    pub(crate) wanted: &'a [bool],
}

/// A differentiable operation with one output.
pub(crate) trait Kernel: std::fmt::Debug + Send + Sync {
    /// Returns the output and, if `keep`, values that spare work in [`Kernel::backward`].
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>);

    /// Returns the gradient by each wanted input (`None` for the others), in the order of the inputs.
    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>>;
}

/// `grad` where `output > 0`, else 0: the gradient before a ReLU.
pub(crate) fn relu_mask(grad: &[f32], output: &[f32]) -> Vec<f32> {
    grad.iter().zip(output).map(|(&g, &y)| if y > 0.0 { g } else { 0.0 }).collect()
}

/// [`relu_mask`] into a buffer of at least this length.
pub(crate) fn relu_masked<'a>(grad: &[f32], output: &[f32], buffer: &'a mut [f32]) -> &'a [f32] {
    let buffer = &mut buffer[..grad.len()];
    for ((b, &g), &y) in buffer.iter_mut().zip(grad).zip(output) {
        *b = if y > 0.0 { g } else { 0.0 };
    }
    buffer
}

/// Sums of equal parts, added in their order.
pub(crate) fn sum_in_order(parts: &[Vec<f32>]) -> Vec<f32> {
    let mut total = parts[0].clone();
    for part in &parts[1..] {
        total.iter_mut().zip(part).for_each(|(t, p)| *t += p);
    }
    total
}
