//! Correspondence lines: where along the normal of each contour point the colours change from inside to outside.

use crate::model::ContourPoint;
use crate::picture::Picture;
use pseudoflow_geometry::Pose;

/// Segments of a line.
const SEGMENTS: usize = 19;
/// Places of the contour on a line that are compared, half a segment off the middles of segments.
pub(crate) const OFFSETS: usize = 12;
/// Segments that take part in the likelihood of one place.
const STEP: usize = 8;

/// A contour point as a pose shows it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Line {
    /// Where it is projected, pixels of the picture.
    pub(crate) at: [f32; 2],
    /// Its normal there.
    pub(crate) normal: [f32; 2],
    /// Derivative of the point's place along the normal by translation (m) and rotation (rad), as in the solver.
    pub(crate) jacobian: [f32; 6],
    /// How far object and background reach, pixels.
    pub(crate) inside_px: f32,
    pub(crate) outside_px: f32,
    /// Where the contour is on the line, outwards, pixels: mean and variance.
    pub(crate) mean_px: f32,
    pub(crate) variance_px2: f32,
    /// Probability of the contour being where the pose says, of all places on the line; 1/12 when nothing is known.
    pub(crate) here: f32,
    /// Weight from outside: 0 when the line is not to be used.
    pub(crate) weight: f32,
}

/// Camera and pose in single precision.
struct PosedCamera {
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    focal: [f32; 2],
    centre: [f32; 2],
}

impl PosedCamera {
    fn new(pose: &Pose, picture: &Picture) -> Self {
        let r = pose.rotation.to_rotation_matrix();
        let t = pose.translation.vector;
        Self {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)] as f32)),
            translation: [t.x as f32, t.y as f32, t.z as f32],
            focal: picture.focal,
            centre: picture.centre,
        }
    }

    fn turn(&self, v: &[f32; 3]) -> [f32; 3] {
        self.rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    fn line(&self, point: &ContourPoint) -> Option<Line> {
        let q = self.turn(&point.position_m);
        let p: [f32; 3] = std::array::from_fn(|i| q[i] + self.translation[i]);
        if p[2] < 1e-3 {
            return None;
        }
        let inverse = 1.0 / p[2];
        let (x, y) = (p[0] * inverse, p[1] * inverse);
        let n = self.turn(&point.normal);
        // The image of the direction, not of its first two numbers: perspective bends it towards the middle.
        let (nx, ny) = (self.focal[0] * (n[0] - x * n[2]), self.focal[1] * (n[1] - y * n[2]));
        let length = nx.hypot(ny);
        if length < 1e-6 {
            return None;
        }
        let normal = [nx / length, ny / length];
        let a = [normal[0] * self.focal[0] * inverse, normal[1] * self.focal[1] * inverse];
        let a = [a[0], a[1], -(a[0] * x + a[1] * y)];
        let px_per_m = self.focal[0] * inverse;
        Some(Line {
            at: [self.focal[0] * x + self.centre[0], self.focal[1] * y + self.centre[1]],
            normal,
            jacobian: [
                a[0],
                a[1],
                a[2],
                q[1] * a[2] - q[2] * a[1],
                q[2] * a[0] - q[0] * a[2],
                q[0] * a[1] - q[1] * a[0],
            ],
            inside_px: point.inside_m * px_per_m,
            outside_px: point.outside_m * px_per_m,
            mean_px: 0.0,
            variance_px2: 0.0,
            here: 0.0,
            weight: 1.0,
        })
    }
}

/// The lines of a view: those whose middle is in the picture, or `everywhere`.
pub(crate) fn project(
    points: &[ContourPoint],
    pose: &Pose,
    picture: &Picture,
    everywhere: bool,
    lines: &mut Vec<Line>,
) {
    let view = PosedCamera::new(pose, picture);
    lines.clear();
    let within = |l: &Line| everywhere || picture.shows(l.at);
    lines.extend(points.iter().filter_map(|p| view.line(p)).filter(within));
}

/// Whether a place has pixels on all sides.
#[inline]
fn is_within([x, y]: [f32; 2], size_px: usize) -> bool {
    let limit = size_px as f32 - 1.001;
    x >= 0.0 && y >= 0.0 && x < limit && y < limit
}

/// Bilinear sample of a plane; 0 outside.
#[inline]
pub(crate) fn sample(plane: &[f32], size_px: usize, at: [f32; 2]) -> f32 {
    if is_within(at, size_px) { interpolate(plane, size_px, at) } else { 0.0 }
}

/// Bilinear sample at a place that has pixels on all sides.
#[inline]
fn interpolate(plane: &[f32], size_px: usize, [x, y]: [f32; 2]) -> f32 {
    let ((x0, fx), (y0, fy)) = (split(x), split(y));
    // One check of bounds for all four.
    let around = &plane[y0 * size_px + x0..][..size_px + 2];
    let top = around[0] + fx * (around[1] - around[0]);
    let bottom = around[size_px] + fx * (around[size_px + 1] - around[size_px]);
    top + fy * (bottom - top)
}

/// Whole number and rest, 0..=1, of a small positive number; conversions to integers would take longer.
#[inline]
fn split(v: f32) -> (usize, f32) {
    let shifted = (v - 0.5).max(0.0) + WHOLE;
    ((shifted.to_bits() & 0xffff) as usize, v - (shifted - WHOLE))
}

/// Added to a small number, leaves the nearest whole one in the lowest bits.
const WHOLE: f32 = 12_582_912.0;

/// How lines are read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    /// Length of a segment, pixels of the picture.
    pub(crate) scale_px: f32,
    /// Of the smoothed step: a pixel inside of the contour has a colour of the inside with probability `1/2 + amplitude`, one outside
    /// of it with `1/2 - amplitude`. SRT3D's global and local uncertainty (arXiv 2110.12715, eq. 9) without the slope, which did worse.
    pub(crate) amplitude: f32,
    /// Shortest stretch of object and of background, segments.
    pub(crate) shortest: f32,
    /// Share of a pixel's evidence that counts.
    pub(crate) evidence: f32,
}

/// Finds the contour on each line; lines with too short a stretch of object or background get no weight.
pub(crate) fn measure(lines: &mut [Line], log_odds: &[f32], size_px: usize, reading: &Reading) {
    let shortest_px = reading.shortest * reading.scale_px;
    for line in lines {
        if line.weight == 0.0 || line.inside_px < shortest_px || line.outside_px < shortest_px {
            line.weight = 0.0;
            continue;
        }
        let inside = segments(line, log_odds, size_px, reading);
        let likelihood = likelihoods(&inside, reading.amplitude);
        describe(line, &likelihood, reading.scale_px);
    }
}

/// Probability of each segment to be of the object's colours.
fn segments(line: &Line, log_odds: &[f32], size_px: usize, reading: &Reading) -> [f32; SEGMENTS] {
    let samples = reading.scale_px.round().max(1.0) as usize;
    let step_px = reading.scale_px / samples as f32;
    // A sample stands for `step_px` pixels.
    let weight = step_px * reading.evidence;
    let first = -0.5 * SEGMENTS as f32 * reading.scale_px + 0.5 * step_px;
    let last = first + (SEGMENTS * samples - 1) as f32 * step_px;
    let within = [first, last].iter().all(|r| is_within(on_line(line, *r), size_px));
    let mut odds = [0.0; SEGMENTS];
    for (k, odds) in odds.iter_mut().enumerate() {
        let at = |s: usize| on_line(line, first + (k * samples + s) as i32 as f32 * step_px);
        let sum: f32 = match within {
            true => (0..samples).map(|s| interpolate(log_odds, size_px, at(s))).sum(),
            false => (0..samples).map(|s| sample(log_odds, size_px, at(s))).sum(),
        };
        *odds = weight * sum;
    }
    probabilities(odds)
}

/// The place `r` pixels out from a line's point.
#[inline]
fn on_line(line: &Line, r: f32) -> [f32; 2] {
    [line.at[0] + r * line.normal[0], line.at[1] + r * line.normal[1]]
}

/// Logistic function, to 1e-4, in a way that compilers vectorise: `exp` by its power of two and a polynomial of the rest.
fn probabilities(log_odds: [f32; SEGMENTS]) -> [f32; SEGMENTS] {
    log_odds.map(|v| {
        let power = v.clamp(-40.0, 40.0) * -std::f32::consts::LOG2_E;
        let shifted = power + WHOLE;
        let rest = power - (shifted - WHOLE);
        let two_to_rest =
            1.0 + rest * (std::f32::consts::LN_2 + rest * (0.240_226 + rest * (0.055_504 + rest * 0.009_618)));
        let two_to_whole = f32::from_bits((shifted.to_bits() << 23).wrapping_add(1_f32.to_bits()));
        1.0 / (1.0 + two_to_rest * two_to_whole)
    })
}

/// How well each place of the contour explains the segments (SRT3D, eq. 8): of the [`STEP`] segments around a place, the first half
/// lies inside.
fn likelihoods(inside: &[f32; SEGMENTS], amplitude: f32) -> [f32; OFFSETS] {
    let within = inside.map(|p| 0.5 + amplitude * (2.0 * p - 1.0));
    let beyond = within.map(|p| 1.0 - p);
    let of_four = |v: &[f32; SEGMENTS], i: usize| (v[i] * v[i + 1]) * (v[i + 2] * v[i + 3]);
    std::array::from_fn(|j| of_four(&within, j) * of_four(&beyond, j + STEP / 2))
}

/// Mean and variance of the places, in pixels.
fn describe(line: &mut Line, likelihood: &[f32; OFFSETS], scale_px: f32) {
    let total: f32 = likelihood.iter().sum();
    let place = |j: usize| j as f32 - 0.5 * (OFFSETS as f32 - 1.0);
    let mean = (0..OFFSETS).map(|j| likelihood[j] * place(j)).sum::<f32>() / total;
    let variance = (0..OFFSETS).map(|j| likelihood[j] * (place(j) - mean).powi(2)).sum::<f32>() / total;
    line.mean_px = mean * scale_px;
    line.variance_px2 = variance * scale_px * scale_px;
    line.here = 0.5 * (likelihood[OFFSETS / 2 - 1] + likelihood[OFFSETS / 2]) / total;
}

/// Samples on either side of the middle of an edge profile.
const HALF: i32 = 6;
/// Of these on either side, how many may lie in the blur of the edge.
const BLURRED: i32 = 2;

/// Finds the edge on each line to a fraction of a pixel: the mean colours of either side are known a few pixels off, and what lies
/// between them is a mixture whose shares say how far the inside reaches (moment-preserving edge, Tabatabai and Mitchell 1984).
pub(crate) fn measure_edges(lines: &mut [Line], picture: &Picture, noise: f32) {
    let h = 1.0 / picture.independence.max(1e-3);
    for line in lines {
        let reach = HALF as f32 * h;
        if line.weight == 0.0 || line.inside_px < reach || line.outside_px < reach {
            line.weight = 0.0;
            continue;
        }
        if !(picture.shows(on_line(line, reach)) && picture.shows(on_line(line, -reach))) {
            line.weight = 0.0;
            continue;
        }
        let mut colours = [[0.0_f32; 3]; 2 * HALF as usize + 1];
        for (i, colour) in colours.iter_mut().enumerate() {
            let r = (i as i32 - HALF) as f32 * h;
            let at = on_line(line, r);
            for (value, plane) in colour.iter_mut().zip(&picture.channels) {
                *value = sample(plane, picture.size_px, at);
            }
        }
        let far = (HALF - BLURRED) as usize;
        let mean = |part: &[[f32; 3]]| -> [f32; 3] {
            std::array::from_fn(|c| part.iter().map(|v| v[c]).sum::<f32>() / part.len() as f32)
        };
        let (inside, outside) = (mean(&colours[..far]), mean(&colours[colours.len() - far..]));
        let e: [f32; 3] = std::array::from_fn(|c| inside[c] - outside[c]);
        let contrast2 = e.iter().map(|v| v * v).sum::<f32>();
        let share = |v: &[f32; 3]| (0..3).map(|c| (v[c] - outside[c]) * e[c]).sum::<f32>() / contrast2.max(1.0);
        let blurred: f32 = colours[far..colours.len() - far].iter().map(share).sum();
        let spread = colours[..far].iter().map(|v| (share(v) - 1.0).powi(2)).sum::<f32>()
            + colours[colours.len() - far..].iter().map(|v| share(v).powi(2)).sum::<f32>();
        let variance = spread / (2 * far - 2) as f32 + noise * noise / contrast2.max(1.0);
        let width = (2 * BLURRED + 1) as f32;
        line.mean_px = h * (blurred - 0.5 * width).clamp(-0.5 * width, 0.5 * width);
        line.variance_px2 = h * h * width * variance;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prior::retract;
    use nalgebra::{Vector3, Vector6};

    fn picture() -> Picture {
        Picture { focal: [300.0, 310.0], centre: [60.0, 62.0], high: [127.0; 2], ..Picture::default() }
    }

    #[test]
    fn the_jacobian_is_the_finite_difference() {
        let point =
            ContourPoint { position_m: [0.03, -0.02, 0.04], normal: [0.6, 0.64, 0.48], inside_m: 1.0, outside_m: 1.0 };
        let pose = Pose::new(Vector3::new(0.02, -0.01, 0.6), Vector3::new(0.3, -0.5, 0.2));
        let lines = |pose: &Pose| {
            let mut lines = Vec::new();
            project(&[point], pose, &picture(), true, &mut lines);
            lines[0]
        };
        let line = lines(&pose);
        for k in 0..6 {
            let mut tangent = Vector6::zeros();
            tangent[k] = 1e-3;
            let (ahead, behind) = (lines(&retract(&pose, &tangent)).at, lines(&retract(&pose, &-tangent)).at);
            let slope = (0..2).map(|a| (ahead[a] - behind[a]) * line.normal[a]).sum::<f32>() / 2e-3;
            assert!((slope - line.jacobian[k]).abs() < 0.005 * slope.abs() + 0.05, "{k}: {slope} {}", line.jacobian[k]);
        }
    }

    /// Picture whose left part, up to `edge`, is the object: log odds and colours, blurred by a box of 3 pixels.
    fn step_at(edge: f32) -> (Vec<f32>, Picture) {
        let share = |x: usize| (0..30).filter(|i| x as f32 - 1.5 + 0.1 * *i as f32 + 0.05 < edge).count() as f32 / 30.0;
        let odds = (0..128 * 128).map(|i| 6.0 * share(i % 128) - 3.0).collect();
        let colours: Vec<f32> = (0..128 * 128).map(|i| 40.0 + 120.0 * share(i % 128)).collect();
        let channels = [colours.clone(), colours.clone(), colours];
        (odds, Picture { size_px: 128, channels, independence: 1.0, ..picture() })
    }

    fn line_at(x: f32) -> Line {
        Line {
            at: [x, 60.0],
            normal: [1.0, 0.0],
            jacobian: [0.0; 6],
            inside_px: 50.0,
            outside_px: 50.0,
            mean_px: 0.0,
            variance_px2: 0.0,
            here: 0.0,
            weight: 1.0,
        }
    }

    #[test]
    fn probabilities_are_those_of_the_logistic_function() {
        let odds: [f32; SEGMENTS] = std::array::from_fn(|i| (i as f32 - 9.0) * 1.37 + 0.1);
        for (p, v) in probabilities(odds).into_iter().zip(odds) {
            assert!((p - 1.0 / (1.0 + (-v).exp())).abs() < 1e-4, "{v}: {p}");
        }
        let far = probabilities([1e9; SEGMENTS])[0] - probabilities([-1e9; SEGMENTS])[0];
        assert!((far - 1.0).abs() < 1e-6);
    }

    #[test]
    fn lines_find_the_step_at_every_scale() {
        let (odds, picture) = step_at(64.0);
        for scale_px in [1.0_f32, 2.0, 5.0] {
            for off in [-2.0, 0.0, 1.5_f32] {
                let mut lines = [line_at(64.0 - off * scale_px)];
                let reading = Reading { scale_px, amplitude: 0.36, shortest: 3.0, evidence: 1.0 };
                measure(&mut lines, &odds, picture.size_px, &reading);
                assert!(
                    (lines[0].mean_px - off * scale_px).abs() < 0.4 * scale_px,
                    "{scale_px} {off}: {}",
                    lines[0].mean_px
                );
            }
        }
        let mut thin = [Line { inside_px: 5.0, ..line_at(64.0) }];
        let reading = Reading { scale_px: 2.0, amplitude: 0.36, shortest: 3.0, evidence: 1.0 };
        measure(&mut thin, &odds, picture.size_px, &reading);
        assert_eq!(thin[0].weight, 0.0);
    }

    #[test]
    fn edges_are_placed_to_a_fraction_of_a_pixel_without_bias() {
        for edge in [63.8_f32, 64.0, 64.3, 64.5] {
            let (_, picture) = step_at(edge);
            for at in [63.5, 64.0, 65.0_f32] {
                let mut lines = [line_at(at)];
                measure_edges(&mut lines, &picture, 2.0);
                assert!((at + lines[0].mean_px - edge).abs() < 0.06, "{edge} {at}: {}", lines[0].mean_px);
            }
        }
    }
}
