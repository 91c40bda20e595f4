//! Colour changes of the crop that the student sees (docs/method.md, "Student augmentation"): colour only, so that the
//! teacher's flow stays its label. Blur and noise are the paper's for a crop of 256 px; a smaller one has them as if it had
//! been made smaller afterwards.

use pseudoflow_geometry::standard_normal;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Width and height of the paper's crops.
const PAPER_PX: usize = 256;

/// One drawn change.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Change {
    hue: f32,
    saturation: f32,
    value: f32,
    noise: f32,
    /// Half of the blur's side, without its centre.
    reach_px: usize,
}

impl Change {
    /// For a crop of this size.
    fn draw(size_px: usize, rng: &mut ChaCha8Rng) -> Self {
        let scale = (size_px as f32 / PAPER_PX as f32).min(1.0);
        Self {
            hue: rng.random_range(0.8..1.2),
            saturation: rng.random_range(0.5..1.5),
            value: rng.random_range(0.5..1.5),
            noise: scale * rng.random_range(0.0..0.1),
            reach_px: (scale * rng.random_range(0..3) as f32).round() as usize,
        }
    }
}

/// An RGB image `S x S x 3` as planes `3 x S x S` in [-1, 1].
pub(super) fn planes(rgb: &[u8]) -> Vec<f32> {
    let channel = |c: usize| rgb.iter().skip(c).step_by(3).map(|v| f32::from(*v) / 127.5 - 1.0);
    (0..3).flat_map(channel).collect()
}

/// Grey values 0..255 of an RGB image (Rec. 601).
pub(super) fn grey(rgb: &[u8]) -> Vec<f32> {
    let luminance = |p: &[u8]| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]);
    rgb.chunks_exact(3).map(luminance).collect()
}

/// The image as the student sees it: changed in hue, saturation and value, blurred, with noise; planes in [-1, 1].
pub(super) fn augmented(rgb: &[u8], size_px: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let change = Change::draw(size_px, rng);
    let area = size_px * size_px;
    let mut out = vec![0.0; 3 * area];
    for (pixel, colour) in rgb.chunks_exact(3).enumerate() {
        let [h, s, v] = hsv([colour[0], colour[1], colour[2]].map(|c| f32::from(c) / 255.0));
        let hue = (h * change.hue).rem_euclid(1.0);
        let changed = [hue, (s * change.saturation).min(1.0), (v * change.value).min(1.0)];
        for (channel, value) in rgb_of(changed).into_iter().enumerate() {
            out[channel * area + pixel] = value;
        }
    }
    out.chunks_exact_mut(area).for_each(|plane| blur(plane, size_px, change.reach_px));
    for value in &mut out {
        let noisy = *value + change.noise * standard_normal(rng) as f32;
        *value = 2.0 * noisy.clamp(0.0, 1.0) - 1.0;
    }
    out
}

/// Hue, saturation, value in 0..1.
fn hsv([r, g, b]: [f32; 3]) -> [f32; 3] {
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let span = high - low;
    if span <= 0.0 {
        return [0.0, 0.0, high];
    }
    let sixth = if high == r {
        ((g - b) / span).rem_euclid(6.0)
    } else if high == g {
        (b - r) / span + 2.0
    } else {
        (r - g) / span + 4.0
    };
    [sixth / 6.0, span / high, high]
}

fn rgb_of([h, s, v]: [f32; 3]) -> [f32; 3] {
    let channel = |n: f32| {
        let k = (n + 6.0 * h).rem_euclid(6.0);
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// A box of `reach` pixels around each, the image continued at its border.
fn blur(plane: &mut [f32], size_px: usize, reach: usize) {
    if reach == 0 {
        return;
    }
    let side_px = 2 * reach + 1;
    let mut line = vec![0.0; size_px];
    for (stride, other) in [(1, size_px), (size_px, 1)] {
        for start in (0..size_px).map(|i| i * other) {
            line.iter_mut().enumerate().for_each(|(i, v)| *v = plane[start + i * stride]);
            for i in 0..size_px {
                let window = (i + size_px - reach..=i + size_px + reach)
                    .map(|j| line[j.clamp(size_px, 2 * size_px - 1) - size_px]);
                plane[start + i * stride] = window.sum::<f32>() / side_px as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn colours_go_there_and_back() {
        for colour in [[0.1, 0.6, 0.9], [0.9, 0.2, 0.1], [0.3, 0.8, 0.2], [0.5, 0.5, 0.5], [0.0; 3], [1.0, 1.0, 0.0]] {
            let back = rgb_of(hsv(colour));
            assert!(back.iter().zip(colour).all(|(a, b)| (a - b).abs() < 1e-5), "{colour:?} {back:?}");
        }
    }

    #[test]
    fn a_blur_keeps_a_constant_and_spreads_a_point() {
        let mut constant = vec![0.25; 49];
        blur(&mut constant, 7, 2);
        assert!(constant.iter().all(|v| (v - 0.25).abs() < 1e-6));
        let mut point = vec![0.0; 49];
        point[24] = 9.0;
        blur(&mut point, 7, 1);
        let ones: Vec<usize> = (0..49).filter(|i| (point[*i] - 1.0).abs() < 1e-5).collect();
        assert_eq!(ones, [16, 17, 18, 23, 24, 25, 30, 31, 32]);
        assert!((point.iter().sum::<f32>() - 9.0).abs() < 1e-4);
    }

    #[test]
    fn small_crops_are_blurred_less() {
        let reaches = |size_px| -> Vec<usize> {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            (0..60).map(|_| Change::draw(size_px, &mut rng).reach_px).collect()
        };
        let (paper, half) = (reaches(256), reaches(128));
        assert!((0..3).all(|reach| paper.contains(&reach)));
        // 1, 3 and 5 pixels of 256 are half as many of 128, whole pixels on either side.
        assert!(paper.iter().zip(half).all(|(paper, half)| half == paper.div_ceil(2)));
        assert_eq!(paper, reaches(512), "the paper's are the strongest");
    }

    #[test]
    fn changes_are_colour_only_seeded_and_within_range() {
        let rgb: Vec<u8> = (0..32 * 32 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let draw = |seed| augmented(&rgb, 32, &mut ChaCha8Rng::seed_from_u64(seed));
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        assert!(draw(3).iter().all(|v| (-1.0..=1.0).contains(v)));
        // A bright square stays where it is.
        let mut rgb = vec![20; 32 * 32 * 3];
        for p in (0..32 * 32).filter(|p| (8..16).contains(&(p % 32)) && (20..28).contains(&(p / 32))) {
            rgb[3 * p..3 * p + 3].fill(230);
        }
        let centre = |planes: &[f32]| {
            let red = &planes[..32 * 32];
            let (low, high) = red.iter().fold((1.0_f32, -1.0_f32), |(low, high), v| (low.min(*v), high.max(*v)));
            let (mut x, mut y, mut sum) = (0.0, 0.0, 0.0);
            for (p, _) in red.iter().enumerate().filter(|(_, v)| **v > 0.5 * (low + high)) {
                (x, y, sum) = (x + (p % 32) as f32, y + (p / 32) as f32, sum + 1.0);
            }
            (x / sum, y / sum)
        };
        for seed in 0..10 {
            let (x, y) = centre(&augmented(&rgb, 32, &mut ChaCha8Rng::seed_from_u64(seed)));
            assert!((x - 11.5).abs() < 0.6 && (y - 23.5).abs() < 0.6, "{seed}: {x} {y}");
        }
    }
}
