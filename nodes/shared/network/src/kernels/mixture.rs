//! The loss of a flow that says how sure it is.

use super::math::{exp, sigmoid};
use super::{Array, BackwardCall, Kernel, View};
use rayon::prelude::*;

/// Scale of the mixture's sure component, px: one pixel, so that its share of the loss is an L1 loss.
pub(crate) const SURE_SCALE_PX: f32 = 1.0;
/// Largest logarithm of the unsure component's scale over [`SURE_SCALE_PX`].
pub(crate) const MAX_LOG_SCALE: f32 = 5.0;
/// Channels of a prediction: flow x, y, logit of the sure component, raw scale of the unsure one, logit of visibility.
pub(crate) const CHANNELS: usize = 5;

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
    let value = 4.0_f32.ln() + 2.0 * SURE_SCALE_PX.ln() - top - sum.ln();
    let posterior = e_sure / sum;
    let slope = (posterior + (1.0 - posterior) * inverse_b) / SURE_SCALE_PX;
    let sign = |v: f32| f32::from(i8::from(v > 0.0) - i8::from(v < 0.0));
    // d ln(unsure) / d log b = l1 / b - 2.
    let by_log_b = -(1.0 - posterior) * (l1 * inverse_b / SURE_SCALE_PX - 2.0);
    let by_raw = by_log_b * MAX_LOG_SCALE * share * (1.0 - share);
    (value, [slope * sign(d[0]), slope * sign(d[1]), s - posterior, by_raw])
}

/// ln(1 + e^x).
#[inline(always)]
fn softplus(x: f32) -> f32 {
    let positive = if x > 0.0 { x } else { 0.0 };
    positive + exp(-x.abs()).ln_1p()
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
                let (mut flow, mut visibility) = (0.0_f64, 0.0_f64);
                for i in 0..area {
                    let weight = t[2 * area + i];
                    if weight > 0.0 {
                        let d = [p[i] - t[i], p[area + i] - t[area + i]];
                        let (value, slopes) = mixture(d, p[2 * area + i], p[3 * area + i]);
                        flow += f64::from(weight * value);
                        (0..4).for_each(|k| gradient[k * area + i] = slopes[k] * weight / flow_count);
                    }
                    let seen = t[3 * area + i];
                    if seen >= 0.0 {
                        let logit = p[4 * area + i];
                        visibility += f64::from(softplus(logit) - seen * logit);
                        gradient[4 * area + i] = self.visibility_weight * (sigmoid(logit) - seen) / foreground_count;
                    }
                }
                [flow, visibility]
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
