//! 3x3 convolution, stride 1, padding 1, by Winograd's F(4x4, 3x3): 4 times fewer multiplications than im2col
//! (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", CVPR 2016, section 4.3).
//!
//! With the transforms B (input), G (weights) and A (output), a 4x4 tile of the result is
//! `A^T [ (G g G^T) . (B^T d B) ] A`; the sum over channels turns the 36 products into 36 matrix products, of coefficients
//! (tiles, channels) with the channels innermost. Images go through in groups whose coefficients stay in cache.

#[cfg(test)]
mod tests;
mod tiles;
mod transforms;

pub(crate) use transforms::transform_weights;

use super::conv::plane_sum;
use super::gemm::{Matrix, matmul};
use super::scratch::Scratch;
use super::simd::{LANES, Lanes};
use super::{Array, BackwardCall, Kernel, View, relu_masked, sum_in_order};
use rayon::prelude::*;
use std::sync::Arc;
use tiles::{Tiles, from_coefficients, to_coefficients};
use transforms::{FREQS, Input, InputT, Output, OutputT, WeightsBack};

/// Bytes of coefficients that a group of images may have.
const GROUP_BYTES: usize = 6 << 20;
/// Output channels whose weight gradients are transformed together.
const CHANNELS: usize = 8;

/// `y = w * x + b` with zeros outside, then ReLU if asked. Inputs: x (N, C, H, W), w (O, C, 3, 3), b (O).
#[derive(Debug, Clone)]
pub(crate) struct WinogradConv {
    /// G w G^T as (36, O, C), from [`transform_weights`].
    pub(crate) transformed: Arc<Vec<f32>>,
    /// Clamp the result at zero.
    pub(crate) relu: bool,
}

/// Coefficients of a group of images for some channels: (36, tiles of all images, channels), channels in whole packs.
struct Coefficients {
    values: Scratch,
    tiles: Tiles,
    images: usize,
    channels: usize,
}

impl Coefficients {
    fn new(tiles: Tiles, images: usize, channels: usize) -> Self {
        let mut new = Self { values: Scratch::lend(0), tiles, images, channels };
        new.values = Scratch::lend(FREQS * new.freq());
        new
    }

    /// Packs of a tile's channels.
    fn blocks(&self) -> usize {
        self.channels.div_ceil(LANES)
    }

    /// Packs of one image at one frequency.
    fn image(&self) -> usize {
        self.tiles.count() * self.blocks()
    }

    /// Packs from one frequency to the next: odd, so that the frequencies of a tile do not fall on the same cache sets.
    fn freq(&self) -> usize {
        (self.images * self.image()) | 1
    }

    /// (Tiles, channels) of one frequency.
    fn matrix(&self, f: usize) -> Matrix<'_> {
        let values = self.values[f * self.freq()..][..self.images * self.image()].as_flattened();
        Matrix::strided(values, self.images * self.tiles.count(), self.channels, self.blocks() * LANES)
    }

    /// One image's part of each frequency.
    fn image_of(&self, image: usize) -> Vec<&[Lanes]> {
        self.values.chunks_exact(self.freq()).map(|freq| &freq[image * self.image()..][..self.image()]).collect()
    }

    /// For each image its part of each frequency.
    fn images_mut(&mut self) -> Vec<Vec<&mut [Lanes]>> {
        let (image, images, freq) = (self.image(), self.images, self.freq());
        let mut parts: Vec<Vec<&mut [Lanes]>> = (0..images).map(|_| Vec::with_capacity(FREQS)).collect();
        for values in self.values.chunks_exact_mut(freq) {
            parts.iter_mut().zip(values.chunks_exact_mut(image)).for_each(|(part, values)| part.push(values));
        }
        parts
    }

    /// `self = other u`, or other u^T, per frequency.
    fn multiply(&mut self, f: impl Fn(usize, &mut [f32], usize) + Sync) {
        let (freq, row) = (self.freq(), self.blocks() * LANES);
        self.values.par_chunks_exact_mut(freq).enumerate().for_each(|(i, values)| f(i, values.as_flattened_mut(), row));
    }
}

/// The shape of a call.
#[derive(Clone, Copy)]
struct Shape {
    n: usize,
    c: usize,
    o: usize,
    tiles: Tiles,
}

impl Shape {
    fn new(x: &View<'_>, w: &View<'_>) -> Self {
        let ([n, c, h, wi], o) = (x.nchw(), w.shape[0]);
        assert_eq!(w.shape, [o, c, 3, 3], "shape of the weights");
        Self { n, c, o, tiles: Tiles::new(h, wi) }
    }

    /// Images of a group.
    fn group(&self) -> usize {
        let bytes = size_of::<Lanes>() * FREQS * self.tiles.count() * (self.c.div_ceil(LANES) + self.o.div_ceil(LANES));
        let groups = (self.n * bytes).div_ceil(GROUP_BYTES).min(self.n);
        self.n.div_ceil(groups.max(1)).max(1)
    }
}

impl WinogradConv {
    /// u (O, C) of a frequency.
    fn u(&self, shape: &Shape, f: usize) -> Matrix<'_> {
        let size = shape.o * shape.c;
        Matrix::new(&self.transformed[f * size..][..size], shape.o, shape.c)
    }

    fn forward_group(&self, shape: &Shape, x: &[f32], bias: &[f32], y: &mut [f32]) {
        let Shape { c, o, tiles, .. } = *shape;
        let area = tiles.area();
        let images = y.len() / (o * area);
        let mut v = Coefficients::new(tiles, images, c);
        v.images_mut().into_par_iter().zip(x.par_chunks_exact(c * area)).for_each(|(freqs, planes)| {
            to_coefficients::<InputT, 6>(tiles, 1, planes, freqs);
        });
        let mut m = Coefficients::new(tiles, images, o);
        m.multiply(|f, m, row| matmul(m, row, v.matrix(f), self.u(shape, f).t(), false));
        let floor = if self.relu { 0.0 } else { f32::NEG_INFINITY };
        y.par_chunks_exact_mut(o * area).enumerate().for_each(|(i, planes)| {
            from_coefficients::<OutputT, 4>(tiles, 0, m.image_of(i), bias, floor, planes);
        });
    }

    /// Adds one group's share to du (36, O, C), fills its images of dx and returns the bias's gradient of each image.
    fn backward_group(
        &self,
        shape: &Shape,
        group: &Group<'_>,
        dx: Option<&mut [f32]>,
        du: &mut [f32],
    ) -> Vec<Vec<f32>> {
        let Shape { c, o, tiles, .. } = *shape;
        let area = tiles.area();
        let images = group.x.len() / (c * area);
        let [mut v, mut dm] = [c, o].map(|channels| Coefficients::new(tiles, images, channels));
        let parts = v.images_mut().into_par_iter().zip(dm.images_mut()).enumerate();
        let db = parts.map(|(i, (x_freqs, g_freqs))| {
            let [x, grad, y] =
                [(group.x, c), (group.grad, o), (group.y, o)].map(|(d, c)| &d[i * c * area..][..c * area]);
            let mut masked = Scratch::lend(if self.relu { (o * area).div_ceil(LANES) } else { 0 });
            let grad = if self.relu { relu_masked(grad, y, masked.as_flattened_mut()) } else { grad };
            to_coefficients::<InputT, 6>(tiles, 1, x, x_freqs);
            to_coefficients::<Output, 4>(tiles, 0, grad, g_freqs);
            grad.chunks_exact(area).map(plane_sum).collect()
        });
        let db = db.collect();
        du.par_chunks_exact_mut(o * c).enumerate().for_each(|(f, du)| {
            matmul(du, c, dm.matrix(f).t(), v.matrix(f), true);
        });
        if let Some(dx) = dx {
            v.multiply(|f, v, row| matmul(v, row, dm.matrix(f), self.u(shape, f), false));
            dx.par_chunks_exact_mut(c * area).enumerate().for_each(|(i, planes)| {
                from_coefficients::<Input, 6>(tiles, 1, v.image_of(i), &[], f32::NEG_INFINITY, planes);
            });
        }
        db
    }
}

/// A group of images in the backward pass.
struct Group<'a> {
    x: &'a [f32],
    y: &'a [f32],
    grad: &'a [f32],
}

/// dw (O, C, 3, 3) from du (36, O, C).
fn weights_from(du: &[f32], shape: &[usize]) -> Array {
    let (mut dw, filters) = (Array::zeros(shape), CHANNELS * shape[1]);
    dw.data.par_chunks_mut(filters * 9).enumerate().for_each(|(i, dw)| {
        pulp::Arch::new().dispatch(WeightsBack { u: &du[i * filters..], stride: du.len() / FREQS, dw });
    });
    dw
}

impl WinogradConv {
    fn forward_by(&self, group: impl Fn(&Shape) -> usize, inputs: &[View<'_>]) -> Array {
        let [x, w, bias] = [inputs[0], inputs[1], inputs[2]];
        let shape = Shape::new(&x, &w);
        let Shape { n, c, o, tiles } = shape;
        assert_eq!(self.transformed.len(), FREQS * o * c, "length of the transformed weights");
        let mut y = Array::zeros(&[n, o, tiles.h, tiles.w]);
        let (group, area) = (group(&shape), tiles.area());
        for (y, x) in y.data.chunks_mut(group * o * area).zip(x.data.chunks(group * c * area)) {
            self.forward_group(&shape, x, bias.data, y);
        }
        y
    }

    fn backward_by(&self, group: impl Fn(&Shape) -> usize, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        let [x, w] = [call.inputs[0], call.inputs[1]];
        let shape = Shape::new(&x, &w);
        let Shape { c, o, tiles, .. } = shape;
        let image = group(&shape) * tiles.area();
        let mut dx = call.wanted[0].then(|| Array::zeros(x.shape));
        let mut du = Scratch::lend((FREQS * o * c).div_ceil(LANES));
        let du = &mut du.as_flattened_mut()[..FREQS * o * c];
        du.fill(0.0);
        let mut db = Vec::new();
        let groups = x.data.chunks(c * image).zip(call.output.data.chunks(o * image)).zip(call.grad.chunks(o * image));
        for (i, ((x, y), grad)) in groups.enumerate() {
            let dx = dx.as_mut().map(|dx| &mut dx.data[i * c * image..][..x.len()]);
            db.extend(self.backward_group(&shape, &Group { x, y, grad }, dx, du));
        }
        let dw = call.wanted[1].then(|| weights_from(du, w.shape));
        vec![dx, dw, call.wanted[2].then(|| Array { shape: vec![o], data: sum_in_order(&db) })]
    }
}

impl Kernel for WinogradConv {
    fn forward(&self, inputs: &[View<'_>], _keep: bool) -> (Array, Vec<f32>) {
        (self.forward_by(Shape::group, inputs), Vec::new())
    }

    fn backward(&self, call: &BackwardCall<'_>) -> Vec<Option<Array>> {
        self.backward_by(Shape::group, call)
    }
}
