//! The elementwise part of a gated update without reset gate: with pre-activations a (recurrent part) and c (constant
//! part), z = sigmoid(a_z + c_z), q = tanh(a_q + c_q), h' = (1 - z) h + z q. (Zhou et al., "Minimal gated unit for recurrent
//! neural networks", 2016, has the same update without a gate on the candidate's input.)

use super::math::{sigmoid, tanh};
use super::{Array, BackwardCall, Kernel, View, vectorize};
use rayon::prelude::*;

/// Inputs: a and c (N, 2 C, H, W), gate first, candidate second; h (N, C, H, W).
#[derive(Debug, Clone, Copy)]
pub(crate) struct GatedUpdate;

impl Kernel for GatedUpdate {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [a, c, h] = [inputs[0], inputs[1], inputs[2]];
        let image = h.data.len() / h.shape[0];
        let mut y = Array::zeros(h.shape);
        // Per image: z, then q.
        let mut kept = vec![0.0; 2 * h.data.len()];
        let parts = y.data.par_chunks_mut(image).zip(kept.par_chunks_mut(2 * image));
        parts.enumerate().for_each(|(n, (y, kept))| {
            let [a, c] = [a.data, c.data].map(|d| &d[2 * n * image..][..2 * image]);
            let h = &h.data[n * image..][..image];
            vectorize(
                #[inline(always)]
                || {
                    for i in 0..image {
                        kept[i] = sigmoid(a[i] + c[i]);
                    }
                    for i in image..2 * image {
                        kept[i] = tanh(a[i] + c[i]);
                    }
                    for i in 0..image {
                        y[i] = h[i] + kept[i] * (kept[image + i] - h[i]);
                    }
                },
            );
        });
        (y, if keep { kept } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let (a, h) = (call.inputs[0], call.inputs[2]);
        let image = h.data.len() / h.shape[0];
        let (mut da, mut dh) = (Array::zeros(a.shape), Array::zeros(h.shape));
        let parts = da.data.par_chunks_mut(2 * image).zip(dh.data.par_chunks_mut(image));
        parts.enumerate().for_each(|(n, (da, dh))| {
            let (z, q) = call.kept[2 * n * image..][..2 * image].split_at(image);
            let [g, h] = [call.grad, h.data].map(|d| &d[n * image..][..image]);
            let (dz, dq) = da.split_at_mut(image);
            for i in 0..image {
                dz[i] = g[i] * (q[i] - h[i]) * z[i] * (1.0 - z[i]);
                dq[i] = g[i] * z[i] * (1.0 - q[i] * q[i]);
                dh[i] = g[i] * (1.0 - z[i]);
            }
        });
        let dc = call.wanted[1].then(|| da.clone());
        vec![Some(da), dc, Some(dh)]
    }
}
