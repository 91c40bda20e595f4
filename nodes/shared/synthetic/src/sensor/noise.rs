//! Noise of the sensor and its colour filter array.

use super::LinearImage;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::LazyLock;

/// Side of the stored noise; a power of two.
const SIDE: usize = 256;

/// White and smooth normal noise of sigma 1, drawn once.
static STORED: LazyLock<[Vec<f32>; 2]> = LazyLock::new(|| {
    let mut rng = ChaCha8Rng::seed_from_u64(0x0015_e1f1);
    let white: Vec<f32> = (0..SIDE * SIDE).map(|_| pseudoflow_geometry::standard_normal(&mut rng) as f32).collect();
    let at = |x: usize, y: usize| white[y % SIDE * SIDE + x % SIDE];
    let kernel = [0.25_f32, 0.5, 0.25];
    let around = |i: usize| {
        let taps = (0..9).map(|t| (t % 3, t / 3));
        taps.map(|(dx, dy)| kernel[dx] * kernel[dy] * at(i % SIDE + dx, i / SIDE + dy)).sum::<f32>()
    };
    // The sum of squares of the kernel's weights is 0.375^2.
    let smooth = (0..SIDE * SIDE).map(|i| around(i) / 0.375).collect();
    [white, smooth]
});

/// The sum of two shifted copies of the stored noise: repeats of it are not seen.
pub(super) struct NoiseTile {
    stored: &'static [f32],
    first: [usize; 2],
    second: [usize; 2],
}

impl NoiseTile {
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        Self::of(&STORED[0], rng)
    }

    pub(super) fn draw_smooth(rng: &mut impl Rng) -> Self {
        Self::of(&STORED[1], rng)
    }

    fn of(stored: &'static [f32], rng: &mut impl Rng) -> Self {
        let mut place = || [rng.random::<u32>() as usize % SIDE, rng.random::<u32>() as usize % SIDE];
        Self { stored, first: place(), second: place() }
    }

    /// Normal with sigma 1.
    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        let of = |[x0, y0]: [usize; 2]| self.stored[((y + y0) % SIDE) * SIDE + (x + x0) % SIDE];
        (of(self.first) - of(self.second)) * std::f32::consts::FRAC_1_SQRT_2
    }
}

/// Keeps one channel of each pixel, as a colour filter array (red at `red` of each 2 x 2 cell, blue opposite), makes it noisy
/// and interpolates the rest bilinearly.
pub(super) fn through_mosaic(
    image: &mut LinearImage,
    red: [usize; 2],
    noisy: impl Fn(f32, f32) -> f32,
    rng: &mut impl Rng,
) {
    let tile = NoiseTile::draw(rng);
    let (width, height) = (image.width, image.height);
    let channel = |x: usize, y: usize| match ((x + red[0]) & 1, (y + red[1]) & 1) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    };
    // One pixel of border, mirrored so that the pattern goes on.
    let stride = width + 2;
    let mut raw = vec![0.0_f32; stride * (height + 2)];
    let inside = |i: usize, size: usize| match i {
        0 => 1.min(size - 1),
        i if i == size + 1 => size.saturating_sub(2),
        i => i - 1,
    };
    for y in 0..height + 2 {
        let v = inside(y, height);
        for x in 0..stride {
            let u = inside(x, width);
            raw[y * stride + x] = noisy(image.data[3 * (v * width + u) + channel(u, v)], tile.at(u, v));
        }
    }
    for y in 0..height {
        let rows: [&[f32]; 3] = std::array::from_fn(|i| &raw[(y + i) * stride..][..stride]);
        let line = &mut image.data[3 * y * width..][..3 * width];
        for (x, pixel) in line.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let here = rows[1][x + 1];
            let beside = 0.5 * (rows[1][x] + rows[1][x + 2]);
            let along = 0.5 * (rows[0][x + 1] + rows[2][x + 1]);
            let cross = 0.5 * (beside + along);
            let corners = 0.25 * (rows[0][x] + rows[0][x + 2] + rows[2][x] + rows[2][x + 2]);
            *pixel = match ((x + red[0]) & 1, (y + red[1]) & 1) {
                (0, 0) => [here, cross, corners],
                (1, 1) => [corners, cross, here],
                (1, 0) => [beside, here, along],
                _ => [along, here, beside],
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_sigma_one_and_no_mean() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for tile in [NoiseTile::draw(&mut rng), NoiseTile::draw_smooth(&mut rng)] {
            let values: Vec<f32> = (0..128 * 128).map(|i| tile.at(i % 128, i / 128)).collect();
            let mean = values.iter().sum::<f32>() / values.len() as f32;
            let sigma = (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt();
            assert!(mean.abs() < 0.05 && (sigma - 1.0).abs() < 0.05, "{mean} {sigma}");
        }
    }

    #[test]
    fn a_mosaic_keeps_colours_and_ramps() {
        for red in [[0, 0], [0, 1], [1, 0], [1, 1]] {
            let mut image = LinearImage::new(16, 12);
            let value = |x: usize, y: usize, k: usize| 0.1 + 0.02 * x as f32 + 0.01 * y as f32 + 0.2 * k as f32;
            for (i, pixel) in image.data.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *pixel = std::array::from_fn(|k| value(i % 16, i / 16, k));
            }
            through_mosaic(&mut image, red, |c, _| c, &mut ChaCha8Rng::seed_from_u64(1));
            for (x, y) in (1..15).flat_map(|x| (1..11).map(move |y| (x, y))) {
                for k in 0..3 {
                    let found = image.data[3 * (y * 16 + x) + k];
                    assert!((found - value(x, y, k)).abs() < 1e-5, "{red:?} {x} {y} {k}: {found}");
                }
            }
        }
    }
}
