use crate::{Intrinsics, Pose};
use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};

/// A square of the image, resampled to `size_px` x `size_px`.
///
/// `x0`, `y0` are the left and top *edges* of the square in image pixels (pixel 0 covers `[-0.5, 0.5]`), so an
/// image point u is seen at `u' = s (u - x0) - 0.5` with `s = size_px / side`. The same map makes the crop's
/// intrinsics K', so that the pose of an object in the crop is its pose in the image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Crop {
    /// Left edge of the square, image pixels.
    pub x0: f64,
    /// Top edge of the square, image pixels.
    pub y0: f64,
    /// Side of the square, image pixels.
    pub side: f64,
    /// Width and height of the resampled crop, pixels.
    pub size_px: u32,
}

impl Crop {
    /// The square around the projection of `points_in_object`, `margin` times as wide as the larger side of
    /// their bounding box (docs/method.md, step 2). `None` when a point lies behind the camera.
    #[must_use]
    pub fn around<'a>(
        points_in_object: impl IntoIterator<Item = &'a Point3<f64>>,
        camera_from_object: &Pose,
        intrinsics: &Intrinsics,
        margin: f64,
        size_px: u32,
    ) -> Option<Self> {
        let (mut low, mut high) = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
        for point in points_in_object {
            let pixel = intrinsics.project(&(camera_from_object * point))?;
            low = low.inf(&pixel);
            high = high.sup(&pixel);
        }
        let extent = high - low;
        let side = (extent.x.max(extent.y) * margin).max(4.0);
        let centre = nalgebra::center(&low, &high);
        (side.is_finite()).then(|| Self { x0: centre.x - side / 2.0, y0: centre.y - side / 2.0, side, size_px })
    }

    /// Crop pixels per image pixel.
    #[must_use]
    pub fn scale(&self) -> f64 {
        f64::from(self.size_px) / self.side
    }

    /// Where an image point is seen in the crop.
    #[must_use]
    pub fn crop_from_image(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let s = self.scale();
        Point2::new(s * (pixel.x - self.x0) - 0.5, s * (pixel.y - self.y0) - 0.5)
    }

    /// The image point that a crop point shows.
    #[must_use]
    pub fn image_from_crop(&self, pixel: &Point2<f64>) -> Point2<f64> {
        let s = self.scale();
        Point2::new((pixel.x + 0.5) / s + self.x0, (pixel.y + 0.5) / s + self.y0)
    }

    /// The intrinsics K' of the crop.
    #[must_use]
    pub fn intrinsics(&self, of_image: &Intrinsics) -> Intrinsics {
        let s = self.scale();
        let centre = self.crop_from_image(&Point2::new(of_image.cx, of_image.cy));
        Intrinsics { fx: s * of_image.fx, fy: s * of_image.fy, cx: centre.x, cy: centre.y }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CROP: Crop = Crop { x0: 12.3, y0: -4.0, side: 90.0, size_px: 128 };

    #[test]
    fn projecting_with_k_prime_is_projecting_and_cropping() {
        let k = Intrinsics { fx: 590.0, fy: 580.0, cx: 321.7, cy: 241.2 };
        let p = Point3::new(0.1, -0.2, 0.9);
        let direct = CROP.intrinsics(&k).project(&p).unwrap();
        let mapped = CROP.crop_from_image(&k.project(&p).unwrap());
        assert!((direct - mapped).norm() < 1e-9);
        assert!((CROP.image_from_crop(&mapped) - k.project(&p).unwrap()).norm() < 1e-9);
    }

    #[test]
    fn a_crop_of_the_whole_image_at_its_own_size_moves_nothing() {
        let crop = Crop { x0: -0.5, y0: -0.5, side: 64.0, size_px: 64 };
        assert_eq!(crop.crop_from_image(&Point2::new(7.0, 9.0)), Point2::new(7.0, 9.0));
    }

    #[test]
    fn the_square_holds_the_projection() {
        let k = Intrinsics { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0 };
        let points = [Point3::new(-0.1, 0.0, 0.0), Point3::new(0.1, 0.02, 0.0)];
        let pose = Pose::translation(0.0, 0.0, 1.0);
        let crop = Crop::around(&points, &pose, &k, 1.1, 256).unwrap();
        assert!((crop.side - 110.0).abs() < 1e-9);
        assert!((crop.x0 + crop.side / 2.0 - 320.0).abs() < 1e-9);
        assert!(Crop::around(&points, &Pose::translation(0.0, 0.0, -1.0), &k, 1.1, 256).is_none());
    }
}
