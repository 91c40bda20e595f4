//! Colours of the reference that are not those of the real object, as those of scanned and painted meshes are not.

use super::config::LookConfig;
use super::random::Draw;
use pseudoflow_imaging::RgbImage;
use pseudoflow_imaging::raster::{Headlight, Shader, Surface};
use rand::Rng;

/// A change of the colours of a reference.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Recolour {
    /// Of one grey (0 to 1), as a mesh without colours: to be rendered with [`Plain`].
    Plain(f32),
    /// Other colours.
    Changed(Change),
}

/// Other gain, gamma, tint and saturation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Change {
    saturation: f32,
    /// New value of each byte, for each channel.
    curves: Box<[[u8; 256]; 3]>,
}

/// The shading of a reference on one grey.
pub(super) struct Plain(pub(super) f32);

impl Shader for Plain {
    fn shade(&self, surface: &Surface) -> [f32; 3] {
        Headlight::default().shade(&Surface { albedo: [self.0; 3], ..*surface })
    }
}

impl Recolour {
    /// `None` for the colours as they are. Strong changes are rarer than weak ones.
    pub(super) fn draw(rng: &mut impl Rng, config: &LookConfig) -> Option<Self> {
        if rng.chance(config.plain_reference) {
            return Some(Self::Plain(rng.uniform32(0.35, 0.9)));
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
        Some(Self::Changed(Change { saturation, curves: Box::new(tint.map(curve)) }))
    }
}

impl Change {
    /// Changes the pixels that show the object.
    pub(super) fn apply(&self, rendering: &mut RgbImage, foreground: &[u8]) {
        let pixels = rendering.as_chunks_mut::<3>().0.iter_mut();
        for (pixel, _) in pixels.zip(foreground).filter(|(_, m)| **m != 0) {
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
            let Some(Recolour::Changed(change)) = Recolour::draw(&mut stream(2, index), &config) else { panic!() };
            change.apply(&mut image, &[1, 1, 0, 0]);
            assert_eq!(image.get_pixel(2, 0).0, [200, 100, 50]);
            assert_eq!(image.get_pixel(0, 0), image.get_pixel(1, 0));
            changes.push(image.get_pixel(0, 0)[0].abs_diff(200));
        }
        assert!(changes.iter().any(|c| *c < 12) && changes.iter().any(|c| *c > 40), "{changes:?}");
    }

    #[test]
    fn shares_are_kept() {
        let plain = LookConfig { plain_reference: 1.0, ..LookConfig::default() };
        assert!(matches!(Recolour::draw(&mut stream(2, 1), &plain), Some(Recolour::Plain(_))));
        let off = LookConfig { plain_reference: 0.0, wrong_colours: 0.0, ..plain };
        assert_eq!(Recolour::draw(&mut stream(2, 1), &off), None);
        let usual = LookConfig::default();
        let changed = (0..400).filter(|i| Recolour::draw(&mut stream(3, *i), &usual).is_some()).count();
        assert!((180..240).contains(&changed), "{changed} of 400");
    }
}
