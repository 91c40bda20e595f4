//! 3x3 convolution, stride 1, padding 1, by Winograd's F(2x2, 3x3): 2.25 times fewer multiplications than im2col
//! (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", CVPR 2016).
//!
//! With the transforms B (input), G (weights) and A (output), a 2x2 tile of the result is
//! `A^T [ (G g G^T) . (B^T d B) ] A`; the sum over channels turns the 16 products into 16 matrix products.
//! The transformed weights are an operation of their own, so that RAFT's iterations share them and their gradient.

use super::conv::{finish, plane_sum};
use super::gemm::{Matrix, matmul};
use super::{Array, BackwardCall, Kernel, View};
use rayon::prelude::*;

/// Coefficients of a transformed tile.
const FREQS: usize = 16;

/// w (O, C, 3, 3) to G w G^T as (16, O, C).
#[derive(Debug, Clone, Copy)]
pub(crate) struct WinogradWeight;

/// `y = w * x + b` with zeros outside, then ReLU if asked. Inputs: x (N, C, H, W), the transformed weights
/// (16, O, C), b (O).
#[derive(Debug, Clone, Copy)]
pub(crate) struct WinogradConv {
    /// Clamp the result at zero.
    pub(crate) relu: bool,
}

/// One row of G applied to three values; `g` is ordered as the rows of G.
fn g_times([a, b, c]: [f32; 3]) -> [f32; 4] {
    [a, 0.5 * (a + b + c), 0.5 * (a - b + c), c]
}

/// G^T applied to four values.
fn gt_times([a, b, c, d]: [f32; 4]) -> [f32; 3] {
    [a + 0.5 * (b + c), 0.5 * (b - c), 0.5 * (b + c) + d]
}

impl Kernel for WinogradWeight {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        let w = inputs[0];
        let [o, c, ..] = w.nchw();
        let filters = o * c;
        let mut u = Array::zeros(&[FREQS, o, c]);
        for (i, g) in w.data.chunks_exact(9).enumerate() {
            let rows: [[f32; 4]; 3] = std::array::from_fn(|r| g_times([g[3 * r], g[3 * r + 1], g[3 * r + 2]]));
            for x in 0..4 {
                let column = g_times([rows[0][x], rows[1][x], rows[2][x]]);
                for y in 0..4 {
                    u.data[(4 * y + x) * filters + i] = column[y];
                }
            }
        }
        (u, Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let w = call.inputs[0];
        let filters = w.shape[0] * w.shape[1];
        let mut dw = Array::zeros(w.shape);
        dw.data.par_chunks_mut(9).enumerate().with_min_len(1024).for_each(|(i, dg)| {
            let at = |y: usize, x: usize| call.grad[(4 * y + x) * filters + i];
            let columns: [[f32; 3]; 4] = std::array::from_fn(|x| gt_times([at(0, x), at(1, x), at(2, x), at(3, x)]));
            for y in 0..3 {
                let row = gt_times([columns[0][y], columns[1][y], columns[2][y], columns[3][y]]);
                dg[3 * y..3 * y + 3].copy_from_slice(&row);
            }
        });
        vec![Some(dw)]
    }
}

/// Tiling of a batch of planes.
#[derive(Clone, Copy)]
struct Tiles {
    n: usize,
    h: usize,
    w: usize,
    /// Tiles down and across.
    down: usize,
    across: usize,
}

impl Tiles {
    fn new(n: usize, h: usize, w: usize) -> Self {
        Self { n, h, w, down: h.div_ceil(2), across: w.div_ceil(2) }
    }

    fn count(&self) -> usize {
        self.n * self.down * self.across
    }

    /// Distance of coefficient rows: padded so that rows do not fall on the same cache sets.
    fn stride(&self) -> usize {
        self.count().next_multiple_of(16) + 16
    }

    /// Values of one channel.
    fn channel(&self) -> usize {
        FREQS * self.stride()
    }

    /// B^T d B of one image plane, written at tile `first` of a channel's coefficient rows.
    fn transform_input(&self, plane: &[f32], first: usize, v: &mut [f32], scratch: &mut Scratch) {
        let (across, stride) = (self.across, self.stride());
        let rows = 2 * self.down + 2;
        scratch.rows.resize(4 * rows * across, 0.0);
        for r in 0..rows {
            let out = &mut scratch.rows[4 * r * across..][..4 * across];
            // Row r of the padded plane is image row r - 1.
            if r == 0 || r > self.h {
                out.fill(0.0);
                continue;
            }
            let row = &plane[(r - 1) * self.w..][..self.w];
            scratch.line.clear();
            scratch.line.resize(2 * across + 2, 0.0);
            scratch.line[1..=self.w].copy_from_slice(row);
            let (t0, rest) = out.split_at_mut(across);
            let (t1, rest) = rest.split_at_mut(across);
            let (t2, t3) = rest.split_at_mut(across);
            for x in 0..across {
                let d: &[f32] = &scratch.line[2 * x..2 * x + 4];
                t0[x] = d[0] - d[2];
                t1[x] = d[1] + d[2];
                t2[x] = d[2] - d[1];
                t3[x] = d[1] - d[3];
            }
        }
        for ty in 0..self.down {
            for fx in 0..4 {
                let row = |i: usize| &scratch.rows[(4 * (2 * ty + i) + fx) * across..][..across];
                let [d0, d1, d2, d3] = [row(0), row(1), row(2), row(3)];
                let at = first + ty * across;
                let mut put = |fy: usize, f: &dyn Fn(usize) -> f32| {
                    let out = &mut v[(4 * fy + fx) * stride + at..][..across];
                    for (x, out) in out.iter_mut().enumerate() {
                        *out = f(x);
                    }
                };
                put(0, &|x| d0[x] - d2[x]);
                put(1, &|x| d1[x] + d2[x]);
                put(2, &|x| d2[x] - d1[x]);
                put(3, &|x| d1[x] - d3[x]);
            }
        }
    }

    /// Transpose of [`Self::transform_input`]: the plane's gradient from the coefficients' gradient.
    fn transform_input_back(&self, v: &[f32], freq_stride: usize, first: usize, plane: &mut [f32]) {
        let across = self.across;
        // Overlapping tiles are summed in a padded plane.
        let width = 2 * across + 2;
        let mut padded = vec![0.0_f32; (2 * self.down + 2) * width];
        for ty in 0..self.down {
            for tx in 0..across {
                let at = |fy: usize, fx: usize| v[(4 * fy + fx) * freq_stride + first + ty * across + tx];
                let columns: [[f32; 4]; 4] =
                    std::array::from_fn(|fx| b_times([at(0, fx), at(1, fx), at(2, fx), at(3, fx)]));
                for y in 0..4 {
                    let row = b_times([columns[0][y], columns[1][y], columns[2][y], columns[3][y]]);
                    let out = &mut padded[(2 * ty + y) * width + 2 * tx..][..4];
                    out.iter_mut().zip(row).for_each(|(o, r)| *o += r);
                }
            }
        }
        for (y, row) in plane.chunks_exact_mut(self.w).enumerate() {
            row.copy_from_slice(&padded[(y + 1) * width + 1..][..self.w]);
        }
    }

    /// A^T m A of one output plane.
    fn transform_output(&self, m: &[f32], freq_stride: usize, first: usize, plane: &mut [f32]) {
        for ty in 0..self.down {
            for tx in 0..self.across {
                let at = |fy: usize, fx: usize| m[(4 * fy + fx) * freq_stride + first + ty * self.across + tx];
                let columns: [[f32; 2]; 4] =
                    std::array::from_fn(|fx| at_times([at(0, fx), at(1, fx), at(2, fx), at(3, fx)]));
                for y in 0..2 {
                    let row = at_times([columns[0][y], columns[1][y], columns[2][y], columns[3][y]]);
                    for (x, value) in row.into_iter().enumerate() {
                        if 2 * ty + y < self.h && 2 * tx + x < self.w {
                            plane[(2 * ty + y) * self.w + 2 * tx + x] = value;
                        }
                    }
                }
            }
        }
    }

    /// Transpose of [`Self::transform_output`], written at tile `first` of a channel's coefficient rows.
    fn transform_output_back(&self, plane: &[f32], first: usize, m: &mut [f32]) {
        let stride = self.stride();
        for ty in 0..self.down {
            for tx in 0..self.across {
                let at = |y: usize, x: usize| {
                    let (y, x) = (2 * ty + y, 2 * tx + x);
                    if y < self.h && x < self.w { plane[y * self.w + x] } else { 0.0 }
                };
                let columns: [[f32; 4]; 2] = std::array::from_fn(|x| a_times([at(0, x), at(1, x)]));
                for fy in 0..4 {
                    let row = a_times([columns[0][fy], columns[1][fy]]);
                    for (fx, value) in row.into_iter().enumerate() {
                        m[(4 * fy + fx) * stride + first + ty * self.across + tx] = value;
                    }
                }
            }
        }
    }
}

/// Buffers of a task.
#[derive(Default)]
struct Scratch {
    rows: Vec<f32>,
    line: Vec<f32>,
}

/// B applied to four values.
#[inline(always)]
fn b_times([a, b, c, d]: [f32; 4]) -> [f32; 4] {
    [a, b - c + d, b + c - a, -d]
}

/// A^T applied to four values.
#[inline(always)]
fn at_times([a, b, c, d]: [f32; 4]) -> [f32; 2] {
    [a + b + c, b - c - d]
}

/// A applied to two values.
#[inline(always)]
fn a_times([a, b]: [f32; 2]) -> [f32; 4] {
    [a, a + b, a - b, -b]
}

/// Coefficients of all channels: (C, 16, stride).
fn transform_channels(x: &View<'_>, tiles: Tiles, f: impl Fn(usize, &[f32], usize, &mut [f32]) + Sync) -> Vec<f32> {
    let [n, c, h, w] = x.nchw();
    let mut v = vec![0.0; c * tiles.channel()];
    v.par_chunks_mut(tiles.channel()).enumerate().for_each(|(channel, v)| {
        for image in 0..n {
            let plane = &x.data[(image * c + channel) * h * w..][..h * w];
            f(image * c + channel, plane, image * tiles.down * tiles.across, v);
        }
    });
    v
}

impl WinogradConv {
    fn input_coefficients(x: &View<'_>, tiles: Tiles) -> Vec<f32> {
        thread_local! {
            static SCRATCH: std::cell::RefCell<Scratch> = std::cell::RefCell::default();
        }
        transform_channels(x, tiles, |_, plane, first, v| {
            SCRATCH.with_borrow_mut(|scratch| tiles.transform_input(plane, first, v, scratch));
        })
    }

    /// Multiplies per frequency: (16, rows of `left`, tiles) from `left` (16, R, K) and coefficients (K, 16, stride).
    fn multiply(left: &[f32], rows: usize, k: usize, transposed: bool, v: &[f32], tiles: Tiles) -> Vec<f32> {
        let (count, stride) = (tiles.count(), tiles.stride());
        let mut m = vec![0.0; FREQS * rows * stride];
        m.par_chunks_mut(rows * stride).enumerate().for_each(|(f, m)| {
            let block = &left[f * rows * k..][..rows * k];
            let left = if transposed { Matrix::new(block, k, rows).t() } else { Matrix::new(block, rows, k) };
            matmul(m, stride, left, Matrix::strided(&v[f * stride..], k, count, FREQS * stride), false);
        });
        m
    }
}

impl Kernel for WinogradConv {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [x, u, b] = [inputs[0], inputs[1], inputs[2]];
        let [n, c, h, w] = x.nchw();
        let o = u.shape[1];
        assert_eq!(u.shape, [FREQS, o, c], "shape of the transformed weights");
        let tiles = Tiles::new(n, h, w);
        let v = Self::input_coefficients(&x, tiles);
        let m = Self::multiply(u.data, o, c, false, &v, tiles);
        let mut y = Array::zeros(&[n, o, h, w]);
        y.data.par_chunks_mut(h * w).enumerate().with_min_len(8).for_each(|(i, plane)| {
            let (image, channel) = (i / o, i % o);
            let first = image * tiles.down * tiles.across;
            tiles.transform_output(&m[channel * tiles.stride()..], o * tiles.stride(), first, plane);
            finish(plane, b.data[channel], self.relu);
        });
        (y, if keep { v } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [x, u] = [call.inputs[0], call.inputs[1]];
        let [n, c, h, w] = x.nchw();
        let o = u.shape[1];
        let tiles = Tiles::new(n, h, w);
        let masked = if self.relu { super::relu_mask(call.grad, call.output.data) } else { Vec::new() };
        let data = if self.relu { &masked } else { call.grad };
        let grad = View { shape: call.output.shape, data };
        let dm = transform_channels(&grad, tiles, |_, plane, first, m| tiles.transform_output_back(plane, first, m));
        let dx = call.wanted[0].then(|| {
            let dv = Self::multiply(u.data, c, o, true, &dm, tiles);
            let mut dx = Array::zeros(x.shape);
            dx.data.par_chunks_mut(h * w).enumerate().with_min_len(8).for_each(|(i, plane)| {
                let (image, channel) = (i / c, i % c);
                let first = image * tiles.down * tiles.across;
                tiles.transform_input_back(&dv[channel * tiles.stride()..], c * tiles.stride(), first, plane);
            });
            dx
        });
        let mut du = Array::zeros(u.shape);
        du.data.par_chunks_mut(o * c).enumerate().for_each(|(f, du)| {
            let at = f * tiles.stride();
            let grad = Matrix::strided(&dm[at..], o, tiles.count(), tiles.channel());
            let input = Matrix::strided(&call.kept[at..], c, tiles.count(), tiles.channel());
            matmul(du, c, grad, input.t(), false);
        });
        let mut db = vec![0.0; o];
        for image in grad.data.chunks_exact(o * h * w) {
            db.iter_mut().zip(image.chunks_exact(h * w)).for_each(|(db, plane)| *db += plane_sum(plane));
        }
        vec![dx, Some(du), Some(Array { shape: vec![o], data: db })]
    }
}
