//! A camera's image as the network's input.

use nalgebra::Point2;
use pseudoflow_geometry::{Crop, Intrinsics};
use pseudoflow_imaging::{BACKGROUND_GREY, RgbImage, resample};

/// The image is scaled until it fits and lies in the upper left corner; grey fills what is left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The whole image as a square crop, of which the input shows the upper rows.
    crop: Crop,
    /// Width and height of the input, pixels.
    input_px: [u32; 2],
    /// Width and height of the part of the input that shows the image, pixels.
    shown_px: [f64; 2],
}

impl Fit {
    /// Fits images of `width` x `height` pixels into `input_px`.
    #[must_use]
    pub fn new(width: u32, height: u32, input_px: [usize; 2]) -> Self {
        let input_px = input_px.map(|v| v as u32);
        let scale = (f64::from(input_px[0]) / f64::from(width)).min(f64::from(input_px[1]) / f64::from(height));
        let size_px = input_px[0].max(input_px[1]);
        let crop = Crop { x0: -0.5, y0: -0.5, side: f64::from(size_px) / scale, size_px };
        Self { crop, input_px, shown_px: [scale * f64::from(width), scale * f64::from(height)] }
    }

    /// The network's input.
    #[must_use]
    pub fn input(&self, image: &RgbImage) -> RgbImage {
        let square = resample(image, &self.crop);
        let [width, height] = self.input_px;
        RgbImage::from_fn(width, height, |x, y| match self.shows(f64::from(x), f64::from(y)) {
            true => *square.get_pixel(x, y),
            // The prefilter mixes the last row with grey; the training's images end sharply.
            false => image::Rgb([BACKGROUND_GREY; 3]),
        })
    }

    fn shows(&self, x: f64, y: f64) -> bool {
        x < self.shown_px[0].round() && y < self.shown_px[1].round()
    }

    /// The camera of the input.
    #[must_use]
    pub fn intrinsics(&self, camera: &Intrinsics) -> Intrinsics {
        self.crop.intrinsics(camera)
    }

    /// The image's pixel at a pixel of the input.
    #[must_use]
    pub fn image_from_input(&self, pixel: &Point2<f64>) -> Point2<f64> {
        self.crop.image_from_crop(pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_every_shape_lie_in_the_corner() {
        let k = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
        for (width, height, shown) in [(640, 480, [320, 240]), (1280, 720, [320, 180]), (300, 600, [128, 256])] {
            let fit = Fit::new(width, height, [320, 256]);
            let input = fit.input(&RgbImage::from_pixel(width, height, image::Rgb([255, 0, 0])));
            assert_eq!(input.dimensions(), (320, 256));
            let red = |x: u32, y: u32| input.get_pixel(x, y).0[0] > 180 && input.get_pixel(x, y).0[1] < 80;
            assert!(red(0, 0) && red(shown[0] - 1, shown[1] - 1), "{width} x {height}");
            let outside = input.pixels().filter(|p| p.0 == [BACKGROUND_GREY; 3]).count() as u32;
            assert_eq!(outside, 320 * 256 - shown[0] * shown[1], "{width} x {height}");
        }
        let fit = Fit::new(640, 480, [320, 256]);
        let (point, input) = (nalgebra::Point3::new(0.1, -0.05, 0.7), fit.intrinsics(&k));
        let there = fit.image_from_input(&input.project(&point).unwrap());
        assert!((there - k.project(&point).unwrap()).norm() < 1e-9);
    }
}
