//! Learned upsampling (Teed and Deng, RAFT, section 3.3) of any number of channels.

use super::math::exp;
use super::{Array, BackwardCall, Kernel, View, vectorize};
use pseudoflow_network::UPSAMPLING;
use rayon::prelude::*;

/// Fine pixels of a coarse one, and the coarse ones that they mix.
const FINE: usize = UPSAMPLING * UPSAMPLING;
const NEIGHBOURS: usize = 9;

/// Each fine pixel is a convex combination of the 3x3 coarse pixels around it, zeros outside. Inputs: x (N, C, h, w), logits
/// (N, 9 * 64, h, w), in RAFT's order: channel `64 k + 8 fy + fx` belongs to neighbour k and fine pixel (fy, fx). Output
/// (N, C, 8 h, 8 w).
#[derive(Debug, Clone, Copy)]
pub(crate) struct ConvexUpsample;

/// Softmax over the neighbours for one image: logits (9, 64 area) to weights.
#[inline(always)]
fn softmax(logits: &[f32], weights: &mut [f32]) {
    let n = logits.len() / NEIGHBOURS;
    let mut top = logits[..n].to_vec();
    for k in 1..NEIGHBOURS {
        top.iter_mut().zip(&logits[k * n..][..n]).for_each(|(t, &v)| *t = if v > *t { v } else { *t });
    }
    let mut sum = vec![0.0_f32; n];
    for k in 0..NEIGHBOURS {
        let (w, l) = (&mut weights[k * n..][..n], &logits[k * n..][..n]);
        for i in 0..n {
            w[i] = exp(l[i] - top[i]);
        }
        sum.iter_mut().zip(&*w).for_each(|(s, v)| *s += v);
    }
    sum.iter_mut().for_each(|s| *s = 1.0 / *s);
    for k in 0..NEIGHBOURS {
        weights[k * n..][..n].iter_mut().zip(&sum).for_each(|(w, s)| *w *= s);
    }
}

/// A plane shifted so that index i holds the neighbour k of i, zeros outside.
#[inline(always)]
fn shifted(plane: &[f32], [h, w]: [usize; 2], k: usize) -> Vec<f32> {
    let mut out = vec![0.0; h * w];
    each_row([h, w], k, |target, source, count| {
        out[target..target + count].copy_from_slice(&plane[source..source + count]);
    });
    out
}

/// Calls `f(index, index of its neighbour k, count)` for the runs that have such a neighbour.
#[inline(always)]
fn each_row([h, w]: [usize; 2], k: usize, mut f: impl FnMut(usize, usize, usize)) {
    let (ky, kx) = (k / 3, k % 3);
    let first = usize::from(kx == 0);
    let count = w - first - usize::from(kx == 2);
    for y in 0..h {
        let source_y = y + ky;
        if (1..=h).contains(&source_y) && count > 0 {
            f(y * w + first, (source_y - 1) * w + first + kx - 1, count);
        }
    }
}

/// Sorts (64, h, w), fine pixels of all coarse ones, into a plane (8 h, 8 w).
#[inline(always)]
fn to_fine(sorted: &[f32], [h, w]: [usize; 2], plane: &mut [f32]) {
    for (fine, values) in sorted.chunks_exact(h * w).enumerate() {
        let (fy, fx) = (fine / UPSAMPLING, fine % UPSAMPLING);
        for (y, row) in values.chunks_exact(w).enumerate() {
            let line = &mut plane[(y * UPSAMPLING + fy) * w * UPSAMPLING..][..w * UPSAMPLING];
            line[fx..].iter_mut().step_by(UPSAMPLING).zip(row).for_each(|(p, v)| *p = *v);
        }
    }
}

/// The inverse of [`to_fine`].
#[inline(always)]
fn from_fine(plane: &[f32], [h, w]: [usize; 2]) -> Vec<f32> {
    let mut sorted = vec![0.0; FINE * h * w];
    for (fine, values) in sorted.chunks_exact_mut(h * w).enumerate() {
        let (fy, fx) = (fine / UPSAMPLING, fine % UPSAMPLING);
        for (y, row) in values.chunks_exact_mut(w).enumerate() {
            let line = &plane[(y * UPSAMPLING + fy) * w * UPSAMPLING..][..w * UPSAMPLING];
            row.iter_mut().zip(line[fx..].iter().step_by(UPSAMPLING)).for_each(|(v, p)| *v = *p);
        }
    }
    sorted
}

#[inline(always)]
fn forward_image(x: &[f32], size: [usize; 2], weights: &[f32], y: &mut [f32]) {
    let area = size[0] * size[1];
    let mut sorted = vec![0.0; FINE * area];
    for (plane, y) in x.chunks_exact(area).zip(y.chunks_exact_mut(FINE * area)) {
        sorted.fill(0.0);
        for k in 0..NEIGHBOURS {
            let neighbour = shifted(plane, size, k);
            let weights = &weights[k * FINE * area..][..FINE * area];
            for (sum, w) in sorted.chunks_exact_mut(area).zip(weights.chunks_exact(area)) {
                for i in 0..area {
                    sum[i] += w[i] * neighbour[i];
                }
            }
        }
        to_fine(&sorted, size, y);
    }
}

/// Gradients of one image: by x, and by the logits through the softmax, `dl_k = w_k (dw_k - sum_j w_j dw_j)`.
#[inline(always)]
fn backward_image(x: &[f32], size: [usize; 2], weights: &[f32], grad: &[f32], dx: &mut [f32], dlogits: &mut [f32]) {
    let area = size[0] * size[1];
    let n = FINE * area;
    for (c, plane) in x.chunks_exact(area).enumerate() {
        let g = from_fine(&grad[c * n..][..n], size);
        for k in 0..NEIGHBOURS {
            let neighbour = shifted(plane, size, k);
            let (w, dw) = (&weights[k * n..][..n], &mut dlogits[k * n..][..n]);
            let mut back = vec![0.0; area];
            for fine in 0..FINE {
                let range = fine * area..(fine + 1) * area;
                let (w, g, dw) = (&w[range.clone()], &g[range.clone()], &mut dw[range]);
                for i in 0..area {
                    back[i] += w[i] * g[i];
                    dw[i] += g[i] * neighbour[i];
                }
            }
            let dx = &mut dx[c * area..][..area];
            each_row(size, k, |target, source, count| {
                dx[source..source + count].iter_mut().zip(&back[target..target + count]).for_each(|(d, b)| *d += b);
            });
        }
    }
    let mut mean = vec![0.0; n];
    for k in 0..NEIGHBOURS {
        let (w, dw) = (&weights[k * n..][..n], &dlogits[k * n..][..n]);
        (0..n).for_each(|i| mean[i] += w[i] * dw[i]);
    }
    for k in 0..NEIGHBOURS {
        let (w, dw) = (&weights[k * n..][..n], &mut dlogits[k * n..][..n]);
        (0..n).for_each(|i| dw[i] = w[i] * (dw[i] - mean[i]));
    }
}

impl Kernel for ConvexUpsample {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [x, logits] = [inputs[0], inputs[1]];
        let [n, c, h, w] = x.nchw();
        assert_eq!(logits.shape, [n, NEIGHBOURS * FINE, h, w], "shape of the upsampling logits");
        let mut y = Array::zeros(&[n, c, UPSAMPLING * h, UPSAMPLING * w]);
        let each = NEIGHBOURS * FINE * h * w;
        let mut weights = vec![0.0; logits.data.len()];
        let parts = y.data.par_chunks_mut(c * FINE * h * w).zip(weights.par_chunks_mut(each));
        parts.zip(x.data.par_chunks(c * h * w)).zip(logits.data.par_chunks(each)).for_each(
            |(((y, weights), x), logits)| {
                vectorize(
                    #[inline(always)]
                    || {
                        softmax(logits, weights);
                        forward_image(x, [h, w], weights, y);
                    },
                );
            },
        );
        (y, if keep { weights } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [x, logits] = [call.inputs[0], call.inputs[1]];
        let [_, c, h, w] = x.nchw();
        let (mut dx, mut dlogits) = (Array::zeros(x.shape), Array::zeros(logits.shape));
        let each = NEIGHBOURS * FINE * h * w;
        let outputs = dx.data.par_chunks_mut(c * h * w).zip(dlogits.data.par_chunks_mut(each));
        let inputs = x.data.par_chunks(c * h * w).zip(call.kept.par_chunks(each));
        outputs.zip(inputs).zip(call.grad.par_chunks(c * FINE * h * w)).for_each(
            |(((dx, dlogits), (x, weights)), grad)| {
                vectorize(
                    #[inline(always)]
                    || backward_image(x, [h, w], weights, grad, dx, dlogits),
                );
            },
        );
        vec![Some(dx), Some(dlogits)]
    }
}
