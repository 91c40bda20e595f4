//! Convolution with few filters: cheaper with the taps on the side of the output. The products of all taps, (O kh kw, C) times
//! the image (C, H W), need no columns; the planes that come out are shifted and summed.

use super::super::gemm::{Matrix, matmul};
use super::super::scratch::Scratch;
use super::super::simd::LANES;
use super::Geometry;

impl Geometry {
    /// True if the taps of all filters are fewer than the channels, and the output is as large as the image.
    pub(super) fn has_few_filters(&self) -> bool {
        self.conv.stride == 1 && [self.ho, self.wo] == [self.h, self.w] && self.o * self.kh * self.kw <= self.c
    }

    /// Filters times taps.
    fn taps(&self) -> usize {
        self.o * self.kh * self.kw
    }

    /// w (O, C, kh kw) to (O, kh kw, C).
    fn by_taps(&self, w: &[f32]) -> Vec<f32> {
        let taps = self.kh * self.kw;
        let mut sorted = vec![0.0; w.len()];
        for (w, sorted) in w.chunks_exact(self.k()).zip(sorted.chunks_exact_mut(self.k())) {
            for (i, value) in w.iter().enumerate() {
                sorted[i % taps * self.c + i / taps] = *value;
            }
        }
        sorted
    }

    /// Calls `f(index in the output, index in the products, count)` for the runs of all filters and taps.
    fn each_run(&self, mut f: impl FnMut(usize, usize, usize)) {
        let area = self.h * self.w;
        for plane in 0..self.taps() {
            let (o, ky, kx) = (plane / (self.kh * self.kw), plane / self.kw % self.kh, plane % self.kw);
            for oy in 0..self.ho {
                if let Some((iy, first, ix, count)) = self.run(oy, ky, kx).filter(|run| run.3 > 0) {
                    f(o * area + oy * self.w + first, plane * area + iy * self.w + ix, count);
                }
            }
        }
    }

    pub(super) fn forward_few(&self, x: &[f32], w: &[f32], y: &mut [f32]) {
        let (taps, area) = (self.taps(), self.h * self.w);
        let mut products = Scratch::lend((taps * area).div_ceil(LANES));
        let products = products.as_flattened_mut();
        let weights = self.by_taps(w);
        matmul(products, area, Matrix::new(&weights, taps, self.c), Matrix::new(x, self.c, area), false);
        y.fill(0.0);
        self.each_run(|to, from, count| {
            y[to..to + count].iter_mut().zip(&products[from..from + count]).for_each(|(y, p)| *y += p);
        });
    }

    /// Fills `dx` if it is given, and adds to `dw`.
    pub(super) fn backward_few(&self, x: &[f32], w: &[f32], g: &[f32], dx: Option<&mut [f32]>, dw: &mut [f32]) {
        let (taps, area) = (self.taps(), self.h * self.w);
        let mut products = Scratch::lend((taps * area).div_ceil(LANES));
        let products = &mut products.as_flattened_mut()[..taps * area];
        products.fill(0.0);
        self.each_run(|from, to, count| products[to..to + count].copy_from_slice(&g[from..from + count]));
        let products = Matrix::new(products, taps, area);
        let mut by_taps = vec![0.0; dw.len()];
        matmul(&mut by_taps, self.c, products, Matrix::new(x, self.c, area).t(), false);
        let each = self.kh * self.kw;
        for (dw, by_taps) in dw.chunks_exact_mut(self.k()).zip(by_taps.chunks_exact(self.k())) {
            dw.iter_mut().enumerate().for_each(|(i, dw)| *dw += by_taps[i % each * self.c + i / each]);
        }
        if let Some(dx) = dx {
            matmul(dx, area, Matrix::new(&self.by_taps(w), taps, self.c).t(), products, false);
        }
    }
}
