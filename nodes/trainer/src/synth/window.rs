//! The part of the camera's image that a crop sees.

use nalgebra::Point2;
use pseudoflow_geometry::{Crop, Intrinsics};

/// A rectangle of whole camera pixels, rendered with `supersampling` squared rays for each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// First column and row, image pixels.
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) supersampling: u32,
    intrinsics: Intrinsics,
}

/// The window goes this far beyond the crop, so that blur and JPEG blocks are as in a whole image; pixels.
const MARGIN_PX: f64 = 8.0;
/// Windows up to this width are rendered with 2 x 2 rays a pixel: far objects have fine edges.
const FINE_PX: u32 = 128;

impl Window {
    /// The window for a crop, cut at the image's border and aligned to its JPEG blocks. At least 16 pixels wide.
    pub(super) fn of_crop(crop: &Crop, intrinsics: &Intrinsics, image_px: [u32; 2]) -> Self {
        let along = |low: f64, size: u32| {
            let last_start = f64::from(size - 16);
            let start = ((low - MARGIN_PX).clamp(0.0, last_start) / 8.0).floor() * 8.0;
            let end = (low + crop.side + MARGIN_PX).ceil().clamp(start + 16.0, f64::from(size));
            (start as u32, (end - start) as u32)
        };
        let ((x0, width), (y0, height)) = (along(crop.x0, image_px[0]), along(crop.y0, image_px[1]));
        let supersampling = if width.max(height) <= FINE_PX { 2 } else { 1 };
        Self { x0, y0, width, height, supersampling, intrinsics: *intrinsics }
    }

    /// The whole image, with 2 x 2 rays a pixel.
    pub(super) fn whole(intrinsics: &Intrinsics, [width, height]: [u32; 2]) -> Self {
        Self { x0: 0, y0: 0, width, height, supersampling: 2, intrinsics: *intrinsics }
    }

    /// Width and height of the rendering, sub-pixels.
    pub(super) fn rendered_px(&self) -> (u32, u32) {
        (self.width * self.supersampling, self.height * self.supersampling)
    }

    /// The sub-pixel where a pixel of the whole image lies.
    pub(super) fn rendered_from_image(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let n = f64::from(self.supersampling);
        let map = |u: f64, from: u32| n * (u + 0.5 - f64::from(from)) - 0.5;
        Point2::new(map(pixel.x, self.x0), map(pixel.y, self.y0))
    }

    /// Intrinsics of the rendering.
    pub(super) fn rendered_intrinsics(&self) -> Intrinsics {
        let (k, n) = (&self.intrinsics, f64::from(self.supersampling));
        let centre = self.rendered_from_image(&Point2::new(k.cx, k.cy));
        Intrinsics { fx: n * k.fx, fy: n * k.fy, cx: centre.x, cy: centre.y }
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
    fn the_rendering_sees_what_the_image_sees() {
        let crop = Crop { x0: 100.3, y0: 50.2, side: 80.0, size_px: 128 };
        let window = Window::of_crop(&crop, &K, [640, 480]);
        assert_eq!(window.supersampling, 2);
        let p = Point3::new(-0.2, -0.15, 0.9);
        let direct = window.rendered_intrinsics().project(&p).unwrap();
        assert!((direct - window.rendered_from_image(&K.project(&p).unwrap())).norm() < 1e-9);
    }
}
