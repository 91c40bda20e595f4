//! 3x3 convolution, stride 1, padding 1, by Winograd's F(4x4, 3x3): 4 times fewer multiplications than im2col
//! (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", CVPR 2016, section 4.3).
//!
//! With the transforms B (input), G (weights) and A (output), a 4x4 tile of the result is
//! `A^T [ (G g G^T) . (B^T d B) ] A`; the sum over channels turns the 36 products into 36 matrix products. The
//! transforms work on sixteen tiles at once.

use super::conv::{finish, plane_sum};
use super::gemm::{Matrix, matmul};
use super::simd::{LANES, Pack, vectorize};
use super::{Array, BackwardCall, Kernel, View, relu_mask};
use rayon::prelude::*;
use std::sync::Arc;

/// Side of an output tile, and of an input tile.
const OUT: usize = 4;
const IN: usize = 6;
/// Coefficients of a transformed tile.
const FREQS: usize = IN * IN;
/// Planes a task takes at least.
const PLANES: usize = 8;
/// Output channels whose weight gradients are transformed together, while they are in cache.
const CHANNELS: usize = 32;

/// `y = w * x + b` with zeros outside, then ReLU if asked. Inputs: x (N, C, H, W), w (O, C, 3, 3), b (O).
#[derive(Debug, Clone)]
pub(crate) struct WinogradConv {
    /// G w G^T as (36, O, C), from [`transform_weights`].
    pub(crate) transformed: Arc<Vec<f32>>,
    /// Clamp the result at zero.
    pub(crate) relu: bool,
}

#[inline(always)]
fn bt([a, b, c, d, e, f]: [Pack; 6]) -> [Pack; 6] {
    [
        a * 4.0 - c * 5.0 + e,
        d + e - (b + c) * 4.0,
        (b - c) * 4.0 + e - d,
        (d - b) * 2.0 + e - c,
        (b - d) * 2.0 + e - c,
        b * 4.0 - d * 5.0 + f,
    ]
}

#[inline(always)]
fn b([a, b, c, d, e, f]: [Pack; 6]) -> [Pack; 6] {
    [
        a * 4.0,
        (c - b) * 4.0 + (e - d) * 2.0 + f * 4.0,
        Pack::ZERO - a * 5.0 - (b + c) * 4.0 - d - e,
        b - c + (d - e) * 2.0 - f * 5.0,
        a + b + c + d + e,
        f,
    ]
}

#[inline(always)]
fn at([a, b, c, d, e, f]: [Pack; 6]) -> [Pack; 4] {
    [a + (b + c) + (d + e), (b - c) + (d - e) * 2.0, (b + c) + (d + e) * 4.0, (b - c) + (d - e) * 8.0 + f]
}

#[inline(always)]
fn a([a, b, c, d]: [Pack; 4]) -> [Pack; 6] {
    [a, a + b + c + d, a - b + c - d, a + b * 2.0 + c * 4.0 + d * 8.0, a - b * 2.0 + c * 4.0 - d * 8.0, d]
}

#[inline(always)]
fn g([a, b, c]: [Pack; 3]) -> [Pack; 6] {
    let (even, odd) = ((a + c) * (-1.0 / 6.0), b * (-1.0 / 6.0));
    let (low, high) = (a * (1.0 / 24.0) + c * (1.0 / 6.0), b * (1.0 / 12.0));
    [a * 0.25, even + odd, even - odd, low + high, low - high, c]
}

#[inline(always)]
fn gt([a, b, c, d, e, f]: [Pack; 6]) -> [Pack; 3] {
    let (even, odd) = ((b + c) * (-1.0 / 6.0), (b - c) * (-1.0 / 6.0));
    [a * 0.25 + even + (d + e) * (1.0 / 24.0), odd + (d - e) * (1.0 / 12.0), even + (d + e) * (1.0 / 6.0) + f]
}

/// Applies a transform to the columns, then to the rows.
#[inline(always)]
fn both<const P: usize, const Q: usize>(tile: [[Pack; P]; P], f: impl Fn([Pack; P]) -> [Pack; Q]) -> [[Pack; Q]; Q] {
    let columns: [[Pack; Q]; P] = std::array::from_fn(|x| f(std::array::from_fn(|y| tile[y][x])));
    std::array::from_fn(|y| f(std::array::from_fn(|x| columns[x][y])))
}

/// w (O, C, 3, 3) to G w G^T as (36, O, C).
pub(crate) fn transform_weights(w: &[f32]) -> Vec<f32> {
    let filters = w.len() / 9;
    let mut u = vec![0.0; FREQS * filters];
    for first in (0..filters).step_by(LANES) {
        let count = LANES.min(filters - first);
        let tile = std::array::from_fn(|y| {
            std::array::from_fn(|x| {
                let mut lanes = [0.0; LANES];
                (0..count).for_each(|i| lanes[i] = w[(first + i) * 9 + 3 * y + x]);
                Pack(lanes)
            })
        });
        for (f, value) in both(tile, g).into_iter().flatten().enumerate() {
            value.store(&mut u[f * filters + first..][..count]);
        }
    }
    u
}

/// G^T u G of filters whose coefficients lie `stride` apart, to (filters, 3, 3).
#[inline(always)]
fn transform_weights_back(u: &[f32], stride: usize, dw: &mut [f32]) {
    let filters = dw.len() / 9;
    for first in (0..filters).step_by(LANES) {
        let count = LANES.min(filters - first);
        let tile =
            std::array::from_fn(|y| std::array::from_fn(|x| Pack::load(&u[(IN * y + x) * stride + first..][..count])));
        for (k, value) in both(tile, gt).into_iter().flatten().enumerate() {
            (0..count).for_each(|i| dw[(first + i) * 9 + k] = value.0[i]);
        }
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
        Self { n, h, w, down: h.div_ceil(OUT), across: w.div_ceil(OUT) }
    }

    /// Tiles of one plane.
    fn plane(&self) -> usize {
        self.down * self.across
    }

    fn count(&self) -> usize {
        self.n * self.plane()
    }

    /// Distance of coefficient rows: padded so that rows do not fall on the same cache sets.
    fn stride(&self) -> usize {
        self.count().next_multiple_of(LANES) + LANES
    }

    /// Values of one channel.
    fn channel(&self) -> usize {
        FREQS * self.stride()
    }

    /// Row length of a plane with a border of one and whole tiles.
    fn padded_width(&self) -> usize {
        OUT * self.across + 2
    }

    fn padded_len(&self) -> usize {
        (OUT * self.down + 2) * self.padded_width()
    }

    /// Where the corner of a plane's tile lies in the padded plane.
    #[inline(always)]
    fn corner(&self, tile: usize) -> usize {
        tile / self.across * OUT * self.padded_width() + tile % self.across * OUT
    }

    /// Copies a plane into the padded one at the given border; the rest stays zero.
    #[inline(always)]
    fn pad(&self, plane: &[f32], border: usize, padded: &mut [f32]) {
        for (y, row) in plane.chunks_exact(self.w).enumerate() {
            padded[(y + border) * self.padded_width() + border..][..self.w].copy_from_slice(row);
        }
    }

    /// The plane inside the padded one.
    #[inline(always)]
    fn crop(&self, padded: &[f32], border: usize, plane: &mut [f32]) {
        for (y, row) in plane.chunks_exact_mut(self.w).enumerate() {
            row.copy_from_slice(&padded[(y + border) * self.padded_width() + border..][..self.w]);
        }
    }

    /// Transforms tiles of side P of a padded plane to coefficient rows from tile `first` on.
    #[inline(always)]
    fn forward<const P: usize>(
        &self,
        padded: &[f32],
        first: usize,
        f: impl Fn([Pack; P]) -> [Pack; IN] + Copy,
        v: &mut [f32],
    ) {
        let (width, stride) = (self.padded_width(), self.stride());
        for start in (0..self.plane()).step_by(LANES) {
            let count = LANES.min(self.plane() - start);
            let mut tile = [[Pack::ZERO; P]; P];
            for i in 0..count {
                let corner = self.corner(start + i);
                for y in 0..P {
                    let row = &padded[corner + y * width..][..P];
                    for x in 0..P {
                        tile[y][x].0[i] = row[x];
                    }
                }
            }
            for (f, value) in both(tile, f).into_iter().flatten().enumerate() {
                value.store(&mut v[f * stride + first + start..][..count]);
            }
        }
    }

    /// Transforms coefficient rows (`stride` apart) from tile `first` on, and adds the tiles of side Q to a padded plane.
    #[inline(always)]
    fn backward<const Q: usize>(
        &self,
        v: &[f32],
        stride: usize,
        first: usize,
        f: impl Fn([Pack; IN]) -> [Pack; Q] + Copy,
        padded: &mut [f32],
    ) {
        let width = self.padded_width();
        for start in (0..self.plane()).step_by(LANES) {
            let count = LANES.min(self.plane() - start);
            let tile = std::array::from_fn(|y| {
                std::array::from_fn(|x| Pack::load(&v[(IN * y + x) * stride + first + start..][..count]))
            });
            let tile = both(tile, f);
            for i in 0..count {
                let corner = self.corner(start + i);
                for y in 0..Q {
                    let row = &mut padded[corner + y * width..][..Q];
                    for x in 0..Q {
                        row[x] += tile[y][x].0[i];
                    }
                }
            }
        }
    }

    /// Coefficients of all channels of a batch (N, C, H, W): (C, 36, stride).
    fn coefficients<const P: usize>(
        self,
        data: &[f32],
        channels: usize,
        border: usize,
        f: impl Fn([Pack; P]) -> [Pack; IN] + Copy + Sync,
    ) -> Vec<f32> {
        let area = self.h * self.w;
        let mut v = vec![0.0; channels * self.channel()];
        v.par_chunks_mut(self.channel()).enumerate().with_min_len(PLANES).for_each(|(channel, v)| {
            let mut padded = vec![0.0; self.padded_len()];
            vectorize(
                #[inline(always)]
                || {
                    for image in 0..self.n {
                        self.pad(&data[(image * channels + channel) * area..][..area], border, &mut padded);
                        self.forward(&padded, image * self.plane(), f, v);
                    }
                },
            );
        });
        v
    }

    /// The batch (N, C, H, W) from coefficients (36, C, stride), then `each(channel, plane)`.
    fn planes<const Q: usize>(
        self,
        v: &[f32],
        channels: usize,
        border: usize,
        f: impl Fn([Pack; IN]) -> [Pack; Q] + Copy + Sync,
        each: impl Fn(usize, &mut [f32]) + Sync,
    ) -> Vec<f32> {
        let area = self.h * self.w;
        let mut data = vec![0.0; self.n * channels * area];
        data.par_chunks_mut(area).enumerate().with_min_len(PLANES).for_each(|(i, plane)| {
            let (image, channel) = (i / channels, i % channels);
            let mut padded = vec![0.0; self.padded_len()];
            vectorize(
                #[inline(always)]
                || {
                    let rows = &v[channel * self.stride()..];
                    self.backward(rows, channels * self.stride(), image * self.plane(), f, &mut padded);
                    self.crop(&padded, border, plane);
                },
            );
            each(channel, plane);
        });
        data
    }
}

impl WinogradConv {
    /// Per frequency u (O, C), or its transpose, times coefficients (K, 36, stride), to (36, rows, stride).
    fn multiply(&self, shape: [usize; 2], transposed: bool, v: &[f32], tiles: Tiles) -> Vec<f32> {
        let [o, c] = shape;
        let (rows, k) = if transposed { (c, o) } else { (o, c) };
        let (count, stride) = (tiles.count(), tiles.stride());
        let mut m = vec![0.0; FREQS * rows * stride];
        m.par_chunks_mut(rows * stride).enumerate().for_each(|(f, m)| {
            let u = Matrix::new(&self.transformed[f * o * c..][..o * c], o, c);
            let left = if transposed { u.t() } else { u };
            matmul(m, stride, left, Matrix::strided(&v[f * stride..], k, count, tiles.channel()), false);
        });
        m
    }

    /// Gradient by the weights from the coefficients of the output's gradient (O, 36, stride) and of the input.
    fn weight_gradient(dm: &[f32], v: &[f32], shape: &[usize], tiles: Tiles) -> Array {
        let c = shape[1];
        let mut dw = Array::zeros(shape);
        dw.data.par_chunks_mut(CHANNELS * c * 9).enumerate().for_each(|(block, dw)| {
            let rows = dw.len() / (c * 9);
            let mut du = vec![0.0; FREQS * rows * c];
            for (f, du) in du.chunks_exact_mut(rows * c).enumerate() {
                let first = block * CHANNELS * tiles.channel() + f * tiles.stride();
                let grad = Matrix::strided(&dm[first..], rows, tiles.count(), tiles.channel());
                let input = Matrix::strided(&v[f * tiles.stride()..], c, tiles.count(), tiles.channel());
                matmul(du, c, grad, input.t(), false);
            }
            vectorize(
                #[inline(always)]
                || transform_weights_back(&du, rows * c, dw),
            );
        });
        dw
    }
}

impl Kernel for WinogradConv {
    fn forward(&self, inputs: &[View<'_>], keep: bool) -> (Array, Vec<f32>) {
        let [x, w, bias] = [inputs[0], inputs[1], inputs[2]];
        let [n, c, h, wi] = x.nchw();
        let o = w.shape[0];
        assert_eq!(w.shape, [o, c, 3, 3], "shape of the weights");
        assert_eq!(self.transformed.len(), FREQS * o * c, "length of the transformed weights");
        let tiles = Tiles::new(n, h, wi);
        let v = tiles.coefficients(x.data, c, 1, bt);
        let m = self.multiply([o, c], false, &v, tiles);
        let data = tiles.planes(&m, o, 0, at, |channel, plane| finish(plane, bias.data[channel], self.relu));
        (Array { shape: vec![n, o, h, wi], data }, if keep { v } else { Vec::new() })
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [x, w] = [call.inputs[0], call.inputs[1]];
        let [n, c, h, wi] = x.nchw();
        let o = w.shape[0];
        let tiles = Tiles::new(n, h, wi);
        let masked = if self.relu { relu_mask(call.grad, call.output.data) } else { Vec::new() };
        let grad = if self.relu { &masked } else { call.grad };
        let dm = tiles.coefficients(grad, o, 0, a);
        let dx = call.wanted[0].then(|| {
            let dv = self.multiply([o, c], true, &dm, tiles);
            Array { shape: x.shape.to_vec(), data: tiles.planes(&dv, c, 1, b, |_, _| ()) }
        });
        let dw = call.wanted[1].then(|| Self::weight_gradient(&dm, call.kept, w.shape, tiles));
        let db = call.wanted[2].then(|| {
            let mut db = vec![0.0; o];
            for image in grad.chunks_exact(o * h * wi) {
                db.iter_mut().zip(image.chunks_exact(h * wi)).for_each(|(db, plane)| *db += plane_sum(plane));
            }
            Array { shape: vec![o], data: db }
        });
        vec![dx, dw, db]
    }
}
