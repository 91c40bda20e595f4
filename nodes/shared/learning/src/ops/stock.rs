//! The same operations from burn's stock ones: for GPU devices, and the reference in the kernels' tests.

#[cfg(test)]
use super::ConvSpec;
use crate::kernels::{MAX_LOG_SCALE, SURE_SCALE_PX};
use burn::tensor::activation::{relu, sigmoid, softmax, softplus};
use burn::tensor::{Device, Tensor, TensorData};
#[cfg(test)]
use burn::tensor::{module, ops::ConvOptions};

/// burn's own convolution; GPUs use [`super::columns`].
#[cfg(test)]
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
        let data = TensorData::new(pseudoflow_network::align_corners_matrix(n), [1, 1, 8 * n, n]);
        Tensor::from_data(data, &device)
    };
    matrix(h).matmul(flow * 8.0).matmul(matrix(w).swap_dims(2, 3))
}

pub(super) fn masked_l1(flow: Tensor<4>, target: Tensor<4>, mask: Tensor<4>) -> Tensor<1> {
    ((flow - target).abs() * mask).sum()
}

pub(super) fn gated_update(a: Tensor<4>, c: Tensor<4>, h: Tensor<4>) -> Tensor<4> {
    let channels = h.dims()[1];
    let sum = a + c;
    let z = sigmoid(half(sum.clone(), channels, 0));
    let q = half(sum, channels, 1).tanh();
    h.clone() + z * (q - h)
}

pub(super) fn upsample_convex(x: Tensor<4>, logits: Tensor<4>) -> Tensor<4> {
    let [n, c, h, w] = x.dims();
    let weights = softmax(logits.reshape([n, 9, 64, h, w]), 1);
    let side = Tensor::zeros([n, c, h, 1], &x.device());
    let wide = Tensor::cat(vec![side.clone(), x, side], 3);
    let edge = Tensor::zeros([n, c, 1, w + 2], &wide.device());
    let padded = Tensor::cat(vec![edge.clone(), wide, edge], 2);
    let mixed = (0..9).map(|k| {
        let neighbour = padded.clone().narrow(2, k / 3, h).narrow(3, k % 3, w).reshape([n, c, 1, h, w]);
        neighbour * weights.clone().narrow(1, k, 1)
    });
    let sum: Tensor<5> = mixed.reduce(|a, b| a + b).expect("nine neighbours");
    // (n, c, fy, fx, y, x) to (n, c, y, fy, x, fx).
    let fine: Tensor<6> = sum.reshape([n, c, 8, 8, h, w]);
    fine.permute([0, 1, 4, 2, 5, 3]).reshape([n, c, 8 * h, 8 * w])
}

pub(super) fn mixture_loss(prediction: Tensor<4>, target: Tensor<4>, visibility_weight: f32) -> Tensor<1> {
    let channel = |t: &Tensor<4>, k: usize| t.clone().narrow(1, k, 1);
    let l1 = (prediction.clone().narrow(1, 0, 2) - target.clone().narrow(1, 0, 2)).abs().sum_dim(1) / SURE_SCALE_PX;
    let log_b = sigmoid(channel(&prediction, 3)) * MAX_LOG_SCALE;
    let logit = channel(&prediction, 2);
    let sure = l1.clone().neg() - softplus(logit.clone().neg(), 1.0);
    let unsure = l1.neg() * log_b.clone().neg().exp() - log_b * 2.0 - softplus(logit, 1.0);
    // ln(e^a + e^b) = a + ln(1 + e^(b - a)).
    let nll = (sure.clone() + softplus(unsure - sure, 1.0)).neg() + (4.0 * SURE_SCALE_PX * SURE_SCALE_PX).ln();
    let counts = channel(&target, 2);
    let flow = (nll * counts.clone()).sum() / counts.sum().clamp_min(1.0);
    let seen = channel(&target, 3);
    let foreground = seen.clone().greater_equal_elem(0.0).float();
    let logit = channel(&prediction, 4);
    let entropy = (softplus(logit.clone(), 1.0) - seen * logit) * foreground.clone();
    flow + entropy.sum() / foreground.sum().clamp_min(1.0) * visibility_weight
}
