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
    gradient: [[f32; COUNT]; 2],
    /// Inverse of the sum of gradient products.
    inverse: Matrix2<f32>,
    /// Sum of the gradients times the values.
    own_pull: Vector2<f32>,
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
        let rim = rim(level, at, key_from_here)?;
        let (mut values, mut gradient) = ([0.0; COUNT], [[0.0; COUNT]; 2]);
        for k in 0..COUNT {
            let (j, i) = (k / SIDE + 1, k % SIDE + 1);
            values[k] = rim[j][i];
            gradient[0][k] = 0.5 * (rim[j][i + 1] - rim[j][i - 1]);
            gradient[1][k] = 0.5 * (rim[j + 1][i] - rim[j - 1][i]);
        }
        let mean = sum(&values) / COUNT as f32;
        values.iter_mut().for_each(|v| *v -= mean);
        let [gx, gy] = &gradient;
        let across = dot(gx, gy);
        let inverse = Matrix2::new(dot(gx, gx), across, across, dot(gy, gy)).try_inverse()?;
        let own_pull = Vector2::new(dot(gx, &values), dot(gy, &values));
        let length = dot(&values, &values).sqrt().max(1e-3);
        Some(Self { values, gradient, inverse, own_pull, length })
    }

    /// The place near `start` that looks most like it.
    fn slide(&self, level: &Level, start: [f32; 2]) -> Option<([f32; 2], f32)> {
        let mut at = start;
        let mut likeness = 0.0;
        for _ in 0..STEPS {
            let mut seen = window(level, at)?;
            let mean = sum(&seen) / COUNT as f32;
            seen.iter_mut().for_each(|v| *v -= mean);
            let length = dot(&seen, &seen).sqrt().max(1e-3);
            let gain = length / self.length;
            likeness = dot(&seen, &self.values) / (length * self.length);
            let pull =
                Vector2::new(dot(&seen, &self.gradient[0]), dot(&seen, &self.gradient[1])) / gain - self.own_pull;
            let step = self.inverse * pull;
            at = [at[0] - step.x, at[1] - step.y];
            if step.norm() < STILL {
                break;
            }
        }
        at.iter().all(|v| v.is_finite()).then_some((at, likeness))
    }
}

/// The patch around a place of a keyframe, and a pixel more on each side, as the frame should show it; `None` where the keyframe ends.
fn rim(level: &Level, at: [f32; 2], key_from_here: &Matrix2<f32>) -> Option<[[f32; RIM]; RIM]> {
    let m = key_from_here;
    let place = |dx: f32, dy: f32| [at[0] + m[(0, 0)] * dx + m[(0, 1)] * dy, at[1] + m[(1, 0)] * dx + m[(1, 1)] * dy];
    let end = (HALF + 1) as f32;
    let corners = [place(-end, -end), place(end, -end), place(-end, end), place(end, end)];
    if !corners.iter().all(|c| level.holds(*c)) {
        return None;
    }
    let mut out = [[0.0; RIM]; RIM];
    for (j, row) in out.iter_mut().enumerate() {
        for (i, value) in row.iter_mut().enumerate() {
            *value = level.sample(place(i as f32 - end, j as f32 - end));
        }
    }
    Some(out)
}

/// The patch around a place of the frame; all its pixels lie equally between those of the frame. `None` where the frame ends.
fn window(level: &Level, at: [f32; 2]) -> Option<[f32; COUNT]> {
    let half = HALF as f32;
    let (first, last) = (at.map(|v| v - half), at.map(|v| v + half));
    if !(level.holds(first) && level.holds(last)) {
        return None;
    }
    let corner = first.map(|v| v as usize);
    let [fx, fy] = [0, 1].map(|k| first[k] - corner[k] as f32);
    let along = |j: usize| -> [f32; SIDE] {
        let from = (corner[1] + j) * level.width + corner[0];
        let pixels = &level.grey[from..][..SIDE + 1];
        let mut out = [0.0; SIDE];
        (0..SIDE).for_each(|i| out[i] = pixels[i] + fx * (pixels[i + 1] - pixels[i]));
        out
    };
    let mut out = [0.0; COUNT];
    let mut above = along(0);
    for (j, row) in out.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let below = along(j + 1);
        (0..SIDE).for_each(|i| row[i] = above[i] + fy * (below[i] - above[i]));
        above = below;
    }
    Some(out)
}

/// Sums in eight parts, as registers hold them.
const LANES: usize = 8;

fn sum(a: &[f32; COUNT]) -> f32 {
    dot(a, &[1.0; COUNT])
}

fn dot(a: &[f32; COUNT], b: &[f32; COUNT]) -> f32 {
    let mut parts = [0.0_f32; LANES];
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        (0..LANES).for_each(|i| parts[i] += a[i] * b[i]);
    }
    let rest: f32 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    parts.iter().sum::<f32>() + rest
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
