//! The masked L1 distance of two flow fields.

use super::{Array, BackwardCall, Kernel, View};
use rayon::prelude::*;

/// `sum over n, y, x of mask (|dx| + |dy|)`, a tensor of shape (1). Inputs: flow and target (N, 2, H, W),
/// mask (N, 1, H, W). Only the flow gets a gradient; it is zero where both agree exactly.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MaskedL1;

impl Kernel for MaskedL1 {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let [flow, target, mask] = [inputs[0], inputs[1], inputs[2]];
        let area = flow.shape[2] * flow.shape[3];
        let sums: Vec<f64> = flow
            .data
            .par_chunks(area)
            .zip(target.data.par_chunks(area))
            .enumerate()
            .map(|(plane, (flow, target))| {
                let mask = &mask.data[plane / 2 * area..][..area];
                let mut lanes = [0.0_f64; 8];
                for i in 0..area {
                    lanes[i % 8] += f64::from(mask[i] * (flow[i] - target[i]).abs());
                }
                lanes.iter().sum()
            })
            .collect();
        (Array { shape: vec![1], data: vec![sums.iter().sum::<f64>() as f32] }, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [flow, target, mask] = [call.inputs[0], call.inputs[1], call.inputs[2]];
        let area = flow.shape[2] * flow.shape[3];
        let mut dflow = Array::zeros(flow.shape);
        dflow.data.par_chunks_mut(area).enumerate().for_each(|(plane, d)| {
            let [flow, target] = [flow.data, target.data].map(|v| &v[plane * area..][..area]);
            let mask = &mask.data[plane / 2 * area..][..area];
            for i in 0..area {
                let delta = flow[i] - target[i];
                let sign = f32::from(i8::from(delta > 0.0) - i8::from(delta < 0.0));
                d[i] = call.grad[0] * mask[i] * sign;
            }
        });
        vec![Some(dflow), None, None]
    }
}
