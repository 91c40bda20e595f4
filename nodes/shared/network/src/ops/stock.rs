//! The same operations from burn's stock ones: for GPU devices, and the reference in the kernels' tests.

use super::ConvSpec;
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::module;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Tensor, TensorData};

pub(super) fn conv2d(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, spec: ConvSpec) -> Tensor<4> {
    let options = ConvOptions::new([spec.stride; 2], spec.pad, [1, 1], 1);
    let y = module::conv2d(x, w, Some(b), options);
    if spec.relu { relu(y) } else { y }
}

pub(super) fn instance_norm(x: Tensor<4>, with_relu: bool) -> Tensor<4> {
    let mean = x.clone().mean_dim(3).mean_dim(2);
    let centred = x - mean;
    let variance = centred.clone().powi_scalar(2).mean_dim(3).mean_dim(2);
    let y = centred / (variance + 1e-5).sqrt();
    if with_relu { relu(y) } else { y }
}

/// Linear interpolation in a map as a dense product: weight max(0, 1 - |position - texel|) per axis.
pub(super) fn lookup(pyramid: Tensor<3>, coords: Tensor<4>, radius: usize, levels: &[[usize; 2]]) -> Tensor<4> {
    let device = pyramid.device();
    let [n, _, h, w] = coords.dims();
    let side = 2 * radius + 1;
    let coords = coords.detach().reshape([n, 2, h * w]);
    let offsets = range(-(radius as f32), side, &device).reshape([1, 1, side, 1]);
    let mut start = 0;
    let mut blocks = Vec::new();
    for (level, &[lh, lw]) in levels.iter().enumerate() {
        let map = pyramid.clone().slice([0..n, 0..h * w, start..start + lh * lw]).reshape([n, h * w, lh, lw]);
        start += lh * lw;
        let scaled = coords.clone() / (1 << level) as f32;
        let axis = |which: usize, texels: usize| {
            let centre: Tensor<4> = scaled.clone().slice([0..n, which..which + 1]).reshape([n, h * w, 1, 1]);
            let texel = range(0.0, texels, &device).reshape([1, 1, 1, texels]);
            relu((centre + offsets.clone() - texel).abs().neg() + 1.0)
        };
        // (window y, lh) x (lh, lw) x (lw, window x), then the window's x comes first.
        let window = axis(1, lh).matmul(map).matmul(axis(0, lw).swap_dims(2, 3)).swap_dims(2, 3);
        blocks.push(window.reshape([n, h * w, side * side]));
    }
    Tensor::cat(blocks, 2).swap_dims(1, 2).reshape([n, levels.len() * side * side, h, w])
}

/// first, first + 1, ... as floats.
fn range(first: f32, count: usize, device: &Device) -> Tensor<1> {
    let values: Vec<f32> = (0..count).map(|i| first + i as f32).collect();
    Tensor::from_data(TensorData::new(values, [count]), device)
}

pub(super) fn reset_gate(a: Tensor<4>, c: Tensor<4>, h: Tensor<4>) -> Tensor<4> {
    let channels = h.dims()[1];
    sigmoid(half(a + c, channels, 1)) * h
}

pub(super) fn gru_blend([az, cz]: [Tensor<4>; 2], [aq, cq]: [Tensor<4>; 2], h: Tensor<4>) -> Tensor<4> {
    let channels = h.dims()[1];
    let z = sigmoid(half(az + cz, channels, 0));
    let q = (aq + cq).tanh();
    (z.clone().neg() + 1.0) * h + z * q
}

fn half(gates: Tensor<4>, channels: usize, which: usize) -> Tensor<4> {
    gates.narrow(1, which * channels, channels)
}

pub(super) fn upsample_bilinear(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, h, w] = flow.dims();
    let device = flow.device();
    let matrix = |n: usize| -> Tensor<4> {
        let data = TensorData::new(crate::kernels::align_corners_matrix(n), [1, 1, 8 * n, n]);
        Tensor::from_data(data, &device)
    };
    matrix(h).matmul(flow * 8.0).matmul(matrix(w).swap_dims(2, 3))
}

pub(super) fn masked_l1(flow: Tensor<4>, target: Tensor<4>, mask: Tensor<4>) -> Tensor<1> {
    ((flow - target).abs() * mask).sum()
}
