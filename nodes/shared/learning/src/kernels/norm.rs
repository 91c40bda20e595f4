//! Instance normalisation and the residual sum.

use super::conv::plane_sum;
use super::{Array, BackwardCall, Kernel, View, vectorize};
use rayon::prelude::*;

/// PyTorch's default.
const EPSILON: f32 = 1e-5;
/// Planes a task takes at least, so that small planes do not drown in scheduling.
const PLANES: usize = 8;

/// `(x - mean) / sqrt(var + 1e-5)` over each plane (biased variance, no affine part), then ReLU if asked.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InstanceNorm {
    /// Clamp the result at zero.
    pub(crate) relu: bool,
}

impl InstanceNorm {
    #[inline(always)]
    fn forward_plane(self, x: &[f32], y: &mut [f32]) -> [f32; 2] {
        let n = x.len() as f32;
        let mean = plane_sum(x) / n;
        y.iter_mut().zip(x).for_each(|(y, x)| *y = (x - mean) * (x - mean));
        let scale = 1.0 / (plane_sum(y) / n + EPSILON).sqrt();
        let floor = if self.relu { 0.0 } else { f32::NEG_INFINITY };
        for (y, x) in y.iter_mut().zip(x) {
            let v = (x - mean) * scale;
            *y = if v < floor { floor } else { v };
        }
        [mean, scale]
    }

    #[inline(always)]
    /// `dx = scale (g - mean(g) - xhat mean(g xhat))`.
    fn backward_plane(self, x: &[f32], y: &[f32], g: &[f32], [mean, scale]: [f32; 2], dx: &mut [f32]) {
        let n = x.len() as f32;
        let masked = |g: f32, y: f32| if self.relu && y <= 0.0 { 0.0 } else { g };
        let (mut lanes_g, mut lanes_gx) = ([0.0_f32; 16], [0.0_f32; 16]);
        for ((x, y), g) in x.chunks(16).zip(y.chunks(16)).zip(g.chunks(16)) {
            for i in 0..x.len() {
                let g = masked(g[i], y[i]);
                lanes_g[i] += g;
                lanes_gx[i] += g * (x[i] - mean);
            }
        }
        let mean_g = lanes_g.iter().sum::<f32>() / n;
        let slope = lanes_gx.iter().sum::<f32>() / n * scale * scale;
        for i in 0..x.len() {
            dx[i] = scale * (masked(g[i], y[i]) - mean_g - (x[i] - mean) * slope);
        }
    }
}

impl Kernel for InstanceNorm {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let x = inputs[0];
        let area = x.shape[2] * x.shape[3];
        let mut y = Array::zeros(x.shape);
        let stats: Vec<[f32; 2]> = y
            .data
            .par_chunks_mut(area)
            .zip(x.data.par_chunks(area))
            .with_min_len(PLANES)
            .map(|(y, x)| {
                vectorize(
                    #[inline(always)]
                    || self.forward_plane(x, y),
                )
            })
            .collect();
        (y, stats.into_iter().flatten().collect())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let x = call.inputs[0];
        let area = x.shape[2] * x.shape[3];
        let mut dx = Array::zeros(x.shape);
        dx.data.par_chunks_mut(area).enumerate().with_min_len(PLANES).for_each(|(i, dx)| {
            let range = i * area..(i + 1) * area;
            let stats = [call.kept[2 * i], call.kept[2 * i + 1]];
            let [x, y, g] = [x.data, call.output.data, call.grad].map(|d| &d[range.clone()]);
            vectorize(
                #[inline(always)]
                || self.backward_plane(x, y, g, stats, dx),
            );
        });
        vec![Some(dx)]
    }
}

/// `max(a + b, 0)`: the end of a residual block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AddRelu;

impl Kernel for AddRelu {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let [a, b] = [inputs[0], inputs[1]];
        assert_eq!(a.shape, b.shape, "shapes of a residual sum");
        let mut y = Array::zeros(a.shape);
        let part = 16_384;
        y.data.par_chunks_mut(part).zip(a.data.par_chunks(part)).zip(b.data.par_chunks(part)).for_each(
            |((y, a), b)| {
                for i in 0..y.len() {
                    let sum = a[i] + b[i];
                    y[i] = if sum < 0.0 { 0.0 } else { sum };
                }
            },
        );
        (y, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let data = super::relu_mask(call.grad, call.output.data);
        let grad = Array { shape: call.output.shape.to_vec(), data };
        let both = call.wanted[0] && call.wanted[1];
        let second = both.then(|| grad.clone());
        if both {
            vec![Some(grad), second]
        } else if call.wanted[0] {
            vec![Some(grad), None]
        } else {
            vec![None, Some(grad)]
        }
    }
}
