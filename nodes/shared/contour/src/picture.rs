//! The part of an image around an object, brought to one size of the object, as colour bins.

use crate::ContourError;
use crate::histogram::{NOWHERE, bin_of};
use nalgebra::{Point2, Point3};
use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::{RgbImage, resample};

/// A picture whose object is of a known size, whatever its size in the image was.
#[derive(Debug, Clone, Default)]
pub(crate) struct Picture {
    /// Colour bin of each pixel; [`NOWHERE`] outside the image.
    pub(crate) bins: Vec<u16>,
    /// Colours, one plane a channel, 0..255.
    pub(crate) channels: [Vec<f32>; 3],
    pub(crate) size_px: usize,
    /// Corners of what lies in the image.
    pub(crate) low: [f32; 2],
    pub(crate) high: [f32; 2],
    pub(crate) focal: [f32; 2],
    pub(crate) centre: [f32; 2],
    /// Pixels of the image for one pixel of the picture, at most one: neighbouring pixels of an enlarged picture tell the same.
    pub(crate) independence: f32,
}

/// An image as the camera gave it.
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    /// The pixels.
    pub rgb: &'a RgbImage,
    /// Its camera.
    pub intrinsics: Intrinsics,
}

impl Picture {
    /// The picture around a sphere (middle in the object's frame, radius; metres), whose diameter becomes `object_px`, with
    /// `margin` times that in all. `None` when the object is behind the camera or not in the image.
    pub(crate) fn fill(
        &mut self,
        image: &Image<'_>,
        camera_from_object: &Pose,
        (centre_m, radius_m): (&Point3<f64>, f64),
        object_px: f64,
        margin: f64,
    ) -> Option<()> {
        let centre = camera_from_object * centre_m;
        let at = image.intrinsics.project(&centre).filter(|_| centre.z > radius_m)?;
        let diameter_px = 2.0 * radius_m * image.intrinsics.fx.max(image.intrinsics.fy) / centre.z;
        let side = diameter_px * margin;
        let size_px = (object_px * margin).round();
        let crop = Crop { x0: at.x - side / 2.0, y0: at.y - side / 2.0, side, size_px: size_px as u32 };
        let (width, height) = (f64::from(image.rgb.width()), f64::from(image.rgb.height()));
        let within = |low: f64, length: f64| low < length - 0.5 && low + side > -0.5;
        if !(side.is_finite() && side >= 4.0 && within(crop.x0, width) && within(crop.y0, height)) {
            return None;
        }
        let resampled = resample(image.rgb, &crop);
        self.size_px = size_px as usize;
        self.take(&resampled);
        self.blank_outside(&crop, width, height);
        let k = crop.intrinsics(&image.intrinsics);
        (self.focal, self.centre) = ([k.fx as f32, k.fy as f32], [k.cx as f32, k.cy as f32]);
        self.independence = (1.0 / crop.scale()).min(1.0) as f32;
        Some(())
    }

    /// Colours and their bins.
    fn take(&mut self, resampled: &RgbImage) {
        let pixels = resampled.as_raw().as_chunks::<3>().0;
        self.bins.clear();
        self.bins.extend(pixels.iter().map(|rgb| bin_of(*rgb)));
        for (c, plane) in self.channels.iter_mut().enumerate() {
            plane.clear();
            plane.extend(pixels.iter().map(|rgb| f32::from(rgb[c])));
        }
    }

    /// Whether a place lies in the image.
    pub(crate) fn shows(&self, at: [f32; 2]) -> bool {
        (0..2).all(|a| at[a] >= self.low[a] && at[a] <= self.high[a])
    }

    /// The colour bin at a place of the picture.
    pub(crate) fn bin(&self, x: f32, y: f32) -> Option<u16> {
        let (x, y) = (x.round() as i32, y.round() as i32);
        let within = x >= 0 && y >= 0 && x < self.size_px as i32 && y < self.size_px as i32;
        within.then(|| self.bins[y as usize * self.size_px + x as usize])
    }

    /// What of the picture lies in the image, and no colours elsewhere.
    fn blank_outside(&mut self, crop: &Crop, width: f64, height: f64) {
        let (first, last) = (Point2::new(0.0, 0.0), Point2::new(width - 1.0, height - 1.0));
        let (low, high) = (crop.crop_from_image(&first), crop.crop_from_image(&last));
        let limit = self.size_px as f64 - 1.0;
        self.low = [low.x.max(0.0) as f32, low.y.max(0.0) as f32];
        self.high = [high.x.min(limit) as f32, high.y.min(limit) as f32];
        if self.low == [0.0; 2] && self.high == [limit as f32; 2] {
            return;
        }
        for y in 0..self.size_px {
            for x in 0..self.size_px {
                if !self.shows([x as f32, y as f32]) {
                    self.bins[y * self.size_px + x] = NOWHERE;
                }
            }
        }
    }
}

/// An image of packed bytes, three for each pixel.
///
/// # Errors
/// [`ContourError::Picture`] when the count of bytes does not fit.
pub fn image_of_bytes(rgb: &[u8], width: usize, height: usize) -> Result<RgbImage, ContourError> {
    let image = RgbImage::from_raw(width as u32, height as u32, rgb.to_vec());
    image.ok_or(ContourError::Picture { width, height, need: 3 * width * height, got: rgb.len() })
}
