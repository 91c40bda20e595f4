//! The part of the camera's image that a crop sees.

use super::sensor::LinearImage;
use nalgebra::Point2;
use pseudoflow_geometry::{Crop, Intrinsics};

/// A rectangle of whole camera pixels, covered with [`SAMPLES`] squared samples for each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// First column and row, image pixels.
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    intrinsics: Intrinsics,
}

/// The window goes this far beyond the crop, so that blur and JPEG blocks are as in a whole image; pixels.
const MARGIN_PX: f64 = 8.0;
/// Samples of a pixel along each axis.
pub(super) const SAMPLES: u32 = 2;

impl Window {
    /// The window for a crop, cut at the image's border and aligned to its JPEG blocks. At least 16 pixels wide.
    pub(super) fn of_crop(crop: &Crop, intrinsics: &Intrinsics, image_px: [u32; 2]) -> Self {
        Self::of_crops(std::iter::once(crop), intrinsics, image_px)
    }

    /// The window that holds all crops.
    pub(super) fn of_crops<'a>(
        crops: impl Iterator<Item = &'a Crop> + Clone,
        intrinsics: &Intrinsics,
        image_px: [u32; 2],
    ) -> Self {
        let along = |low: fn(&Crop) -> f64, size: u32| {
            let first = crops.clone().map(low).fold(f64::MAX, f64::min);
            let last = crops.clone().map(|c| low(c) + c.side).fold(f64::MIN, f64::max);
            let last_start = f64::from(size - 16);
            let start = ((first - MARGIN_PX).clamp(0.0, last_start) / 8.0).floor() * 8.0;
            let end = (last + MARGIN_PX).ceil().clamp(start + 16.0, f64::from(size));
            (start as u32, (end - start) as u32)
        };
        let ((x0, width), (y0, height)) = (along(|c| c.x0, image_px[0]), along(|c| c.y0, image_px[1]));
        Self { x0, y0, width, height, intrinsics: *intrinsics }
    }

    /// The whole image.
    pub(super) fn whole(intrinsics: &Intrinsics, [width, height]: [u32; 2]) -> Self {
        Self { x0: 0, y0: 0, width, height, intrinsics: *intrinsics }
    }

    /// Width and height in samples.
    pub(super) fn sampled_px(&self) -> (u32, u32) {
        (self.width * SAMPLES, self.height * SAMPLES)
    }

    /// The sample where a pixel of the whole image lies.
    pub(super) fn sample_from_image(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let n = f64::from(SAMPLES);
        let map = |u: f64, from: u32| n * (u + 0.5 - f64::from(from)) - 0.5;
        Point2::new(map(pixel.x, self.x0), map(pixel.y, self.y0))
    }

    /// Intrinsics of the samples.
    pub(super) fn sampled_intrinsics(&self) -> Intrinsics {
        let (k, n) = (&self.intrinsics, f64::from(SAMPLES));
        let centre = self.sample_from_image(&Point2::new(k.cx, k.cy));
        Intrinsics { fx: n * k.fx, fy: n * k.fy, cx: centre.x, cy: centre.y }
    }

    /// The part of this window that lies in another one; at least a pixel of it where they do not meet.
    pub(super) fn within(self, other: &Self) -> Self {
        let along = |start: u32, length: u32, other_start: u32, other_length: u32| {
            let last = other_start + other_length;
            let from = start.clamp(other_start, last - 1);
            (from, (start + length).clamp(from + 1, last) - from)
        };
        let (x0, width) = along(self.x0, self.width, other.x0, other.width);
        let (y0, height) = along(self.y0, self.height, other.y0, other.height);
        Self { x0, y0, width, height, ..self }
    }

    /// What this window, which lies in `other`, shows of the other's picture.
    pub(super) fn part_of(&self, other: &Self, picture: &LinearImage) -> LinearImage {
        let [x0, y0] = [self.x0 - other.x0, self.y0 - other.y0].map(|v| v as usize);
        picture.part(x0, y0, self.width as usize, self.height as usize)
    }

    /// The crop in coordinates of the window.
    pub(super) fn crop(&self, crop: &Crop) -> Crop {
        Crop { x0: crop.x0 - f64::from(self.x0), y0: crop.y0 - f64::from(self.y0), ..*crop }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    const K: Intrinsics = Intrinsics { fx: 600.0, fy: 602.0, cx: 321.0, cy: 238.0 };

    #[test]
    fn windows_stay_in_the_image_and_hold_the_crop() {
        for (x0, y0, side) in [(100.3, 50.2, 80.0), (-30.0, 400.0, 150.0), (600.0, -90.0, 120.0), (-10.0, -10.0, 700.0)]
        {
            let crop = Crop { x0, y0, side, size_px: 128 };
            let window = Window::of_crop(&crop, &K, [640, 480]);
            assert!(window.x0 + window.width <= 640 && window.y0 + window.height <= 480, "{window:?}");
            assert!(
                f64::from(window.x0) <= x0.max(0.0) && f64::from(window.x0 + window.width) >= (x0 + side).min(640.0)
            );
        }
    }

    #[test]
    fn the_samples_see_what_the_image_sees() {
        let crop = Crop { x0: 100.3, y0: 50.2, side: 80.0, size_px: 128 };
        let window = Window::of_crop(&crop, &K, [640, 480]);
        let p = Point3::new(-0.2, -0.15, 0.9);
        let direct = window.sampled_intrinsics().project(&p).unwrap();
        assert!((direct - window.sample_from_image(&K.project(&p).unwrap())).norm() < 1e-9);
    }
}
