//! The loss of a flow that says how sure it is.

use super::math::{exp, ln, sigmoid};
use super::{Array, BackwardCall, Kernel, View, vectorize};
use rayon::prelude::*;

/// Scale of the mixture's sure component, px: one pixel, so that its share of the loss is an L1 loss.
pub(crate) const SURE_SCALE_PX: f32 = 1.0;
/// Largest logarithm of the unsure component's scale over [`SURE_SCALE_PX`].
pub(crate) const MAX_LOG_SCALE: f32 = 5.0;
/// Channels of a prediction: flow x, y, logit of the sure component, raw scale of the unsure one, logit of visibility.
pub(crate) const CHANNELS: usize = 5;
/// Pixels whose terms are computed together.
const RUN: usize = 256;

/// Negative logarithm of a mixture of two Laplace distributions, one of fixed scale (SEA-RAFT, Wang et al., ECCV 2024, equation
/// 4, with one decision for both coordinates), and the cross entropy of the visibility.
///
/// With d the flow's error, `s = sigmoid(logit)`, `b = exp(5 sigmoid(raw))`, scale 1 px for the sure component:
/// `-ln(s e^-|d|_1 / 4 + (1 - s) e^(-|d|_1 / b) / (4 b^2))` over the pixels whose flow counts, divided by their number;
/// plus `visibility_weight` times the mean cross entropy over the foreground.
///
/// Inputs: prediction (N, 5, H, W), target (N, 4, H, W): true flow x and y, whether the flow counts, and visibility: 1 seen,
/// 0 hidden, -1 no foreground. Output: a tensor of shape (1). Only the prediction gets a gradient.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MixtureLoss {
    /// Weight of the visibility's cross entropy.
    pub(crate) visibility_weight: f32,
}

/// Value and derivatives by (flow x, flow y, logit, raw scale) of the mixture's term at one pixel.
#[inline(always)]
fn mixture(d: [f32; 2], logit: f32, raw: f32) -> (f32, [f32; 4]) {
    let l1 = d[0].abs() + d[1].abs();
    let s = sigmoid(logit);
    let share = sigmoid(raw);
    let log_b = MAX_LOG_SCALE * share;
    let inverse_b = exp(-log_b);
    // Logarithms of both components, without the common ln 4.
    let sure = -softplus(-logit) - l1 / SURE_SCALE_PX;
    let unsure = -softplus(logit) - l1 * inverse_b / SURE_SCALE_PX - 2.0 * log_b;
    let top = if sure > unsure { sure } else { unsure };
    let (e_sure, e_unsure) = (exp(sure - top), exp(unsure - top));
    let sum = e_sure + e_unsure;
    let value = ln(4.0) + 2.0 * ln(SURE_SCALE_PX) - top - ln(sum);
    let posterior = e_sure / sum;
    let slope = (posterior + (1.0 - posterior) * inverse_b) / SURE_SCALE_PX;
    let sign = |v: f32| if v == 0.0 { 0.0 } else { 1.0_f32.copysign(v) };
    // d ln(unsure) / d log b = l1 / b - 2.
    let by_log_b = -(1.0 - posterior) * (l1 * inverse_b / SURE_SCALE_PX - 2.0);
    let by_raw = by_log_b * MAX_LOG_SCALE * share * (1.0 - share);
    (value, [slope * sign(d[0]), slope * sign(d[1]), s - posterior, by_raw])
}

/// ln(1 + e^x).
#[inline(always)]
fn softplus(x: f32) -> f32 {
    let positive = if x > 0.0 { x } else { 0.0 };
    positive + ln(1.0 + exp(-x.abs()))
}

impl MixtureLoss {
    /// Sum of the flow weights and number of foreground pixels, at least 1.
    fn counts(target: &View<'_>) -> (f32, f32) {
        let area = target.shape[2] * target.shape[3];
        let (mut flow, mut foreground) = (0.0_f64, 0.0_f64);
        for image in target.data.chunks_exact(4 * area) {
            flow += image[2 * area..3 * area].iter().map(|&v| f64::from(v)).sum::<f64>();
            foreground += image[3 * area..].iter().filter(|v| **v >= 0.0).count() as f64;
        }
        (flow.max(1.0) as f32, foreground.max(1.0) as f32)
    }
}

impl MixtureLoss {
    /// Sums of both terms over one image, whose gradient is filled.
    #[inline(always)]
    fn image(&self, counts: [f32; 2], prediction: &[f32], target: &[f32], gradient: &mut [f32]) -> [f64; 2] {
        let area = target.len() / 4;
        let mut sums = [0.0_f64; 2];
        for start in (0..area).step_by(RUN) {
            let count = RUN.min(area - start);
            let mut terms = [[0.0; RUN]; 2];
            let [flow_terms, seen_terms] = &mut terms;
            let [px, py, logit, raw, visible] = std::array::from_fn(|k| &prediction[k * area + start..][..count]);
            let [tx, ty, weight, seen] = std::array::from_fn(|k| &target[k * area + start..][..count]);
            let mut slopes = [[0.0; RUN]; CHANNELS];
            for i in 0..count {
                let (value, by) = mixture([px[i] - tx[i], py[i] - ty[i]], logit[i], raw[i]);
                let (counts_here, scale) = (weight[i] > 0.0, weight[i] / counts[0]);
                flow_terms[i] = if counts_here { weight[i] * value } else { 0.0 };
                for k in 0..4 {
                    slopes[k][i] = if counts_here { by[k] * scale } else { 0.0 };
                }
            }
            for i in 0..count {
                let foreground = seen[i] >= 0.0;
                let slope = self.visibility_weight * (sigmoid(visible[i]) - seen[i]) / counts[1];
                seen_terms[i] = if foreground { softplus(visible[i]) - seen[i] * visible[i] } else { 0.0 };
                slopes[4][i] = if foreground { slope } else { 0.0 };
            }
            for (k, slopes) in slopes.iter().enumerate() {
                gradient[k * area + start..][..count].copy_from_slice(&slopes[..count]);
            }
            for (sum, terms) in sums.iter_mut().zip(&terms) {
                *sum += terms[..count].iter().map(|&v| f64::from(v)).sum::<f64>();
            }
        }
        sums
    }
}

impl Kernel for MixtureLoss {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [prediction, target] = [inputs[0], inputs[1]];
        let area = target.shape[2] * target.shape[3];
        let (flow_count, foreground_count) = Self::counts(&target);
        let mut gradient = vec![0.0; prediction.data.len()];
        let sums: Vec<[f64; 2]> = gradient
            .par_chunks_mut(CHANNELS * area)
            .zip(prediction.data.par_chunks(CHANNELS * area))
            .zip(target.data.par_chunks(4 * area))
            .map(|((gradient, p), t)| {
                vectorize(
                    #[inline(always)]
                    || self.image([flow_count, foreground_count], p, t, gradient),
                )
            })
            .collect();
        let [flow, visibility] = [0, 1].map(|k| sums.iter().map(|s| s[k]).sum::<f64>() as f32);
        let value = flow / flow_count + self.visibility_weight * visibility / foreground_count;
        (Array { shape: vec![1], data: vec![value] }, if keep { gradient } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let data = call.kept.iter().map(|g| g * call.grad[0]).collect();
        vec![Some(Array { shape: call.inputs[0].shape.to_vec(), data }), None]
    }
}
