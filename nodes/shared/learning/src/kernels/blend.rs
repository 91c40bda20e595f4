//! The elementwise parts of a convolutional GRU: with pre-activations a (recurrent part) and c (constant part),
//! z = sigmoid(a_z + c_z), r = sigmoid(a_r + c_r), q = tanh(a_q + c_q), h' = (1 - z) h + z q.
//!
//! Update and reset gate come as one tensor (N, 2 C, H, W), update first.

use super::math::{sigmoid, tanh};
use super::{Array, BackwardCall, Kernel, View, vectorize};
use rayon::prelude::*;

/// `sigmoid(a_r + c_r) h`. Inputs: a and c (N, 2 C, H, W) of which only the second half is read, h (N, C, H, W).
#[derive(Debug, Clone, Copy)]
pub(crate) struct ResetGate;

/// `(1 - z) h + z q`. Inputs: a and c of the gates (N, 2 C, H, W) of which the first half is read; a and c of the
/// candidate, and h (N, C, H, W).
#[derive(Debug, Clone, Copy)]
pub(crate) struct GruBlend;

impl Kernel for ResetGate {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [a, c, h] = [inputs[0], inputs[1], inputs[2]];
        let image = h.data.len() / h.shape[0];
        let mut y = Array::zeros(h.shape);
        let mut kept = vec![0.0; if keep { h.data.len() } else { 0 }];
        let gate = |n: usize, y: &mut [f32]| {
            let (a, c) = (&a.data[(2 * n + 1) * image..][..image], &c.data[(2 * n + 1) * image..][..image]);
            vectorize(
                #[inline(always)]
                || {
                    for i in 0..image {
                        y[i] = sigmoid(a[i] + c[i]);
                    }
                },
            );
        };
        let scale = |n: usize, y: &mut [f32]| {
            y.iter_mut().zip(&h.data[n * image..][..image]).for_each(|(y, h)| *y *= h);
        };
        if keep {
            let parts = y.data.par_chunks_mut(image).zip(kept.par_chunks_mut(image));
            parts.enumerate().for_each(|(n, (y, kept))| {
                gate(n, kept);
                y.copy_from_slice(kept);
                scale(n, y);
            });
        } else {
            y.data.par_chunks_mut(image).enumerate().for_each(|(n, y)| {
                gate(n, y);
                scale(n, y);
            });
        }
        (y, kept)
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let (a, h) = (call.inputs[0], call.inputs[2]);
        let image = h.data.len() / h.shape[0];
        let (mut da, mut dh) = (Array::zeros(a.shape), Array::zeros(h.shape));
        let parts = da.data.par_chunks_mut(2 * image).zip(dh.data.par_chunks_mut(image));
        parts.enumerate().for_each(|(n, (da, dh))| {
            let [g, r, h] = [call.grad, call.kept, h.data].map(|d| &d[n * image..][..image]);
            let da = &mut da[image..];
            for i in 0..image {
                dh[i] = g[i] * r[i];
                da[i] = g[i] * h[i] * r[i] * (1.0 - r[i]);
            }
        });
        let dc = call.wanted[1].then(|| da.clone());
        vec![Some(da), dc, Some(dh)]
    }
}

impl Kernel for GruBlend {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [az, cz, aq, cq, h] = [inputs[0], inputs[1], inputs[2], inputs[3], inputs[4]];
        let image = h.data.len() / h.shape[0];
        let mut y = Array::zeros(h.shape);
        // Per image: z, then q.
        let mut kept = vec![0.0; 2 * h.data.len()];
        let parts = y.data.par_chunks_mut(image).zip(kept.par_chunks_mut(2 * image));
        parts.enumerate().for_each(|(n, (y, kept))| {
            let (z, q) = kept.split_at_mut(image);
            let [az, cz] = [az.data, cz.data].map(|d| &d[2 * n * image..][..image]);
            let [aq, cq, h] = [aq.data, cq.data, h.data].map(|d| &d[n * image..][..image]);
            vectorize(
                #[inline(always)]
                || {
                    for i in 0..image {
                        z[i] = sigmoid(az[i] + cz[i]);
                    }
                    for i in 0..image {
                        q[i] = tanh(aq[i] + cq[i]);
                    }
                    for i in 0..image {
                        y[i] = (1.0 - z[i]) * h[i] + z[i] * q[i];
                    }
                },
            );
        });
        (y, if keep { kept } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let (az, h) = (call.inputs[0], call.inputs[4]);
        let image = h.data.len() / h.shape[0];
        let (mut dz, mut dq, mut dh) = (Array::zeros(az.shape), Array::zeros(h.shape), Array::zeros(h.shape));
        let parts = dz.data.par_chunks_mut(2 * image).zip(dq.data.par_chunks_mut(image));
        parts.zip(dh.data.par_chunks_mut(image)).enumerate().for_each(|(n, ((dz, dq), dh))| {
            let (z, q) = call.kept[2 * n * image..][..2 * image].split_at(image);
            let [g, h] = [call.grad, h.data].map(|d| &d[n * image..][..image]);
            for i in 0..image {
                dz[i] = g[i] * (q[i] - h[i]) * z[i] * (1.0 - z[i]);
                dq[i] = g[i] * z[i] * (1.0 - q[i] * q[i]);
                dh[i] = g[i] * (1.0 - z[i]);
            }
        });
        let (dcz, dcq) = (call.wanted[1].then(|| dz.clone()), call.wanted[3].then(|| dq.clone()));
        vec![Some(dz), dcz, Some(dq), dcq, Some(dh)]
    }
}
