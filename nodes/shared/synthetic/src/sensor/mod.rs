//! From light on the sensor to the image that a camera delivers: exposure, lens, motion, colour filter array, noise, white
//! balance, tone curve, sharpening and JPEG. All at the camera's own resolution, before the crop is resampled.

mod filter;
mod jpeg;
mod noise;

pub(super) use filter::LinearImage;
pub(super) use jpeg::Jpeg;

use super::config::CameraConfig;
use super::light::luminance;
use super::random::Draw;
use noise::NoiseTile;
use pseudoflow_imaging::RgbImage;
use rand::Rng;

/// A camera with its settings.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sensor {
    /// Mean luminance after exposure.
    exposure: f32,
    /// Standard deviation of the lens blur, pixels.
    blur_px: f32,
    /// Radius of the disc of a lens out of focus, pixels; 0 for none.
    defocus_px: f32,
    /// Motion during the exposure, pixels.
    motion_px: [f32; 2],
    /// Place of the red pixel in each 2 x 2 cell of the colour filter array; `None` for three full channels.
    mosaic: Option<[usize; 2]>,
    white_balance: [f32; 3],
    saturation: f32,
    /// Noise: sigma^2 = read^2 + shot x signal.
    read_noise: f32,
    shot_noise: f32,
    /// Share of the noise that is smooth, where there is no colour filter array to smooth it.
    smooth_noise: f32,
    gamma: f32,
    contrast: f32,
    lift: f32,
    /// 0: the display curve clips; 1: highlights are compressed.
    shoulder: f32,
    sharpen: f32,
    sharpen_px: f32,
    jpeg: Option<Jpeg>,
}

impl Sensor {
    /// Half of the cameras are good ones with mild settings.
    pub(super) fn draw(rng: &mut impl Rng, config: &CameraConfig) -> Self {
        let wild = if rng.chance(0.5) { 0.4 } else { 1.0 };
        let blur_px = if rng.chance(0.7) { rng.uniform32(0.25, 0.8) } else { rng.uniform32(0.6, 1.4) };
        let defocus_px = if rng.chance(config.defocus) { rng.uniform32(0.8, 1.0 + 2.5 * wild) } else { 0.0 };
        let motion = if rng.chance(config.motion_blur) { wild * rng.uniform32(0.7, 7.0) } else { 0.0 };
        let angle = rng.uniform32(0.0, std::f32::consts::TAU);
        let varied = wild * config.colour as f32;
        let cast = varied * rng.uniform32(-0.2, 0.2);
        let noise = config.noise as f32 * rng.log_uniform32(0.002, 0.006 + 0.04 * wild);
        let around_one = |rng: &mut _, spread: f32| (varied * Draw::uniform32(rng, -spread, spread)).exp();
        let stops = config.exposure_stops as f32 * rng.normal32().clamp(-2.2, 2.2);
        Self {
            exposure: 0.15 * stops.exp2(),
            blur_px,
            defocus_px,
            motion_px: [motion * angle.cos(), motion * angle.sin()],
            mosaic: rng.chance(config.bayer).then(|| [rng.below(2), rng.below(2)]),
            white_balance: [1.0 + cast, 1.0 + varied * rng.uniform32(-0.05, 0.05), 1.0 - cast],
            saturation: 1.2 * around_one(rng, 0.4),
            read_noise: 0.3 * noise,
            shot_noise: noise * noise,
            smooth_noise: rng.random(),
            gamma: around_one(rng, 0.2),
            contrast: 1.1 * around_one(rng, 0.25),
            lift: if rng.chance(0.3) { varied * rng.uniform32(0.0, 0.1) } else { 0.0 },
            shoulder: if rng.chance(0.5) { rng.random() } else { 0.0 },
            sharpen: if rng.chance(config.sharpening) { rng.uniform32(0.2, 1.4) } else { 0.0 },
            sharpen_px: rng.uniform32(0.6, 1.3),
            jpeg: rng
                .chance(config.jpeg)
                .then(|| Jpeg { quality: rng.uniform(55.0, 98.0) as u8, subsampled: rng.chance(0.7) }),
        }
    }

    /// The camera when its images are scaled by `factor` (at most 1): blur, motion and noise shrink with them, and the
    /// mean of several pixels of a mosaic has three full channels.
    pub(super) fn scaled(self, factor: f32) -> Self {
        if factor > 0.999 {
            return self;
        }
        Self {
            blur_px: factor * self.blur_px,
            defocus_px: factor * self.defocus_px,
            motion_px: self.motion_px.map(|v| factor * v),
            read_noise: factor * self.read_noise,
            shot_noise: factor * factor * self.shot_noise,
            mosaic: self.mosaic.filter(|_| factor > 0.75),
            ..self
        }
    }

    /// The camera's image of a scene, whose mean light is `mean`.
    pub(super) fn expose(&self, scene: &LinearImage, mean: f32, rng: &mut impl Rng) -> RgbImage {
        let mut image = scene.clone();
        let gain = self.exposure / mean.max(1e-3);
        image.data.iter_mut().for_each(|c| *c *= gain);
        image.blur(self.blur_px);
        if self.defocus_px > 0.3 {
            image.defocus(self.defocus_px);
        }
        image.smear(self.motion_px);
        match self.mosaic {
            Some(red) => noise::through_mosaic(&mut image, red, |c, n| self.noisy(c, n), rng),
            None => self.add_noise(&mut image, rng),
        }
        self.develop(&mut image);
        if self.sharpen > 0.0 {
            image.sharpen(self.sharpen, self.sharpen_px);
            image.data.iter_mut().for_each(|c| *c = c.clamp(0.0, 1.0));
        }
        if let Some(jpeg) = self.jpeg {
            jpeg.pass(&mut image);
        }
        let bytes = image.data.iter().map(|c| (c * 255.0 + 0.5).clamp(0.0, 255.0) as u8).collect();
        RgbImage::from_raw(image.width as u32, image.height as u32, bytes).unwrap_or_default()
    }

    fn noisy(&self, light: f32, normal: f32) -> f32 {
        light + (self.read_noise * self.read_noise + self.shot_noise * light.max(0.0)).sqrt() * normal
    }

    fn add_noise(&self, image: &mut LinearImage, rng: &mut impl Rng) {
        let (fine, soft) = (NoiseTile::draw(rng), NoiseTile::draw_smooth(rng));
        let (a, b) = ((1.0 - self.smooth_noise).sqrt(), self.smooth_noise.sqrt());
        let stride = 3 * image.width;
        for (y, row) in image.data.chunks_exact_mut(stride).enumerate() {
            let normal = |i: usize| a * fine.at(i, y) + b * soft.at(i % 3 * 85 + i / 3, y);
            row.iter_mut().enumerate().for_each(|(i, c)| *c = self.noisy(*c, normal(i)));
        }
    }

    /// Linear light to display values.
    fn develop(&self, image: &mut LinearImage) {
        let curve = self.curve();
        for pixel in image.data.as_chunks_mut::<3>().0 {
            let balanced: [f32; 3] = std::array::from_fn(|k| (pixel[k] * self.white_balance[k]).max(0.0));
            let grey = luminance(balanced);
            *pixel = balanced.map(|c| {
                let c = (grey + self.saturation * (c - grey)).clamp(0.0, LAST_LIGHT);
                // The curve is steep near black: its table is even in the square root.
                let at = c.sqrt() * ((CURVE - 1) as f32 / LAST_LIGHT.sqrt());
                let low = (at as usize).min(CURVE - 2);
                curve[low] + (at - low as f32) * (curve[low + 1] - curve[low])
            });
        }
    }

    /// The display value of light from 0 to [`LAST_LIGHT`], even in its square root.
    fn curve(&self) -> [f32; CURVE] {
        std::array::from_fn(|i| {
            let c = LAST_LIGHT * (i as f32 / (CURVE - 1) as f32).powi(2);
            let compressed = 1.5 * c / (c + 0.5 + 0.5 * c.min(1.0));
            let c = (c + self.shoulder * (compressed - c)).clamp(0.0, 1.0);
            let display = c.powf(self.gamma / 2.2);
            let curved = 0.5 + self.contrast * (display - 0.5);
            self.lift + (1.0 - self.lift) * curved.clamp(0.0, 1.0)
        })
    }
}

/// Entries of the tone curve.
const CURVE: usize = 256;
/// Light beyond which the tone curve is flat.
const LAST_LIGHT: f32 = 4.0;

/// Mean luminance of an image.
pub(super) fn mean_light(image: &LinearImage) -> f32 {
    image.pixels().iter().map(|p| luminance(*p)).sum::<f32>() / image.pixels().len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;

    #[test]
    fn a_camera_delivers_an_image_of_the_scene() {
        let mut scene = LinearImage::new(24, 17);
        scene.data.iter_mut().enumerate().for_each(|(i, c)| *c = (i * 37 % 101) as f32 / 100.0);
        for index in 0..40 {
            let mut rng = stream(9, index);
            let sensor = Sensor::draw(&mut rng, &CameraConfig::default());
            let image = sensor.expose(&scene, mean_light(&scene), &mut rng);
            assert_eq!(image.dimensions(), (24, 17));
            let (low, high) = image.as_raw().iter().fold((255, 0), |(l, h), v| (l.min(*v), h.max(*v)));
            assert!(low < high);
        }
    }

    #[test]
    fn the_tone_curve_rises_from_black_to_white() {
        for index in 0..20 {
            let curve = Sensor::draw(&mut stream(3, index), &CameraConfig::default()).curve();
            assert!(curve.windows(2).all(|w| w[0] <= w[1] + 1e-6));
            assert!(curve[0] < 0.2 && curve[CURVE - 1] > 0.8, "{} {}", curve[0], curve[CURVE - 1]);
        }
    }

    #[test]
    fn an_ideal_camera_keeps_a_ramp_in_place() {
        let config = CameraConfig::ideal();
        let mut scene = LinearImage::new(32, 32);
        for (i, pixel) in scene.data.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *pixel = [(i % 32) as f32 / 31.0; 3];
        }
        let mut rng = stream(4, 4);
        let image = Sensor::draw(&mut rng, &config).expose(&scene, mean_light(&scene), &mut rng);
        let row: Vec<u8> = (0..32).map(|x| image.get_pixel(x, 16)[1]).collect();
        assert!(row.windows(2).all(|w| w[0] <= w[1] + 2), "{row:?}");
    }
}
