//! The transforms of F(4x4, 3x3), on as many channels or filters at once as a vector holds.

use super::super::simd::{LANES, Pack};
use pulp::{Simd, WithSimd};

/// Side of an output tile, and of an input tile.
pub(super) const OUT: usize = 4;
pub(super) const IN: usize = 6;
/// Coefficients of a transformed tile.
pub(super) const FREQS: usize = IN * IN;

/// One side of a transform. Types, because functions given as arguments are not inlined.
pub(super) trait Transform<const P: usize, const Q: usize> {
    /// Transforms a row.
    fn apply<S: Simd>(row: [Pack<S>; P]) -> [Pack<S>; Q];
}

/// B^T: tiles of the input to coefficients.
pub(super) enum InputT {}

impl Transform<6, 6> for InputT {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c, d, e, f]: [Pack<S>; 6]) -> [Pack<S>; 6] {
        [
            a * 4.0 - c * 5.0 + e,
            d + e - (b + c) * 4.0,
            (b - c) * 4.0 + e - d,
            (d - b) * 2.0 + e - c,
            (b - d) * 2.0 + e - c,
            b * 4.0 - d * 5.0 + f,
        ]
    }
}

/// B: coefficients to the input's gradient.
pub(super) enum Input {}

impl Transform<6, 6> for Input {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c, d, e, f]: [Pack<S>; 6]) -> [Pack<S>; 6] {
        [
            a * 4.0,
            (c - b) * 4.0 + (e - d) * 2.0 + f * 4.0,
            a * -5.0 - (b + c) * 4.0 - d - e,
            b - c + (d - e) * 2.0 - f * 5.0,
            a + b + c + d + e,
            f,
        ]
    }
}

/// A^T: coefficients to tiles of the output.
pub(super) enum OutputT {}

impl Transform<6, 4> for OutputT {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c, d, e, f]: [Pack<S>; 6]) -> [Pack<S>; 4] {
        [a + (b + c) + (d + e), (b - c) + (d - e) * 2.0, (b + c) + (d + e) * 4.0, (b - c) + (d - e) * 8.0 + f]
    }
}

/// A: tiles of the output's gradient to coefficients.
pub(super) enum Output {}

impl Transform<4, 6> for Output {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c, d]: [Pack<S>; 4]) -> [Pack<S>; 6] {
        [a, a + b + c + d, a - b + c - d, a + b * 2.0 + c * 4.0 + d * 8.0, a - b * 2.0 + c * 4.0 - d * 8.0, d]
    }
}

/// G: weights to coefficients.
enum Weights {}

impl Transform<3, 6> for Weights {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c]: [Pack<S>; 3]) -> [Pack<S>; 6] {
        let (even, odd) = ((a + c) * (-1.0 / 6.0), b * (-1.0 / 6.0));
        let (low, high) = (a * (1.0 / 24.0) + c * (1.0 / 6.0), b * (1.0 / 12.0));
        [a * 0.25, even + odd, even - odd, low + high, low - high, c]
    }
}

/// G^T: coefficients to the weights' gradient.
enum WeightsT {}

impl Transform<6, 3> for WeightsT {
    #[inline(always)]
    fn apply<S: Simd>([a, b, c, d, e, f]: [Pack<S>; 6]) -> [Pack<S>; 3] {
        let (even, odd) = ((b + c) * (-1.0 / 6.0), (b - c) * (-1.0 / 6.0));
        [a * 0.25 + even + (d + e) * (1.0 / 24.0), odd + (d - e) * (1.0 / 12.0), even + (d + e) * (1.0 / 6.0) + f]
    }
}

/// Applies a transform to the columns, then to the rows.
// Loops, because the closures of `array::from_fn` are not inlined.
#[inline(always)]
pub(super) fn both<T: Transform<P, Q>, S: Simd, const P: usize, const Q: usize>(
    simd: S,
    tile: &[[Pack<S>; P]; P],
) -> [[Pack<S>; Q]; Q] {
    let zero = Pack::splat(simd, 0.0);
    let mut columns = [[zero; P]; Q];
    for x in 0..P {
        let mut column = [zero; P];
        for y in 0..P {
            column[y] = tile[y][x];
        }
        let column = T::apply(column);
        for y in 0..Q {
            columns[y][x] = column[y];
        }
    }
    let mut rows = [[zero; Q]; Q];
    for y in 0..Q {
        rows[y] = T::apply(columns[y]);
    }
    rows
}

struct WeightsCall<'a>(&'a [f32]);

impl WithSimd for WeightsCall<'_> {
    type Output = Vec<f32>;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f32> {
        let (lanes, filters) = (S::F32_LANES, self.0.len() / 9);
        let mut u = vec![0.0; FREQS * filters];
        for (block, w) in self.0.chunks(lanes * 9).enumerate() {
            let (first, count) = (block * lanes, w.len() / 9);
            let mut taps = [[Pack::splat(simd, 0.0); 3]; 3];
            for (k, tap) in taps.as_flattened_mut().iter_mut().enumerate() {
                let mut values = [0.0; LANES];
                w.iter().skip(k).step_by(9).zip(&mut values).for_each(|(w, value)| *value = *w);
                tap.lanes = simd.partial_load_f32s(&values[..lanes]);
            }
            for (f, pack) in both::<Weights, S, 3, 6>(simd, &taps).as_flattened().iter().enumerate() {
                simd.partial_store_f32s(&mut u[f * filters + first..][..count], pack.lanes);
            }
        }
        u
    }
}

/// w (O, C, 3, 3) to G w G^T as (36, O, C).
pub(crate) fn transform_weights(w: &[f32]) -> Vec<f32> {
    pulp::Arch::new().dispatch(WeightsCall(w))
}

/// Fills dw (filters, 3, 3) with G^T u G of filters whose coefficients k lie in row k of (36, `stride`).
pub(super) struct WeightsBack<'a> {
    pub(super) u: &'a [f32],
    pub(super) stride: usize,
    pub(super) dw: &'a mut [f32],
}

impl WithSimd for WeightsBack<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = S::F32_LANES;
        for (block, dw) in self.dw.chunks_mut(lanes * 9).enumerate() {
            let (first, count) = (block * lanes, dw.len() / 9);
            let mut coefficients = [[Pack::splat(simd, 0.0); IN]; IN];
            for (f, pack) in coefficients.as_flattened_mut().iter_mut().enumerate() {
                pack.lanes = simd.partial_load_f32s(&self.u[f * self.stride + first..][..count]);
            }
            for (k, tap) in both::<WeightsT, S, IN, 3>(simd, &coefficients).as_flattened().iter().enumerate() {
                let mut values = [0.0; LANES];
                simd.partial_store_f32s(&mut values[..lanes], tap.lanes);
                dw.iter_mut().skip(k).step_by(9).zip(&values).for_each(|(dw, value)| *dw = *value);
            }
        }
    }
}
