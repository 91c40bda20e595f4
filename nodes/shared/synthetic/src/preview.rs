//! A sheet of samples for the eye.

use crate::Sample;
use image::Rgb;
use pseudoflow_imaging::{BACKGROUND_GREY, RgbImage, flow_to_colour};

/// Pixels between pictures.
const GAP_PX: u32 = 4;

/// One row per sample, all of one size: reference, real-like image, flow colours on what is visible, and the
/// real-like image fetched back along the flow. Where the label is right, the last resembles the first.
#[must_use]
pub fn preview_sheet(samples: &[Sample]) -> RgbImage {
    let size = samples.first().map_or(0, |s| s.label.size_px);
    let (width, height) = (4 * (size + GAP_PX), samples.len() as u32 * (size + GAP_PX));
    let mut sheet = RgbImage::from_pixel(width.max(1), height.max(1), Rgb([255; 3]));
    for (row, sample) in samples.iter().enumerate() {
        let pictures = [&sample.reference, &sample.real_like, &flow_picture(sample), &warped(sample)];
        for (column, picture) in pictures.into_iter().enumerate() {
            let (x0, y0) = (column as u32 * (size + GAP_PX), row as u32 * (size + GAP_PX));
            for (x, y, pixel) in picture.enumerate_pixels().filter(|(x, y, _)| *x < size && *y < size) {
                sheet.put_pixel(x0 + x, y0 + y, *pixel);
            }
        }
    }
    sheet
}

fn flow_picture(sample: &Sample) -> RgbImage {
    let label = &sample.label;
    let visible = |(flow, seen): (&[f32; 2], &bool)| if *seen { *flow } else { [f32::NAN; 2] };
    let shown: Vec<[f32; 2]> = label.flow_px.iter().zip(&label.visible).map(visible).collect();
    flow_to_colour(&shown, label.size_px, label.size_px, 0.2 * label.size_px as f32)
}

/// For each visible pixel of the reference, the real-like pixel nearest to where its flow points.
fn warped(sample: &Sample) -> RgbImage {
    let size = sample.label.size_px;
    let last = (size.max(1) - 1) as f32;
    RgbImage::from_fn(size, size, |x, y| {
        let index = (y * size + x) as usize;
        if !sample.label.visible[index] {
            return Rgb([BACKGROUND_GREY; 3]);
        }
        let [dx, dy] = sample.label.flow_px[index];
        let (u, v) = ((x as f32 + dx).round().clamp(0.0, last), (y as f32 + dy).round().clamp(0.0, last));
        *sample.real_like.get_pixel(u as u32, v as u32)
    })
}
