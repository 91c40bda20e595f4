use crate::{BACKGROUND_GREY, RgbImage};
use nalgebra::Point2;
use pseudoflow_geometry::Crop;

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
/// rotation, so the filter is separable: columns first, then rows.
#[must_use]
pub fn resample_with_border(image: &RgbImage, crop: &Crop, border: [u8; 3]) -> RgbImage {
    let size = crop.size_px as usize;
    let support = (1.0 / crop.scale()).max(1.0);
    let along = |axis: usize, length: u32| -> Vec<Taps> {
        let place = |i: usize| crop.image_from_crop(&Point2::new(i as f64, i as f64))[axis];
        (0..size).map(|i| Taps::tent(place(i), support, length as usize)).collect()
    };
    let (columns, rows) = (along(0, image.width()), along(1, image.height()));
    let first = rows.iter().filter(|t| !t.weights.is_empty()).map(|t| t.first).min().unwrap_or(0);
    let last = rows.iter().map(|t| t.first + t.weights.len()).max().unwrap_or(0);
    let border = border.map(f32::from);
    let strip = shrink_columns(image, &columns, first..last.max(first), border);
    let mut out = Vec::with_capacity(size * size * 3);
    let mut line = vec![0.0_f32; size * 3];
    for taps in &rows {
        for x in 0..size {
            (0..3).for_each(|k| line[3 * x + k] = taps.outside * border[k]);
        }
        for (i, weight) in taps.weights.iter().enumerate() {
            let row = &strip[(taps.first + i - first) * size * 3..][..size * 3];
            line.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
        }
        out.extend(line.iter().map(|v| (v + 0.5) as u8));
    }
    RgbImage::from_raw(crop.size_px, crop.size_px, out).unwrap_or_default()
}

/// The rows `range` of the image, each resampled to the crop's columns; `range x size x 3`.
fn shrink_columns(image: &RgbImage, columns: &[Taps], range: std::ops::Range<usize>, border: [f32; 3]) -> Vec<f32> {
    let width = image.width() as usize;
    let mut strip = Vec::with_capacity(range.len() * columns.len() * 3);
    for y in range {
        let row = &image.as_raw()[y * width * 3..][..width * 3];
        for taps in columns {
            let mut sum = border.map(|b| b * taps.outside);
            let pixels = row[3 * taps.first.min(width)..].as_chunks::<3>().0;
            for (weight, pixel) in taps.weights.iter().zip(pixels) {
                (0..3).for_each(|k| sum[k] += weight * f32::from(pixel[k]));
            }
            strip.extend(sum);
        }
    }
    strip
}

/// The weights of the image pixels `first..` for one crop pixel along one axis, and the weight that falls outside.
struct Taps {
    first: usize,
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
        let weights: Vec<f32> =
            inside.filter(|&i| i >= first).map(|i| (weight(i) / total) as f32).filter(|w| *w > 0.0).collect();
        let outside = 1.0 - weights.iter().sum::<f32>();
        let outside = if outside < 1e-5 { 0.0 } else { outside };
        Self { first: first as usize, weights, outside }
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
