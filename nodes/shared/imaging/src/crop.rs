use crate::{BACKGROUND_GREY, RgbImage};
use nalgebra::Point2;
use pseudoflow_geometry::Crop;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Resamples a frame to a crop through the very map of [`Crop`], so that K' fits what is seen. Outside the frame
/// lies [`BACKGROUND_GREY`]. See [`resample_with_border`].
#[must_use]
pub fn resample(image: &RgbImage, crop: &Crop) -> RgbImage {
    resample_with_border(image, crop, [BACKGROUND_GREY; 3])
}

/// [`resample`] with a given colour outside the frame.
///
/// When enlarging, bilinear interpolation. When shrinking by f, a tent of half-width f image pixels around the
/// sampled point, normalised to sum 1: bilinear interpolation prefiltered to the crop's resolution. The map has no
/// rotation, so the filter is separable: rows first, then columns.
#[must_use]
pub fn resample_with_border(image: &RgbImage, crop: &Crop, border: [u8; 3]) -> RgbImage {
    let size = crop.size_px as usize;
    let support = (1.0 / crop.scale()).max(1.0);
    let along = |axis: usize, length: u32| -> Vec<Taps> {
        let place = |i: usize| crop.image_from_crop(&Point2::new(i as f64, i as f64))[axis];
        (0..size).map(|i| Taps::tent(place(i), support, length as usize)).collect()
    };
    let (columns, rows) = (along(0, image.width()), along(1, image.height()));
    let first = columns.iter().filter(|t| t.count > 0).map(|t| t.first).min().unwrap_or(0);
    let last = columns.iter().map(|t| t.first + t.count).max().unwrap_or(0).max(first);
    let border = border.map(f32::from);
    // The fourth number of the last pixel has its place behind it.
    let mut out = vec![0; size * size * 3 + 1];
    Arch::new().dispatch(Sums { image, columns, rows, range: first..last, border, out: &mut out });
    out.pop();
    RgbImage::from_raw(crop.size_px, crop.size_px, out).unwrap_or_default()
}

/// A crop to be summed up.
struct Sums<'a> {
    image: &'a RgbImage,
    columns: Vec<Taps>,
    rows: Vec<Taps>,
    /// Pixels of a row of the image that have a weight.
    range: Range<usize>,
    border: [f32; 3],
    /// `columns` x `rows` pixels, and a number more.
    out: &'a mut [u8],
}

impl WithSimd for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { image, columns, rows, range, border, out } = self;
        // The colours of a row of the image, and as much more as may be read beyond its end.
        let own = 3 * range.len();
        let mut line = vec![0.0_f32; own + READ];
        for (y, taps) in rows.iter().enumerate() {
            sum_rows(image, taps, &range, border, &mut line[..own]);
            sum_columns(&line, range.start, &columns, border, &mut out[3 * columns.len() * y..]);
        }
    }
}

/// The weighed sum of image rows, of the pixels `range`.
#[inline(always)]
fn sum_rows(image: &RgbImage, taps: &Taps, range: &Range<usize>, border: [f32; 3], line: &mut [f32]) {
    let width = image.width() as usize;
    line.as_chunks_mut::<3>().0.fill(border.map(|b| b * taps.outside));
    for (y, weight) in (taps.first..).zip(&taps.weights[..taps.count]) {
        let row = &image.as_raw()[3 * (y * width + range.start)..3 * (y * width + range.end)];
        line.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * f32::from(*value));
    }
}

/// The weighed sums of a row's pixels, of which the first in `line` is `first`. Four numbers go at once, as registers hold them: the
/// last is the next pixel's, and is written over by it.
#[inline(always)]
fn sum_columns(line: &[f32], first: usize, columns: &[Taps], border: [f32; 3], out: &mut [u8]) {
    let [r, g, b] = border;
    for (x, taps) in columns.iter().enumerate() {
        let mut sum = [r, g, b, b].map(|v| taps.outside * v);
        if taps.count > 0 {
            let mut pixels = &line[3 * (taps.first - first)..];
            for weights in taps.weights.as_chunks::<UNROLLED>().0 {
                let Some(own) = pixels.first_chunk::<READ>() else { break };
                for (i, weight) in weights.iter().enumerate() {
                    sum = std::array::from_fn(|k| sum[k] + weight * own[3 * i + k]);
                }
                pixels = &pixels[3 * UNROLLED..];
            }
        }
        if let Some(out) = out[3 * x..].first_chunk_mut() {
            *out = sum.map(nearest);
        }
    }
}

/// The nearest whole number of one in 0..255: added to this, it is in the lowest bits.
#[inline]
fn nearest(value: f32) -> u8 {
    (value + 12_582_912.0).to_bits() as u8
}

/// Pixels that are summed at a time along a row, and the numbers that are read for them.
const UNROLLED: usize = 2;
const READ: usize = 3 * UNROLLED + 1;

/// The weights of the image pixels `first..` for one crop pixel along one axis, and the weight that falls outside.
struct Taps {
    first: usize,
    count: usize,
    /// One for each of the pixels, then zeros up to a multiple of [`UNROLLED`].
    weights: Vec<f32>,
    outside: f32,
}

impl Taps {
    fn tent(centre: f64, support: f64, length: usize) -> Self {
        let (low, high) = ((centre - support).floor() as i64, (centre + support).ceil() as i64);
        let weight = |i: i64| (1.0 - (i as f64 - centre).abs() / support).max(0.0);
        let total: f64 = (low..=high).map(weight).sum();
        let inside = low.max(0)..(high + 1).min(length as i64);
        let first = inside.clone().find(|&i| weight(i) > 0.0).unwrap_or(0);
        let mut weights: Vec<f32> =
            inside.filter(|&i| i >= first).map(|i| (weight(i) / total) as f32).filter(|w| *w > 0.0).collect();
        let outside = 1.0 - weights.iter().sum::<f32>();
        let outside = if outside < 1e-5 { 0.0 } else { outside };
        let count = weights.len();
        weights.resize(count.next_multiple_of(UNROLLED), 0.0);
        Self { first: first as usize, count, weights, outside }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn noise(width: u32, height: u32) -> RgbImage {
        let byte = |v: u32| (v.wrapping_mul(2_654_435_761) >> 24) as u8;
        RgbImage::from_fn(width, height, |x, y| Rgb([byte(x * 31 + y * 7), byte(x + 97 * y), byte(x * y + 3)]))
    }

    #[test]
    fn whole_positions_read_texels_exactly() {
        let image = noise(40, 30);
        let out = resample(&image, &Crop { x0: 4.5, y0: 2.5, side: 16.0, size_px: 16 });
        for (x, y, pixel) in out.enumerate_pixels() {
            assert_eq!(pixel, image.get_pixel(x + 5, y + 3));
        }
    }

    #[test]
    fn a_ramp_is_read_where_the_crop_map_says_whether_it_shrinks_or_grows() {
        // 2 levels a pixel: a bias of half a pixel would show as 1.
        let image = RgbImage::from_fn(120, 120, |x, y| Rgb([(2 * x) as u8, (2 * y) as u8, 0]));
        for (x0, y0, side, size_px) in [(20.3, 14.9, 80.0, 32), (30.2, 40.7, 40.0, 128), (10.0, 10.0, 64.0, 64)] {
            let crop = Crop { x0, y0, side, size_px };
            for (x, y, pixel) in resample(&image, &crop).enumerate_pixels() {
                let at = crop.image_from_crop(&Point2::new(f64::from(x), f64::from(y)));
                assert!((f64::from(pixel[0]) - 2.0 * at.x).abs() <= 0.55, "{crop:?} {x}: {} {}", pixel[0], at.x);
                assert!((f64::from(pixel[1]) - 2.0 * at.y).abs() <= 0.55, "{crop:?} {y}: {} {}", pixel[1], at.y);
            }
        }
    }

    #[test]
    fn shrinking_averages_a_checkerboard_to_grey() {
        let image = RgbImage::from_fn(256, 256, |x, y| Rgb([((x + y) % 2 * 255) as u8; 3]));
        let out = resample(&image, &Crop { x0: 40.3, y0: 40.1, side: 160.0, size_px: 32 });
        assert!(out.as_raw().iter().all(|v| v.abs_diff(128) < 6), "{:?}", &out.as_raw()[..12]);
    }

    #[test]
    fn outside_lies_the_border() {
        let image = RgbImage::from_pixel(20, 20, Rgb([255, 0, 0]));
        let out = resample(&image, &Crop { x0: -30.5, y0: -0.5, side: 40.0, size_px: 40 });
        assert_eq!(out.get_pixel(5, 5).0, [BACKGROUND_GREY; 3]);
        assert_eq!(out.get_pixel(35, 5).0, [255, 0, 0]);
        assert_eq!(out.get_pixel(35, 35).0, [BACKGROUND_GREY; 3]);
        let far = resample(&image, &Crop { x0: 1e6, y0: -1e6, side: 40.0, size_px: 8 });
        assert!(far.as_raw().iter().all(|v| *v == BACKGROUND_GREY));
    }
}
