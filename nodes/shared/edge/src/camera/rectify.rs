mod cubic;

use super::calibration::Calibration;
use super::{CalibrationError, Distortion};
use cubic::{Cubic, Place, SIDE};
use nalgebra::{Matrix3, Vector3};
use pseudoflow_imaging::BACKGROUND_GREY;

/// Takes the distortion out of images of one size: for each pixel of the rectified image, where it is seen in the image as it
/// came (OpenCV's `initUndistortRectifyMap`), sampled by cubic convolution (`cubic`) in steps of 1/128 pixel. What the camera did not see is grey.
#[derive(Debug, Clone)]
pub struct Rectifier {
    width: usize,
    height: usize,
    taps: Vec<Tap>,
    cubic: Cubic,
    map: Map,
}

/// Where a pixel comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    /// Byte of the upper left of 4 x 4 pixels; that of the grey behind the image where the camera did not see.
    offset: u32,
    /// Weights of their columns and rows.
    across: Place,
    down: Place,
}

/// Half a pixel around the image still counts as seen.
const MARGIN_PX: f64 = 0.5;

impl Rectifier {
    /// `None` where nothing is to be done.
    ///
    /// # Errors
    /// When the distortion folds back inside the image.
    pub(super) fn new(calibration: &Calibration, size: (u32, u32)) -> Result<Option<Self>, CalibrationError> {
        let Some(distortion) = calibration.distortion else { return Ok(None) };
        let map = Map::new(calibration, distortion, size)?;
        let (width, height) = (size.0 as usize, size.1 as usize);
        if width < SIDE || height < SIDE {
            return Ok(None);
        }
        let pixels = (0..height).flat_map(|v| (0..width).map(move |u| [u as f64, v as f64]));
        let taps = pixels.map(|pixel| Tap::new(map.source(pixel), width, height)).collect();
        Ok(Some(Self { width, height, taps, cubic: Cubic::new(), map }))
    }

    /// Where what a pixel of the rectified image shows is in the image as it came.
    #[must_use]
    pub fn source(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        self.map.source(pixel)
    }

    /// Rectifies `source`, rows of R, G, B, into `target`.
    pub fn apply(&self, source: &mut Vec<u8>, target: &mut Vec<u8>) {
        let (len, stride) = (self.width * self.height * 3, self.width * 3);
        debug_assert_eq!(source.len(), len);
        // Behind the image lie rows of grey, and the bytes that reading four pixels as sixteen bytes reaches beyond them.
        source.resize(len + (SIDE - 1) * stride + 16, BACKGROUND_GREY);
        target.resize(len, 0);
        self.cubic.sample(&self.taps, source, stride, target.as_chunks_mut::<3>().0);
        source.truncate(len);
    }
}

impl Tap {
    fn new(at: Option<[f64; 2]>, width: usize, height: usize) -> Self {
        let inside = |at: f64, size: usize| at > -MARGIN_PX && at < size as f64 - 1.0 + MARGIN_PX;
        let Some([x, y]) = at.filter(|[x, y]| inside(*x, width) && inside(*y, height)) else {
            return Self { offset: (width * height * 3) as u32, across: Place::WHOLE, down: Place::WHOLE };
        };
        let ((column, across), (row, down)) = (Place::new(x, width), Place::new(y, height));
        Self { offset: ((row * width + column) * 3) as u32, across, down }
    }
}

/// From pixels of the rectified image to pixels of the image as it came.
#[derive(Debug, Clone)]
pub(super) struct Map {
    raw: [f64; 4],
    distortion: Distortion,
    ray_from_pixel: Matrix3<f64>,
    /// Rays farther from the axis than this are not seen.
    r_limit: f64,
}

impl Map {
    pub(super) fn new(
        calibration: &Calibration,
        distortion: Distortion,
        size: (u32, u32),
    ) -> Result<Self, CalibrationError> {
        let [fx, fy, cx, cy] = calibration.rectified;
        let pixel_from_ray = Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0) * calibration.rotation;
        // A camera matrix with positive focal lengths times a rotation has an inverse.
        let ray_from_pixel = pixel_from_ray.try_inverse().ok_or(CalibrationError::Rotation)?;
        let mut map = Self { raw: calibration.raw, distortion, ray_from_pixel, r_limit: f64::INFINITY };
        let (right, lower) = (f64::from(size.0) - 1.0, f64::from(size.1) - 1.0);
        let corners = [[0.0, 0.0], [right, 0.0], [0.0, lower], [right, lower]];
        let seen = corners.iter().map(|c| map.ray(*c).map_or(f64::INFINITY, |[x, y]| x.hypot(y))).fold(0.0, f64::max);
        let [fx, fy, cx, cy] = map.raw;
        let needed = corners.iter().map(|[u, v]| ((u - cx) / fx).hypot((v - cy) / fy)).fold(0.0, f64::max);
        if let Some(radius) = distortion.fold(seen.min(1e3)) {
            let shown = distortion.radial(radius);
            if shown < needed {
                return Err(CalibrationError::Folds { radius, radius_px: shown * fx });
            }
            map.r_limit = radius;
        }
        Ok(map)
    }

    /// X / Z, Y / Z of what a pixel of the rectified image shows; `None` behind the camera.
    fn ray(&self, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
        let ray = self.ray_from_pixel * Vector3::new(u, v, 1.0);
        (ray.z > 1e-9).then(|| [ray.x / ray.z, ray.y / ray.z])
    }

    /// Where it is in the image as it came.
    pub(super) fn source(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let ray = self.ray(pixel).filter(|[x, y]| x.hypot(*y) < self.r_limit)?;
        let [x, y] = self.distortion.distort(ray);
        let [fx, fy, cx, cy] = self.raw;
        Some([fx * x + cx, fy * y + cy])
    }
}

#[cfg(test)]
mod tests {
    use super::super::calibration::Calibration;
    use super::super::{CalibrationError, Lens};
    use super::*;
    use pseudoflow_msgs::ros::{CameraInfo, Header};

    const SIZE: (u32, u32) = (160, 120);

    fn info(model: &str, d: &[f64]) -> CameraInfo {
        let pinhole = CameraInfo::pinhole(Header::default(), SIZE, [130.0, 128.0, 81.0, 58.5]);
        CameraInfo { distortion_model: model.into(), d: d.to_vec(), ..pinhole }
    }

    /// A smooth picture whose colours say where a pixel was.
    fn colour([x, y]: [f64; 2]) -> [f64; 3] {
        [128.0 + 100.0 * (x * 0.05).sin(), 128.0 + 100.0 * (y * 0.06).cos(), 60.0 + 0.5 * (x + y)]
    }

    #[test]
    fn a_bent_picture_becomes_straight() {
        for (model, d) in [
            ("plumb_bob", vec![-0.2, 0.05, 0.001, -0.002, 0.01]),
            ("rational_polynomial", vec![0.3, 0.1, 0.0005, -0.0003, 0.02, 0.5, 0.15, 0.03]),
            ("equidistant", vec![-0.02, 0.01, -0.003, 0.0005]),
        ] {
            let info = info(model, &d);
            let lens = Lens::new(&info, SIZE, false).unwrap();
            // The picture as bent by the lens is colour(straight pixel); the straight one is found by iterating.
            let calibration = Calibration::new(&info, SIZE, false).unwrap();
            let map = Map::new(&calibration, calibration.distortion.unwrap(), SIZE).unwrap();
            let straight = |bent: [f64; 2]| {
                let mut at = bent;
                for _ in 0..50 {
                    let there = map.source(at).unwrap_or(bent);
                    at = [at[0] + bent[0] - there[0], at[1] + bent[1] - there[1]];
                }
                at
            };
            let pixels = (0..SIZE.1).flat_map(|v| (0..SIZE.0).map(move |u| [f64::from(u), f64::from(v)]));
            let mut rgb: Vec<u8> = pixels.clone().flat_map(|p| colour(straight(p)).map(|c| c.round() as u8)).collect();
            lens.rectify(&mut rgb, &mut Vec::new());
            for (pixel, found) in pixels.zip(rgb.chunks_exact(3)) {
                let seen = map.source(pixel).is_some_and(|[x, y]| x >= 0.0 && y >= 0.0 && x <= 159.0 && y <= 119.0);
                let wrong = colour(pixel).iter().zip(found).map(|(a, b)| (a - f64::from(*b)).abs()).fold(0.0, f64::max);
                assert!(!seen || wrong < 3.0, "{model} {pixel:?}: {found:?}, {:?}", colour(pixel));
            }
        }
    }

    #[test]
    fn what_was_not_seen_is_grey() {
        let lens = Lens::new(&info("plumb_bob", &[0.3, 0.0, 0.0, 0.0, 0.0]), SIZE, false).unwrap();
        let mut rgb = vec![10; 160 * 120 * 3];
        lens.rectify(&mut rgb, &mut Vec::new());
        assert_eq!((rgb[..3].to_vec(), rgb[(60 * 160 + 80) * 3]), (vec![BACKGROUND_GREY; 3], 10));
    }

    #[test]
    fn a_lens_that_folds_inside_the_image_is_refused_with_the_radius() {
        let error = Lens::new(&info("plumb_bob", &[-1.0, 0.0, 0.0, 0.0]), SIZE, false).unwrap_err();
        let CalibrationError::Folds { radius, radius_px } = error else { panic!("{error}") };
        // r - r^3 turns at 1 / sqrt(3), where it is 0.385.
        assert!((radius - 0.577).abs() < 2e-3 && (radius_px - 0.3849 * 130.0).abs() < 0.1, "{radius} {radius_px}");
    }

    #[test]
    fn images_whose_pixels_are_no_whole_number_of_blocks_are_rectified_to_their_last() {
        let size = (13, 9);
        let pinhole = CameraInfo::pinhole(Header::default(), size, [13.0, 13.0, 6.0, 4.0]);
        let info = CameraInfo { distortion_model: "plumb_bob".into(), d: vec![-0.01, 0.0, 0.0, 0.0], ..pinhole };
        let mut rgb = vec![90; 13 * 9 * 3];
        Lens::new(&info, size, false).unwrap().rectify(&mut rgb, &mut Vec::new());
        assert_eq!(rgb, vec![90; 13 * 9 * 3]);
    }
}
