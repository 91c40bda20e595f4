//! RAFT-small's upsampling of the flow: eight times bilinear with `align_corners`, values times 8.

use super::gemm::{Matrix, matmul};
use super::{Array, BackwardCall, Kernel, View};
use pseudoflow_network::{UPSAMPLING, align_corners_matrix};
use rayon::prelude::*;

/// `y = 8 A x A^T` per plane: fine pixel i reads coarse position i (h - 1) / (8 h - 1), as the authors' network does
/// (its trained weights expect it; docs/method.md, "Which wrong answers look right").
#[derive(Debug, Clone, Copy)]
pub(crate) struct Upsample;

impl Kernel for Upsample {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let [n, c, h, w] = inputs[0].nchw();
        let (ah, aw) = (align_corners_matrix(h), align_corners_matrix(w));
        let (fh, fw) = (UPSAMPLING * h, UPSAMPLING * w);
        let mut y = Array::zeros(&[n, c, fh, fw]);
        y.data.par_chunks_mut(fh * fw).zip(inputs[0].data.par_chunks(h * w)).for_each(|(y, x)| {
            let scaled: Vec<f32> = x.iter().map(|v| v * UPSAMPLING as f32).collect();
            let mut wide = vec![0.0; h * fw];
            matmul(&mut wide, fw, Matrix::new(&scaled, h, w), Matrix::new(&aw, fw, w).t(), false);
            matmul(y, fw, Matrix::new(&ah, fh, h), Matrix::new(&wide, h, fw), false);
        });
        (y, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [_, _, h, w] = call.inputs[0].nchw();
        let (ah, aw) = (align_corners_matrix(h), align_corners_matrix(w));
        let (fh, fw) = (UPSAMPLING * h, UPSAMPLING * w);
        let mut dx = Array::zeros(call.inputs[0].shape);
        dx.data.par_chunks_mut(h * w).zip(call.grad.par_chunks(fh * fw)).for_each(|(dx, g)| {
            let mut wide = vec![0.0; h * fw];
            matmul(&mut wide, fw, Matrix::new(&ah, fh, h).t(), Matrix::new(g, fh, fw), false);
            matmul(dx, w, Matrix::new(&wide, h, fw), Matrix::new(&aw, fw, w), false);
            dx.iter_mut().for_each(|v| *v *= UPSAMPLING as f32);
        });
        vec![Some(dx)]
    }
}
