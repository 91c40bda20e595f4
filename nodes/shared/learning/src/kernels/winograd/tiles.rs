//! Tiles of one image, as many channels at a time as a vector holds, channels innermost: every tap of a tile is one vector.

use super::super::scratch::Scratch;
use super::super::simd::{LANES, Lanes, Pack};
use super::transforms::{IN, OUT, Transform, both};
use pulp::{Simd, WithSimd};
use std::marker::PhantomData;

/// Tiling of a plane.
#[derive(Clone, Copy)]
pub(super) struct Tiles {
    pub(super) h: usize,
    pub(super) w: usize,
    /// Tiles down and across.
    down: usize,
    across: usize,
}

impl Tiles {
    pub(super) fn new(h: usize, w: usize) -> Self {
        Self { h, w, down: h.div_ceil(OUT), across: w.div_ceil(OUT) }
    }

    pub(super) fn area(&self) -> usize {
        self.h * self.w
    }

    pub(super) fn count(&self) -> usize {
        self.down * self.across
    }

    /// Row length of a plane of whole tiles and a border of one.
    fn padded_width(&self) -> usize {
        OUT * self.across + 2
    }

    fn padded_len(&self) -> usize {
        (OUT * self.down + 2) * self.padded_width()
    }

    /// Where the corner of a tile lies in the padded plane.
    #[inline(always)]
    fn corner(&self, tile: usize) -> usize {
        tile / self.across * OUT * self.padded_width() + tile % self.across * OUT
    }

    /// Where row y of a plane begins in the padded one, at the given border.
    fn row(&self, y: usize, border: usize) -> usize {
        (y + border) * self.padded_width() + border
    }

    /// Copies planes into the padded one, `lanes` values a pixel, at the given border; what lies around stays.
    #[inline(never)]
    fn pad(&self, planes: &[f32], lanes: usize, border: usize, padded: &mut [f32]) {
        for (c, four) in planes.chunks(4 * self.area()).enumerate() {
            for y in 0..self.h {
                let target = &mut padded[self.row(y, border) * lanes..][..self.w * lanes];
                interleave(&four[y * self.w..], self.area(), target, lanes, 4 * c);
            }
        }
    }

    /// The planes inside the padded one.
    #[inline(never)]
    fn crop(&self, padded: &[f32], lanes: usize, border: usize, planes: &mut [f32]) {
        for (c, four) in planes.chunks_mut(4 * self.area()).enumerate() {
            for y in 0..self.h {
                let source = &padded[self.row(y, border) * lanes..][..self.w * lanes];
                deinterleave(source, lanes, 4 * c, &mut four[y * self.w..], self.area());
            }
        }
    }
}

/// Rows of up to four planes, `area` apart, to the lanes from `first` on of pixels of `lanes` values: in squares of four.
#[inline(always)]
fn interleave(rows: &[f32], area: usize, pixels: &mut [f32], lanes: usize, first: usize) {
    let (width, count) = (pixels.len() / lanes, rows.len().div_ceil(area).min(4));
    let mut x = 0;
    if count == 4 && lanes >= 4 {
        while x + 4 <= width {
            let mut square = [[0.0; 4]; 4];
            for c in 0..4 {
                square[c].copy_from_slice(&rows[c * area + x..][..4]);
            }
            for i in 0..4 {
                let pixel = [square[0][i], square[1][i], square[2][i], square[3][i]];
                pixels[(x + i) * lanes + first..][..4].copy_from_slice(&pixel);
            }
            x += 4;
        }
    }
    for x in x..width {
        for c in 0..count {
            pixels[x * lanes + first + c] = rows[c * area + x];
        }
    }
}

/// The inverse of [`interleave`].
#[inline(always)]
fn deinterleave(pixels: &[f32], lanes: usize, first: usize, rows: &mut [f32], area: usize) {
    let (width, count) = (pixels.len() / lanes, rows.len().div_ceil(area).min(4));
    let mut x = 0;
    if count == 4 && lanes >= 4 {
        while x + 4 <= width {
            let mut square = [[0.0; 4]; 4];
            for i in 0..4 {
                square[i].copy_from_slice(&pixels[(x + i) * lanes + first..][..4]);
            }
            for c in 0..4 {
                let row = [square[0][c], square[1][c], square[2][c], square[3][c]];
                rows[c * area + x..][..4].copy_from_slice(&row);
            }
            x += 4;
        }
    }
    for x in x..width {
        for c in 0..count {
            rows[c * area + x] = pixels[x * lanes + first + c];
        }
    }
}

/// Transforms the planes of an image, tiles of side P at the given border, to its part of each frequency: (tiles, channels),
/// channels in whole [`Lanes`].
pub(super) fn to_coefficients<T: Transform<P, IN>, const P: usize>(
    tiles: Tiles,
    border: usize,
    planes: &[f32],
    freqs: Vec<&mut [Lanes]>,
) {
    pulp::Arch::new().dispatch(ToCoefficients::<T, P> { tiles, border, planes, freqs, transform: PhantomData });
}

struct ToCoefficients<'a, T, const P: usize> {
    tiles: Tiles,
    border: usize,
    planes: &'a [f32],
    freqs: Vec<&'a mut [Lanes]>,
    transform: PhantomData<T>,
}

impl<T: Transform<P, IN>, const P: usize> WithSimd for ToCoefficients<'_, T, P> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (tiles, lanes, width) = (self.tiles, S::F32_LANES, self.tiles.padded_width());
        let mut freqs: Vec<&mut [S::f32s]> =
            self.freqs.into_iter().map(|freq| S::as_mut_simd_f32s(freq.as_flattened_mut()).0).collect();
        let stride = freqs[0].len() / tiles.count();
        let mut padded = Scratch::lend(tiles.padded_len());
        padded.fill([0.0; LANES]);
        for (block, planes) in self.planes.chunks(lanes * tiles.area()).enumerate() {
            tiles.pad(planes, lanes, self.border, padded.as_flattened_mut());
            let padded = S::as_simd_f32s(padded.as_flattened()).0;
            for tile in 0..tiles.count() {
                let corner = tiles.corner(tile);
                let mut taps = [[Pack::splat(simd, 0.0); P]; P];
                for y in 0..P {
                    let row = &padded[corner + y * width..][..P];
                    for x in 0..P {
                        taps[y][x].lanes = row[x];
                    }
                }
                let values = both::<T, S, P, IN>(simd, &taps);
                for (freq, value) in freqs.iter_mut().zip(values.as_flattened()) {
                    freq[tile * stride + block] = value.lanes;
                }
            }
        }
    }
}

/// Transforms an image's part of each frequency to tiles of side Q at the given border of its planes. Tiles that overlap add
/// up; to others each plane's bias is added, and they are clamped at `floor`.
pub(super) fn from_coefficients<T: Transform<IN, Q>, const Q: usize>(
    tiles: Tiles,
    border: usize,
    freqs: Vec<&[Lanes]>,
    bias: &[f32],
    floor: f32,
    planes: &mut [f32],
) {
    let transform = PhantomData;
    pulp::Arch::new().dispatch(FromCoefficients::<T, Q> { tiles, border, freqs, bias, floor, planes, transform });
}

struct FromCoefficients<'a, T, const Q: usize> {
    tiles: Tiles,
    border: usize,
    freqs: Vec<&'a [Lanes]>,
    bias: &'a [f32],
    floor: f32,
    planes: &'a mut [f32],
    transform: PhantomData<T>,
}

impl<T: Transform<IN, Q>, const Q: usize> WithSimd for FromCoefficients<'_, T, Q> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (tiles, lanes, width) = (self.tiles, S::F32_LANES, self.tiles.padded_width());
        let freqs: Vec<&[S::f32s]> =
            self.freqs.into_iter().map(|freq| S::as_simd_f32s(freq.as_flattened()).0).collect();
        let stride = freqs[0].len() / tiles.count();
        let floor = Pack::splat(simd, self.floor);
        let mut padded = Scratch::lend(tiles.padded_len());
        for (block, planes) in self.planes.chunks_mut(lanes * tiles.area()).enumerate() {
            if Q > OUT {
                padded.fill([0.0; LANES]);
            }
            let first = (block * lanes).min(self.bias.len());
            let last = (first + lanes).min(self.bias.len());
            let bias = Pack::new(simd, simd.partial_load_f32s(&self.bias[first..last]));
            let plane = S::as_mut_simd_f32s(padded.as_flattened_mut()).0;
            for tile in 0..tiles.count() {
                let mut values = [[Pack::splat(simd, 0.0); IN]; IN];
                for (value, freq) in values.as_flattened_mut().iter_mut().zip(&freqs) {
                    value.lanes = freq[tile * stride + block];
                }
                let values = both::<T, S, IN, Q>(simd, &values);
                for y in 0..Q {
                    let row = &mut plane[tiles.corner(tile) + y * width..][..Q];
                    for x in 0..Q {
                        row[x] = if Q > OUT {
                            (Pack::new(simd, row[x]) + values[y][x]).lanes
                        } else {
                            (values[y][x] + bias).at_least(floor).lanes
                        };
                    }
                }
            }
            tiles.crop(padded.as_flattened(), lanes, self.border, planes);
        }
    }
}
