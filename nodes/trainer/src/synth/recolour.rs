//! Colours of the reference that are not those of the real object, as those of scanned and painted meshes are not.

use super::config::LookConfig;
use super::random::Draw;
use pseudoflow_imaging::RgbImage;
use rand::Rng;

/// A change of the colours of a rendering.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Recolour {
    saturation: f32,
    /// New value of each byte, for each channel.
    curves: Box<[[u8; 256]; 3]>,
}

impl Recolour {
    /// `None` for the colours as they are. Strong changes are rarer than weak ones.
    pub(super) fn draw(rng: &mut impl Rng, config: &LookConfig) -> Option<Self> {
        if rng.chance(config.plain_reference) {
            // What is left is the shading of a grey thing.
            let grey = rng.uniform32(90.0, 225.0);
            return Some(Self { saturation: 0.0, curves: Box::new([[grey as u8; 256]; 3]) });
        }
        if !rng.chance(config.wrong_colours) {
            return None;
        }
        let strength = rng.uniform32(0.2, 1.0);
        let gamma = (strength * rng.uniform32(-0.6, 0.6)).exp();
        let gain = (strength * rng.uniform32(-0.5, 0.35)).exp();
        let tint: [f32; 3] = std::array::from_fn(|_| gain * (strength * rng.uniform32(-0.2, 0.2)).exp());
        let saturation = (1.0 + strength * rng.uniform32(-1.0, 0.5)).max(0.0);
        let curve = |gain: f32| {
            std::array::from_fn(|v| (255.0 * gain * (v as f32 / 255.0).powf(gamma) + 0.5).clamp(0.0, 255.0) as u8)
        };
        Some(Self { saturation, curves: Box::new(tint.map(curve)) })
    }

    /// Changes the pixels that show the object. A grey one keeps the rendering's shading through `shade` (0 to 1 of each
    /// pixel, from its normal), since the colours that it came from are gone.
    pub(super) fn apply(&self, rendering: &mut RgbImage, foreground: &[u8], shade: impl Fn(usize) -> f32) {
        let plain = self.saturation == 0.0 && self.curves[0][0] == self.curves[0][255];
        let pixels = rendering.as_chunks_mut::<3>().0.iter_mut();
        for (i, (pixel, _)) in pixels.zip(foreground).enumerate().filter(|(_, (_, m))| **m != 0) {
            if plain {
                *pixel = [(f32::from(self.curves[0][0]) * shade(i)) as u8; 3];
                continue;
            }
            let [r, g, b] = pixel.map(f32::from);
            let grey = 0.299 * r + 0.587 * g + 0.114 * b;
            let mixed = [r, g, b].map(|c| (grey + self.saturation * (c - grey)).clamp(0.0, 255.0) as usize);
            *pixel = std::array::from_fn(|k| self.curves[k][mixed[k]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;
    use image::Rgb;

    #[test]
    fn only_the_object_changes_and_strength_varies() {
        let config = LookConfig { wrong_colours: 1.0, plain_reference: 0.0, ..LookConfig::default() };
        let mut changes = Vec::new();
        for index in 0..40 {
            let mut image = RgbImage::from_pixel(4, 1, Rgb([200, 100, 50]));
            let change = Recolour::draw(&mut stream(2, index), &config).unwrap();
            change.apply(&mut image, &[1, 1, 0, 0], |_| 1.0);
            assert_eq!(image.get_pixel(2, 0).0, [200, 100, 50]);
            assert_eq!(image.get_pixel(0, 0), image.get_pixel(1, 0));
            changes.push(image.get_pixel(0, 0)[0].abs_diff(200));
        }
        assert!(changes.iter().any(|c| *c < 12) && changes.iter().any(|c| *c > 40), "{changes:?}");
    }

    #[test]
    fn a_plain_reference_is_grey_and_shaded() {
        let config = LookConfig { plain_reference: 1.0, ..LookConfig::default() };
        let mut image = RgbImage::from_pixel(2, 1, Rgb([200, 10, 50]));
        let change = Recolour::draw(&mut stream(2, 1), &config).unwrap();
        change.apply(&mut image, &[1, 1], |i| if i == 0 { 1.0 } else { 0.6 });
        let [a, b] = [image.get_pixel(0, 0).0, image.get_pixel(1, 0).0];
        assert!(a[0] == a[1] && a[1] == a[2] && a[0] > b[0]);
        let off = LookConfig { plain_reference: 0.0, wrong_colours: 0.0, ..config };
        assert_eq!(Recolour::draw(&mut stream(2, 1), &off), None);
    }
}
