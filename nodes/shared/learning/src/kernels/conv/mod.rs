//! Convolution as im2col and matrix product, one block of output rows at a time so that the columns stay in cache.
//! Few filters need no columns: see `few`.

mod few;

use super::gemm::{Matrix, matmul};
use super::scratch::Scratch;
use super::simd::LANES;
use super::{Array, BackwardCall, Kernel, View, relu_masked, sum_in_order};
use rayon::prelude::*;
use std::ops::Range;

/// Column values that one block may hold (256 KiB).
const BLOCK: usize = 65_536;

/// `y = w * x + b`, then ReLU if asked. Inputs: x (N, C, H, W), w (O, C, kh, kw), b (O). Zeros outside the image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conv {
    /// Step in both directions.
    pub(crate) stride: usize,
    /// Zeros added above and below, left and right.
    pub(crate) pad: [usize; 2],
    /// Clamp the result at zero.
    pub(crate) relu: bool,
}

/// Sizes of one call.
#[derive(Clone, Copy)]
struct Geometry {
    conv: Conv,
    c: usize,
    h: usize,
    w: usize,
    o: usize,
    kh: usize,
    kw: usize,
    ho: usize,
    wo: usize,
}

impl Geometry {
    fn new(conv: Conv, x: &View<'_>, w: &View<'_>) -> Self {
        let ([_, c, h, wi], [o, cw, kh, kw]) = (x.nchw(), w.nchw());
        assert_eq!(c, cw, "channels of the image and of the convolution's weights");
        let ho = (h + 2 * conv.pad[0] - kh) / conv.stride + 1;
        let wo = (wi + 2 * conv.pad[1] - kw) / conv.stride + 1;
        Self { conv, c, h, w: wi, o, kh, kw, ho, wo }
    }

    fn k(&self) -> usize {
        self.c * self.kh * self.kw
    }

    /// True if the columns are the image itself.
    fn is_pointwise(&self) -> bool {
        self.kh * self.kw == 1 && self.conv.stride == 1 && self.conv.pad == [0, 0]
    }

    fn blocks(&self) -> Vec<Range<usize>> {
        let rows = if self.is_pointwise() { self.ho } else { (BLOCK / (self.k() * self.wo)).clamp(1, self.ho) };
        (0..self.ho).step_by(rows).map(|r| r..(r + rows).min(self.ho)).collect()
    }

    /// Calls `f(image_row, first_out_x, first_image_x, count)` for a tap and output row; `None` above or below.
    fn run(&self, oy: usize, ky: usize, kx: usize) -> Option<(usize, usize, usize, usize)> {
        let [ph, pw] = self.conv.pad;
        let s = self.conv.stride;
        let iy = (oy * s + ky).checked_sub(ph).filter(|&iy| iy < self.h)?;
        let first = pw.saturating_sub(kx).div_ceil(s);
        let end = ((self.w + pw).saturating_sub(kx)).div_ceil(s).min(self.wo);
        let ix = first * s + kx - pw.min(first * s + kx);
        Some((iy, first, ix, end.saturating_sub(first)))
    }

    /// A buffer for the columns of a block of `rows` output rows.
    fn columns(&self, rows: usize) -> Scratch {
        Scratch::lend((self.k() * rows * self.wo).div_ceil(LANES))
    }

    /// Fills columns (K, rows * wo) from one image.
    fn im2col(&self, image: &[f32], rows: &Range<usize>, col: &mut [f32]) {
        let n = rows.len() * self.wo;
        for (tap, out) in col.chunks_exact_mut(n).enumerate() {
            let (c, ky, kx) = (tap / (self.kh * self.kw), tap / self.kw % self.kh, tap % self.kw);
            for (oy, line) in rows.clone().zip(out.chunks_exact_mut(self.wo)) {
                let Some((iy, first, ix, count)) = self.run(oy, ky, kx) else {
                    line.fill(0.0);
                    continue;
                };
                line[..first].fill(0.0);
                line[first + count..].fill(0.0);
                let source = &image[(c * self.h + iy) * self.w..][..self.w];
                let line = &mut line[first..first + count];
                match self.conv.stride {
                    1 => line.copy_from_slice(&source[ix..ix + count]),
                    s => line.iter_mut().zip(source[ix.min(self.w)..].iter().step_by(s)).for_each(|(d, v)| *d = *v),
                }
            }
        }
    }

    /// Adds columns back to one image: the transpose of [`Self::im2col`].
    fn col2im(&self, col: &[f32], rows: &Range<usize>, image: &mut [f32]) {
        let n = rows.len() * self.wo;
        for (tap, values) in col.chunks_exact(n).enumerate() {
            let (c, ky, kx) = (tap / (self.kh * self.kw), tap / self.kw % self.kh, tap % self.kw);
            for (oy, line) in rows.clone().zip(values.chunks_exact(self.wo)) {
                let Some((iy, first, ix, count)) = self.run(oy, ky, kx) else { continue };
                let target = &mut image[(c * self.h + iy) * self.w..][..self.w];
                let line = &line[first..first + count];
                match self.conv.stride {
                    1 => target[ix..ix + count].iter_mut().zip(line).for_each(|(t, v)| *t += v),
                    s => target[ix.min(self.w)..].iter_mut().step_by(s).zip(line).for_each(|(t, v)| *t += v),
                }
            }
        }
    }

    fn forward_image(&self, x: &[f32], w: &[f32], b: &[f32], y: &mut [f32]) {
        let (k, area) = (self.k(), self.ho * self.wo);
        let weights = Matrix::new(w, self.o, k);
        if self.is_pointwise() {
            matmul(y, area, weights, Matrix::new(x, k, area), false);
        } else if self.has_few_filters() {
            self.forward_few(x, w, y);
        } else {
            for rows in self.blocks() {
                let (start, n) = (rows.start * self.wo, rows.len() * self.wo);
                let mut col = self.columns(rows.len());
                let col = &mut col.as_flattened_mut()[..k * n];
                self.im2col(x, &rows, col);
                matmul(&mut y[start..], area, weights, Matrix::new(col, k, n), false);
            }
        }
        for (plane, &bias) in y.chunks_exact_mut(area).zip(b) {
            finish(plane, bias, self.conv.relu);
        }
    }

    /// Gradients of one image: by w, by b, and added to `dx` if it is given.
    fn backward_image(&self, x: &[f32], w: &[f32], g: &[f32], dx: Option<&mut [f32]>, dw: &mut [f32]) {
        let (k, area) = (self.k(), self.ho * self.wo);
        let weights = Matrix::new(w, self.o, k);
        if self.is_pointwise() {
            let grad = Matrix::new(g, self.o, area);
            matmul(dw, k, grad, Matrix::new(x, k, area).t(), true);
            if let Some(dx) = dx {
                matmul(dx, area, weights.t(), grad, false);
            }
            return;
        }
        if self.has_few_filters() {
            return self.backward_few(x, w, g, dx, dw);
        }
        let mut dx = dx;
        for rows in self.blocks() {
            let (start, n) = (rows.start * self.wo, rows.len() * self.wo);
            let grad = Matrix::strided(&g[start..], self.o, n, area);
            let mut col = self.columns(rows.len());
            let col = &mut col.as_flattened_mut()[..k * n];
            self.im2col(x, &rows, col);
            matmul(dw, k, grad, Matrix::new(col, k, n).t(), true);
            if let Some(dx) = &mut dx {
                matmul(col, n, weights.t(), grad, false);
                self.col2im(col, &rows, dx);
            }
        }
    }
}

/// Adds the bias and clamps at zero if asked.
#[inline(always)]
pub(crate) fn finish(values: &mut [f32], bias: f32, relu: bool) {
    let floor = if relu { 0.0 } else { f32::NEG_INFINITY };
    for v in values {
        let sum = *v + bias;
        // Keeps NaN, which `f32::max` would hide.
        *v = if sum < floor { floor } else { sum };
    }
}

/// Sum of a plane in 16 fixed lanes.
#[inline(always)]
pub(crate) fn plane_sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 16];
    let chunks = values.chunks_exact(16);
    let rest: f32 = chunks.remainder().iter().sum();
    for chunk in chunks {
        lanes.iter_mut().zip(chunk).for_each(|(l, v)| *l += v);
    }
    lanes.iter().sum::<f32>() + rest
}

impl Kernel for Conv {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let [x, w, b] = [inputs[0], inputs[1], inputs[2]];
        let g = Geometry::new(*self, &x, &w);
        let mut y = Array::zeros(&[x.shape[0], g.o, g.ho, g.wo]);
        y.data
            .par_chunks_mut(g.o * g.ho * g.wo)
            .zip(x.data.par_chunks(g.c * g.h * g.w))
            .for_each(|(y, x)| g.forward_image(x, w.data, b.data, y));
        (y, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [x, w] = [call.inputs[0], call.inputs[1]];
        let g = Geometry::new(*self, &x, &w);
        let (image, out) = (g.c * g.h * g.w, g.o * g.ho * g.wo);
        let mut dx = call.wanted[0].then(|| Array::zeros(x.shape));
        let per_image = |n: usize, dx: Option<&mut [f32]>| {
            let mut masked = Scratch::lend(if self.relu { out.div_ceil(LANES) } else { 0 });
            let mut grad = &call.grad[n * out..][..out];
            if self.relu {
                grad = relu_masked(grad, &call.output.data[n * out..][..out], masked.as_flattened_mut());
            }
            let mut dw = vec![0.0; g.o * g.k()];
            g.backward_image(&x.data[n * image..][..image], w.data, grad, dx, &mut dw);
            let db: Vec<f32> = grad.chunks_exact(g.ho * g.wo).map(plane_sum).collect();
            (dw, db)
        };
        let parts: Vec<(Vec<f32>, Vec<f32>)> = match &mut dx {
            Some(dx) => dx.data.par_chunks_mut(image).enumerate().map(|(n, dx)| per_image(n, Some(dx))).collect(),
            None => (0..x.shape[0]).into_par_iter().map(|n| per_image(n, None)).collect(),
        };
        let (dw, db): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        let dw = Array { shape: w.shape.to_vec(), data: sum_in_order(&dw) };
        let db = Array { shape: vec![g.o], data: sum_in_order(&db) };
        vec![dx, Some(dw), Some(db)]
    }
}
