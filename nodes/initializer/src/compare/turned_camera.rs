//! A camera turned towards a place of the image.
//!
//! Away from the middle of a wide lens a projection is stretched, and the same turn of an object looks different. In a camera
//! turned towards the object it looks as on the optical axis, as in the views.

use crate::detect::Rectangle;
use nalgebra::{Point2, UnitQuaternion, Vector2, Vector3};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::{BACKGROUND_GREY, RgbImage};
use rayon::prelude::*;

/// An image and the camera that took it.
#[derive(Debug, Clone, Copy)]
pub struct Photograph<'a> {
    /// The image.
    pub image: &'a RgbImage,
    /// Its camera, pixels of the image.
    pub camera: &'a Intrinsics,
}

/// A camera with the real one's centre that looks at the middle of an object's projection.
#[derive(Debug, Clone, Copy)]
pub(super) struct TurnedCamera {
    pub(super) camera_from_turned: UnitQuaternion<f64>,
    /// Larger side of the projection at unit distance.
    pub(super) side: f64,
}

/// Sides that are believed; more than the largest is most of a half-space.
const SIDES: (f64, f64) = (1e-3, 4.0);

impl TurnedCamera {
    /// Towards a rectangle of the image, and the rectangle's width and height at unit distance there.
    pub(super) fn at(camera: &Intrinsics, rectangle: &Rectangle) -> (Self, Vector2<f64>) {
        let ray = |at: Point2<f64>| camera.unproject(&at, 1.0).coords;
        let turned = turn_towards(&ray(rectangle.middle_px));
        let along = |k: usize| {
            let mut half = Vector2::zeros();
            half[k] = rectangle.size_px[k] / 2.0;
            let seen = [-half, half].map(|half| {
                let there = turned.inverse() * ray(rectangle.middle_px + half);
                there[k] / there.z.max(0.1)
            });
            (seen[1] - seen[0]).clamp(SIDES.0, SIDES.1)
        };
        let size = Vector2::new(along(0), along(1));
        (Self { camera_from_turned: turned, side: size.max() }, size)
    }

    /// The camera turned towards something beside the middle (unit distance), of another size.
    pub(super) fn moved(&self, away: [f64; 2], side: f64) -> Self {
        let turned = turn_towards(&Vector3::new(away[0], away[1], 1.0));
        Self { camera_from_turned: self.camera_from_turned * turned, side: side.clamp(SIDES.0, SIDES.1) }
    }

    /// The image around the middle, `times` as wide as the projection, `size_px` pixels across. When shrinking, each pixel is
    /// the mean of those of the image around it, weighted by a tent.
    pub(super) fn look(&self, photograph: &Photograph<'_>, times: f64, size_px: u32) -> Vec<u8> {
        let (size, width) = (size_px as usize, self.side * times);
        let pixel = |x: f64, y: f64| {
            let away = |i: f64| ((i + 0.5) / size as f64 - 0.5) * width;
            photograph.camera.project(&(self.camera_from_turned * Vector3::new(away(x), away(y), 1.0)).into())
        };
        let middle = size as f64 / 2.0;
        let step = |x: f64, y: f64| match (pixel(middle, middle), pixel(middle + x, middle + y)) {
            (Some(here), Some(there)) => (there - here).norm().max(1.0),
            _ => 1.0,
        };
        let support = [step(1.0, 0.0), step(0.0, 1.0)];
        let mut rgb = vec![BACKGROUND_GREY; 3 * size * size];
        rgb.par_chunks_exact_mut(3 * size).enumerate().for_each(|(y, row)| {
            for (x, out) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                if let Some(at) = pixel(x as f64, y as f64) {
                    *out = sample(photograph.image, at, support);
                }
            }
        });
        rgb
    }
}

/// The shortest turn of the optical axis into a direction.
fn turn_towards(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    let back = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    UnitQuaternion::rotation_between(&Vector3::z(), direction).unwrap_or_else(back)
}

/// The mean of the image around a point, weighted by a tent of these half-widths along x and y; grey outside.
fn sample(image: &RgbImage, at: Point2<f64>, support: [f64; 2]) -> [u8; 3] {
    let [columns, rows] = [0, 1].map(|k| ((at[k] - support[k]).ceil() as i64)..=((at[k] + support[k]).floor() as i64));
    let weight = |k: usize, i: i64| (1.0 - (i as f64 - at[k]).abs() / support[k]).max(0.0) as f32;
    let (mut sum, mut total) = ([0.0_f32; 3], 0.0);
    for y in rows {
        for x in columns.clone() {
            let weight = weight(0, x) * weight(1, y);
            let inside = (0..i64::from(image.width())).contains(&x) && (0..i64::from(image.height())).contains(&y);
            let pixel = if inside { image.get_pixel(x as u32, y as u32).0 } else { [BACKGROUND_GREY; 3] };
            (0..3).for_each(|k| sum[k] += weight * f32::from(pixel[k]));
            total += weight;
        }
    }
    sum.map(|v| (v / total.max(1e-6) + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 320.0, cy: 240.0 };

    #[test]
    fn a_turned_camera_sees_its_middle_and_its_size() {
        let rectangle = Rectangle { middle_px: Point2::new(600.0, 100.0), size_px: Vector2::new(80.0, 60.0) };
        let (turned, size) = TurnedCamera::at(&CAMERA, &rectangle);
        let axis = CAMERA.project(&(turned.camera_from_turned * Vector3::z()).into()).unwrap();
        assert!((axis - rectangle.middle_px).norm() < 1e-9);
        // So far from the middle (46 degrees) the image is stretched by 1/cos^2 away from it and by 1/cos around it.
        let flat = Vector2::new(80.0, 60.0) / 300.0;
        assert!(size.x < 0.65 * flat.x && size.y < 0.75 * flat.y && size.y > 0.4 * flat.y, "{size}");
    }

    #[test]
    fn looking_straight_ahead_is_a_crop() {
        let image = RgbImage::from_fn(640, 480, |x, y| image::Rgb([(x % 256) as u8, (y % 256) as u8, 7]));
        let rectangle = Rectangle { middle_px: Point2::new(320.0, 240.0), size_px: Vector2::new(64.0, 64.0) };
        let (turned, _) = TurnedCamera::at(&CAMERA, &rectangle);
        let crop = pseudoflow_geometry::Crop { x0: 288.0, y0: 208.0, side: 64.0, size_px: 32 };
        let (seen, wanted) = (
            turned.look(&Photograph { image: &image, camera: &CAMERA }, 1.0, 32),
            pseudoflow_imaging::resample(&image, &crop),
        );
        let worst = seen.iter().zip(wanted.as_raw()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst <= 1, "{worst}");
    }
}
