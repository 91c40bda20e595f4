//! From light on the sensor to the image that a camera delivers: exposure, lens blur, motion, noise, white balance,
//! tone curve, sharpening and JPEG. All at the camera's own resolution, before the crop is resampled.

use super::light::luminance;
use super::random::Draw;
use pseudoflow_imaging::{ImagingError, RgbImage, decode_rgb, encode_jpeg};
use rand::Rng;

/// An image in linear light.
#[derive(Debug, Clone)]
pub(super) struct LinearImage {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pixels: Vec<[f32; 3]>,
}

/// A camera with its settings.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sensor {
    /// Mean luminance after exposure.
    exposure: f32,
    /// Standard deviation of the lens blur, pixels.
    blur_px: f32,
    /// Motion during the exposure, pixels.
    motion_px: [f32; 2],
    white_balance: [f32; 3],
    saturation: f32,
    /// Noise: sigma^2 = read^2 + shot x signal.
    read_noise: f32,
    shot_noise: f32,
    /// The noise of neighbouring pixels is alike after demosaicing.
    noise_blur_px: f32,
    gamma: f32,
    contrast: f32,
    lift: f32,
    /// 0: the display curve clips; 1: highlights are compressed.
    shoulder: f32,
    sharpen: f32,
    jpeg_quality: u8,
}

impl Sensor {
    /// Half of the cameras are good ones with mild settings.
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        let wild = if rng.chance(0.5) { 0.4 } else { 1.0 };
        let blur_px = match rng.random::<f32>() {
            t if t < 0.65 => rng.uniform32(0.25, 0.8),
            t if t < 0.93 || wild < 1.0 => rng.uniform32(0.6, 1.3),
            _ => rng.uniform32(1.3, 2.6),
        };
        let motion = if rng.chance(0.15) { wild * rng.uniform32(0.5, 5.0) } else { 0.0 };
        let angle = rng.uniform32(0.0, std::f32::consts::TAU);
        let cast = wild * rng.uniform32(-0.2, 0.2);
        let noise = rng.log_uniform32(0.001, 0.03 * wild);
        let around_one = |rng: &mut _, spread: f32| (wild * Draw::uniform32(rng, -spread, spread)).exp();
        Self {
            exposure: 0.22 * around_one(rng, 0.75),
            blur_px,
            motion_px: [motion * angle.cos(), motion * angle.sin()],
            white_balance: [1.0 + cast, 1.0 + wild * rng.uniform32(-0.05, 0.05), 1.0 - cast],
            saturation: 0.92 * around_one(rng, 0.35),
            read_noise: 0.3 * noise,
            shot_noise: noise * noise,
            noise_blur_px: rng.uniform32(0.0, 0.9),
            gamma: around_one(rng, 0.18),
            contrast: around_one(rng, 0.28),
            lift: if rng.chance(0.5) { wild * rng.uniform32(0.0, 0.12) } else { 0.0 },
            shoulder: if rng.chance(0.5) { rng.random() } else { 0.0 },
            sharpen: if rng.chance(0.35) { rng.uniform32(0.2, 1.2) } else { 0.0 },
            jpeg_quality: rng.uniform(60.0, 99.0) as u8,
        }
    }

    /// The camera when its images are scaled by `factor` (at most 1): blur, motion and noise shrink with them.
    pub(super) fn scaled(self, factor: f32) -> Self {
        Self {
            blur_px: factor * self.blur_px,
            motion_px: self.motion_px.map(|v| factor * v),
            read_noise: factor * self.read_noise,
            shot_noise: factor * factor * self.shot_noise,
            ..self
        }
    }

    /// The camera's image of a scene.
    pub(super) fn expose(&self, scene: &LinearImage, rng: &mut impl Rng) -> Result<RgbImage, ImagingError> {
        let mut image = scene.clone();
        let mean = image.pixels.iter().map(|p| luminance(*p)).sum::<f32>() / image.pixels.len().max(1) as f32;
        let gain = self.exposure / mean.max(1e-3);
        image.pixels.iter_mut().for_each(|p| *p = p.map(|c| c * gain));
        image.blur(self.blur_px);
        image.smear(self.motion_px);
        self.add_noise(&mut image, rng);
        image.pixels.iter_mut().for_each(|p| *p = self.develop(*p));
        if self.sharpen > 0.0 {
            image.sharpen(self.sharpen);
        }
        let bytes = image.pixels.iter().flat_map(|p| p.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)).collect();
        let raw = RgbImage::from_raw(image.width as u32, image.height as u32, bytes).unwrap_or_default();
        decode_rgb(&encode_jpeg(&raw, self.jpeg_quality)?, "(synthetic camera)")
    }

    fn add_noise(&self, image: &mut LinearImage, rng: &mut impl Rng) {
        let mut noise = LinearImage { width: image.width, height: image.height, pixels: Vec::new() };
        noise.pixels = (0..image.pixels.len()).map(|_| std::array::from_fn(|_| quick_normal(rng))).collect();
        noise.blur(self.noise_blur_px);
        for (pixel, noise) in image.pixels.iter_mut().zip(&noise.pixels) {
            for k in 0..3 {
                let sigma = (self.read_noise.powi(2) + self.shot_noise * pixel[k].max(0.0)).sqrt();
                pixel[k] += sigma * noise[k];
            }
        }
    }

    /// Linear light to a display value.
    fn develop(&self, pixel: [f32; 3]) -> [f32; 3] {
        let balanced: [f32; 3] = std::array::from_fn(|k| (pixel[k] * self.white_balance[k]).max(0.0));
        let grey = luminance(balanced);
        balanced.map(|c| {
            let c = (grey + self.saturation * (c - grey)).max(0.0);
            let compressed = 1.5 * c / (c + 0.5 + 0.5 * c.min(1.0));
            let c = (c + self.shoulder * (compressed - c)).clamp(0.0, 1.0);
            let display = c.powf(self.gamma / 2.2);
            let curved = 0.5 + self.contrast * (display - 0.5);
            self.lift + (1.0 - self.lift) * curved.clamp(0.0, 1.0)
        })
    }
}

/// Near normal with sigma 1: the sum of four bytes.
fn quick_normal(rng: &mut impl Rng) -> f32 {
    let sum: u32 = rng.random::<u32>().to_le_bytes().iter().map(|b| u32::from(*b)).sum();
    (sum as f32 - 510.0) / 147.8
}

impl LinearImage {
    /// Gaussian blur, borders repeated.
    fn blur(&mut self, sigma_px: f32) {
        if sigma_px < 0.2 {
            return;
        }
        let radius = (2.5 * sigma_px).ceil() as i32;
        let weights: Vec<f32> = (-radius..=radius).map(|i| (-0.5 * (i as f32 / sigma_px).powi(2)).exp()).collect();
        let total: f32 = weights.iter().sum();
        let taps: Vec<(i32, f32)> = (-radius..=radius).zip(weights.iter().map(|w| w / total)).collect();
        self.filter(&taps.iter().map(|&(i, w)| (i, 0, w)).collect::<Vec<_>>());
        self.filter(&taps.iter().map(|&(i, w)| (0, i, w)).collect::<Vec<_>>());
    }

    /// The mean over a straight path.
    fn smear(&mut self, [dx, dy]: [f32; 2]) {
        let count = dx.hypot(dy).ceil() as i32;
        if count < 1 {
            return;
        }
        let place = |i: i32, d: f32| (d * (i as f32 / count as f32 - 0.5)).round() as i32;
        let taps: Vec<_> = (0..=count).map(|i| (place(i, dx), place(i, dy), 1.0 / (count + 1) as f32)).collect();
        self.filter(&taps);
    }

    fn sharpen(&mut self, amount: f32) {
        let sharp = self.pixels.clone();
        self.blur(1.0);
        for (soft, sharp) in self.pixels.iter_mut().zip(&sharp) {
            *soft = std::array::from_fn(|k| sharp[k] + amount * (sharp[k] - soft[k]));
        }
    }

    /// Weighted sum of shifted copies, row by row; borders repeated.
    fn filter(&mut self, taps: &[(i32, i32, f32)]) {
        let (width, height) = (self.width as i32, self.height as i32);
        let mut out = vec![[0.0_f32; 3]; self.pixels.len()];
        for (y, row) in out.chunks_exact_mut(self.width).enumerate() {
            for &(dx, dy, weight) in taps {
                let source = &self.pixels[(y as i32 + dy).clamp(0, height - 1) as usize * self.width..][..self.width];
                let (from, to) = ((-dx).clamp(0, width) as usize, (width - dx).clamp(0, width) as usize);
                let edge = |x: usize| source[(x as i32 + dx).clamp(0, width - 1) as usize];
                (0..from.min(row.len())).chain(to.max(from)..row.len()).for_each(|x| add(&mut row[x], edge(x), weight));
                if from < to {
                    let shifted = &source[(from as i32 + dx) as usize..(to as i32 + dx) as usize];
                    row[from..to].iter_mut().zip(shifted).for_each(|(sum, value)| add(sum, *value, weight));
                }
            }
        }
        self.pixels = out;
    }
}

fn add(sum: &mut [f32; 3], value: [f32; 3], weight: f32) {
    (0..3).for_each(|k| sum[k] += weight * value[k]);
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;

    fn noise_image() -> LinearImage {
        let mut rng = stream(1, 1);
        let pixels = (0..24 * 17).map(|_| std::array::from_fn(|_| rng.random())).collect();
        LinearImage { width: 24, height: 17, pixels }
    }

    #[test]
    fn filters_keep_a_constant_image() {
        let mut image = noise_image();
        image.pixels.fill([0.25; 3]);
        image.blur(2.3);
        image.smear([6.2, -3.0]);
        image.smear([200.0, 0.0]);
        assert!(image.pixels.iter().flatten().all(|c| (c - 0.25).abs() < 1e-5));
    }

    #[test]
    fn motion_has_no_net_shift() {
        let mut image = noise_image();
        image.pixels.fill([0.0; 3]);
        image.pixels[8 * 24 + 12] = [1.0; 3];
        image.smear([6.0, 0.0]);
        let mean: f32 = (0..24).map(|x| x as f32 * image.pixels[8 * 24 + x][0]).sum();
        assert!((mean - 12.0).abs() < 0.26, "{mean}");
    }

    #[test]
    fn a_camera_delivers_an_image_of_the_scene() {
        for index in 0..20 {
            let mut rng = stream(9, index);
            let sensor = Sensor::draw(&mut rng);
            let image = sensor.expose(&noise_image(), &mut rng).unwrap();
            assert_eq!(image.dimensions(), (24, 17));
            let (low, high) = image.as_raw().iter().fold((255, 0), |(l, h), v| (l.min(*v), h.max(*v)));
            assert!(low < high);
        }
    }
}
