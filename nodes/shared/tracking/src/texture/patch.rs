//! One patch of a keyframe found again in a frame.

use super::pyramid::{Level, Pyramid, in_level};
use nalgebra::{Matrix2, Vector2};

/// Pixels from the middle of a patch to its rim.
const HALF: i32 = 4;
const SIDE: usize = (2 * HALF + 1) as usize;
const COUNT: usize = SIDE * SIDE;
/// Samples of the template with a rim for its gradient.
const RIM: usize = SIDE + 2;
const STEPS: usize = 8;
/// Steps shorter than this end a level, pixels.
const STILL: f32 = 0.03;

/// A patch brought to the shape that it should have in the frame.
struct Template {
    /// Brightness less its mean.
    values: [f32; COUNT],
    gradient: [[f32; 2]; COUNT],
    /// Inverse of the sum of gradient products.
    inverse: Matrix2<f32>,
    length: f32,
}

/// Where a patch was found, and how alike it is (correlation, -1 to 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Found {
    pub(crate) at: [f32; 2],
    pub(crate) likeness: f32,
}

/// Looks for a patch. `key_from_here` maps offsets in the frame to offsets in the keyframe; `most_px` bounds the shift.
pub(crate) fn find(
    key: &Pyramid,
    place: [f32; 2],
    here: &Pyramid,
    expected: [f32; 2],
    key_from_here: &Matrix2<f32>,
    levels: usize,
    most_px: f32,
) -> Option<Found> {
    let mut at = expected;
    let mut likeness = 0.0;
    for l in (0..levels).rev() {
        let template = Template::new(&key.levels[l], in_level(place, l), key_from_here)?;
        let scale = (1_u32 << l) as f32;
        let start = in_level(at, l);
        let (found, alike) = template.slide(&here.levels[l], start)?;
        at = [0, 1].map(|k| at[k] + scale * (found[k] - start[k]));
        likeness = alike;
        if (at[0] - expected[0]).hypot(at[1] - expected[1]) > most_px {
            return None;
        }
    }
    Some(Found { at, likeness })
}

impl Template {
    fn new(level: &Level, at: [f32; 2], key_from_here: &Matrix2<f32>) -> Option<Self> {
        let m = key_from_here;
        let mut rim = [[0.0_f32; RIM]; RIM];
        for (j, row) in rim.iter_mut().enumerate() {
            let dy = j as f32 - (HALF + 1) as f32;
            for (i, value) in row.iter_mut().enumerate() {
                let dx = i as f32 - (HALF + 1) as f32;
                *value =
                    level.sample(at[0] + m[(0, 0)] * dx + m[(0, 1)] * dy, at[1] + m[(1, 0)] * dx + m[(1, 1)] * dy)?;
            }
        }
        let (mut values, mut gradient) = ([0.0; COUNT], [[0.0; 2]; COUNT]);
        let mut hessian = Matrix2::zeros();
        for k in 0..COUNT {
            let (i, j) = (k % SIDE + 1, k / SIDE + 1);
            values[k] = rim[j][i];
            let g = [0.5 * (rim[j][i + 1] - rim[j][i - 1]), 0.5 * (rim[j + 1][i] - rim[j - 1][i])];
            gradient[k] = g;
            hessian += Matrix2::new(g[0] * g[0], g[0] * g[1], g[0] * g[1], g[1] * g[1]);
        }
        let mean = values.iter().sum::<f32>() / COUNT as f32;
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        Some(Self { values, gradient, inverse: hessian.try_inverse()?, length: length.max(1e-3) })
    }

    /// The place near `start` that looks most like it.
    fn slide(&self, level: &Level, start: [f32; 2]) -> Option<([f32; 2], f32)> {
        let mut at = start;
        let mut likeness = 0.0;
        for _ in 0..STEPS {
            let mut seen = [0.0_f32; COUNT];
            for (k, value) in seen.iter_mut().enumerate() {
                let (dx, dy) = ((k % SIDE) as f32 - HALF as f32, (k / SIDE) as f32 - HALF as f32);
                *value = level.sample(at[0] + dx, at[1] + dy)?;
            }
            let mean = seen.iter().sum::<f32>() / COUNT as f32;
            let length = seen.iter().map(|v| (v - mean).powi(2)).sum::<f32>().sqrt().max(1e-3);
            let gain = length / self.length;
            likeness = seen.iter().zip(&self.values).map(|(s, t)| (s - mean) * t).sum::<f32>() / (length * self.length);
            let mut pull = Vector2::zeros();
            for k in 0..COUNT {
                let r = (seen[k] - mean) / gain - self.values[k];
                pull += Vector2::new(self.gradient[k][0] * r, self.gradient[k][1] * r);
            }
            let step = self.inverse * pull;
            at = [at[0] - step.x, at[1] - step.y];
            if step.norm() < STILL {
                break;
            }
        }
        at.iter().all(|v| v.is_finite()).then_some((at, likeness))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::RgbImage;

    /// Smooth blobs, shifted, brighter and with more contrast.
    fn picture(shift: [f32; 2], gain: f32) -> Pyramid {
        let image = RgbImage::from_fn(120, 100, |x, y| {
            let (x, y) = (x as f32 - shift[0], y as f32 - shift[1]);
            let v = 60.0 + 25.0 * ((0.21 * x).sin() * (0.17 * y + 0.4).cos() + (0.09 * x - 0.13 * y).sin());
            [(gain * v + 10.0) as u8; 3].into()
        });
        Pyramid::new(&image)
    }

    #[test]
    fn a_shifted_patch_is_found_under_other_light() {
        let (key, here) = (picture([0.0, 0.0], 1.0), picture([5.3, -3.6], 1.4));
        let found = find(&key, [60.0, 50.0], &here, [60.0, 50.0], &Matrix2::identity(), 3, 12.0).unwrap();
        assert!((found.at[0] - 65.3).abs() < 0.15 && (found.at[1] - 46.4).abs() < 0.15, "{found:?}");
        assert!(found.likeness > 0.98);
        assert!(find(&key, [60.0, 50.0], &here, [60.0, 50.0], &Matrix2::identity(), 3, 3.0).is_none(), "too far");
    }
}
