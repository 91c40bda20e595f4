//! The photometric loss between real images (paper, section "Flow-guided photometric consistency"; docs/method.md, L_photo).
//!
//! Both images are warped onto the rendered view 0: the partner's by the teacher's flow, which is fixed, the sample's by
//! the student's. They are compared by a ternary census of 7 x 7 pixels (Meister et al., UnFlow, AAAI 2018): with d the
//! difference of a neighbour's grey value to the centre's,
//!
//! ```text
//! t(d) = d / sqrt(0.81 + d^2)        h = (t - t')^2        H = 48 mean h / (0.1 + h)
//! L = sum over partners, mean over the valid pixels of (H + 0.01)^0.4
//! ```
//!
//! Neighbours off the object are left out of the mean: the flow says nothing there.

use rayon::prelude::*;

/// Half of the census window's side.
const REACH: usize = 3;
/// Neighbours of a full window.
const FULL: f64 = 48.0;
const CENSUS: f64 = 0.81;
const SOFT: f64 = 0.1;
const CHARBONNIER: f64 = 0.01;
const POWER: f64 = 0.4;

/// One instance: its real crop, and where its loss counts.
#[derive(Debug, Clone, Copy)]
pub struct PhotoSample<'a> {
    /// Grey values 0..255 of the real crop, without augmentation: `S x S`.
    pub grey: &'a [f32],
    /// Not 0 on the rendered object of view 0: `S x S`.
    pub mask: &'a [u8],
    /// Not 0 where the label of view 0 is valid: `S x S`.
    pub valid: &'a [u8],
    /// Partners: grey values of the crop `S x S`, and the teacher's flow from view 0 to it `S x S x 2`.
    pub partners: &'a [(Vec<f32>, &'a [f32])],
}

/// Value and gradient of the loss over a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotoLoss {
    /// The loss.
    pub value: f64,
    /// Gradient with respect to each sample's flow `2 x S x S` (dx plane, dy plane).
    pub gradient: Vec<Vec<f32>>,
}

/// The loss of a batch. `flows[i]` is the student's flow of sample i in view 0: `2 x S x S`. 0 without valid pixels.
///
/// # Panics
/// When a plane has another size than `size_px` says.
#[must_use]
pub fn photo_loss(samples: &[PhotoSample<'_>], flows: &[&[f32]], size_px: usize) -> PhotoLoss {
    let parts: Vec<Part> =
        samples.par_iter().zip(flows).map(|(sample, flow)| Part::of(sample, flow, size_px)).collect();
    let count: usize = parts.iter().map(|part| part.count).sum();
    let scale = 1.0 / (count.max(1) as f64);
    PhotoLoss {
        value: parts.iter().map(|part| part.sum).sum::<f64>() * scale,
        gradient: parts.iter().map(|part| part.gradient.iter().map(|g| (g * scale) as f32).collect()).collect(),
    }
}

/// What one sample adds, not yet divided by the pixels.
struct Part {
    sum: f64,
    count: usize,
    gradient: Vec<f64>,
}

/// An image warped onto the rendered view; NaN where the flow leaves the image or the object.
struct Warped {
    grey: Vec<f64>,
    /// Derivatives by the flow's x and y.
    slope: Vec<[f64; 2]>,
}

/// Value and derivatives of a bilinear sample; `None` outside.
fn sample(image: &[f32], size_px: usize, x: f64, y: f64) -> Option<(f64, [f64; 2])> {
    let last = (size_px - 1) as f64;
    if !(0.0..=last).contains(&x) || !(0.0..=last).contains(&y) {
        return None;
    }
    let (x0, y0) = ((x as usize).min(size_px - 2), (y as usize).min(size_px - 2));
    let (a, b) = (x - x0 as f64, y - y0 as f64);
    let at = |dx: usize, dy: usize| f64::from(image[(y0 + dy) * size_px + x0 + dx]);
    let (p, q, r, s) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
    let (top, bottom) = (p + a * (q - p), r + a * (s - r));
    Some((top + b * (bottom - top), [(1.0 - b) * (q - p) + b * (s - r), bottom - top]))
}

impl Warped {
    fn of(image: &[f32], mask: &[u8], size_px: usize, flow: impl Fn(usize) -> [f32; 2]) -> Self {
        let mut out = Self { grey: vec![f64::NAN; mask.len()], slope: vec![[0.0; 2]; mask.len()] };
        for pixel in (0..mask.len()).filter(|pixel| mask[*pixel] != 0) {
            let [dx, dy] = flow(pixel).map(f64::from);
            let (x, y) = ((pixel % size_px) as f64 + dx, (pixel / size_px) as f64 + dy);
            if let Some((grey, slope)) = sample(image, size_px, x, y) {
                (out.grey[pixel], out.slope[pixel]) = (grey, slope);
            }
        }
        out
    }
}

/// t(d) and its derivative.
fn ternary(d: f64) -> (f64, f64) {
    let root = (CENSUS + d * d).sqrt();
    (d / root, CENSUS / (root * root * root))
}

impl Part {
    fn of(sample: &PhotoSample<'_>, flow: &[f32], size_px: usize) -> Self {
        let area = size_px * size_px;
        assert!(flow.len() == 2 * area && sample.grey.len() == area && sample.valid.len() == area);
        let own = Warped::of(sample.grey, sample.mask, size_px, |p| [flow[p], flow[p + area]]);
        let count = sample.valid.iter().filter(|v| **v != 0).count();
        let mut by_grey = vec![0.0; area];
        let mut sum = 0.0;
        for (grey, teacher) in sample.partners {
            let other = Warped::of(grey, sample.mask, size_px, |p| [teacher[2 * p], teacher[2 * p + 1]]);
            let valid = (0..area).filter(|p| sample.valid[*p] != 0);
            sum += valid.map(|p| compare(&own.grey, &other.grey, p, size_px, &mut by_grey)).sum::<f64>();
        }
        let mut gradient = vec![0.0; 2 * area];
        for pixel in 0..area {
            gradient[pixel] = by_grey[pixel] * own.slope[pixel][0];
            gradient[pixel + area] = by_grey[pixel] * own.slope[pixel][1];
        }
        Self { sum, count, gradient }
    }
}

/// The difference of two warped images at a pixel; adds its derivatives by the grey values of `own`.
fn compare(own: &[f64], other: &[f64], pixel: usize, size_px: usize, by_grey: &mut [f64]) -> f64 {
    if !(own[pixel].is_finite() && other[pixel].is_finite()) {
        return 0.0;
    }
    let (x, y) = (pixel % size_px, pixel / size_px);
    let range = |v: usize| v.saturating_sub(REACH)..(v + REACH + 1).min(size_px);
    let mut slopes = [(0, 0.0); FULL as usize];
    let (mut total, mut count) = (0.0, 0);
    for at in range(y).flat_map(|v| range(x).map(move |u| v * size_px + u)) {
        if at == pixel || !(own[at].is_finite() && other[at].is_finite()) {
            continue;
        }
        let ((t, dt), (t_other, _)) = (ternary(own[at] - own[pixel]), ternary(other[at] - other[pixel]));
        let h = (t - t_other).powi(2);
        total += h / (SOFT + h);
        slopes[count] = (at, SOFT / (SOFT + h).powi(2) * 2.0 * (t - t_other) * dt);
        count += 1;
    }
    if count == 0 {
        return 0.0;
    }
    let share = FULL / count as f64;
    let hamming = share * total;
    let outer = share * POWER * (hamming + CHARBONNIER).powf(POWER - 1.0);
    for (at, slope) in &slopes[..count] {
        by_grey[*at] += outer * slope;
        by_grey[pixel] -= outer * slope;
    }
    (hamming + CHARBONNIER).powf(POWER)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const SIZE: usize = 20;
    const AREA: usize = SIZE * SIZE;

    /// A smooth picture; `phase` moves it.
    fn picture(phase: [f64; 2]) -> Vec<f32> {
        let value = |p: usize| {
            let (x, y) = ((p % SIZE) as f64 + phase[0], (p / SIZE) as f64 + phase[1]);
            128.0 + 40.0 * (0.7 * x).sin() + 30.0 * (0.5 * y + 0.3 * x).cos()
        };
        (0..AREA).map(|p| value(p) as f32).collect()
    }

    struct Case {
        grey: Vec<f32>,
        mask: Vec<u8>,
        valid: Vec<u8>,
        partners: Vec<(Vec<f32>, Vec<f32>)>,
    }

    impl Case {
        fn loss(&self, flow: &[f32]) -> PhotoLoss {
            let partners: Vec<(Vec<f32>, &[f32])> =
                self.partners.iter().map(|(grey, flow)| (grey.clone(), flow.as_slice())).collect();
            let sample = PhotoSample { grey: &self.grey, mask: &self.mask, valid: &self.valid, partners: &partners };
            photo_loss(&[sample], &[flow], SIZE)
        }
    }

    fn case(partner_phase: [f64; 2]) -> Case {
        let inside = |p: usize, edge: usize| {
            let (x, y) = (p % SIZE, p / SIZE);
            u8::from((edge..SIZE - edge).contains(&x) && (edge..SIZE - edge).contains(&y))
        };
        Case {
            grey: picture([0.0; 2]),
            mask: (0..AREA).map(|p| inside(p, 3)).collect(),
            valid: (0..AREA).map(|p| inside(p, 4)).collect(),
            partners: vec![(picture(partner_phase), vec![0.0; 2 * AREA])],
        }
    }

    fn constant_flow(dx: f32, dy: f32) -> Vec<f32> {
        [vec![dx; AREA], vec![dy; AREA]].concat()
    }

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let case = case([0.8, -0.4]);
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        // Off whole pixels, where a bilinear sample has a corner; flow and step are exact in f32.
        let flow: Vec<f32> =
            (0..2 * AREA).map(|_| rng.random_range(205..819_u16)).map(|v| f32::from(v) / 1024.0).collect();
        let gradient = &case.loss(&flow).gradient[0];
        let largest = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        let mut checked = 0;
        for index in (0..2 * AREA).step_by(7).filter(|i| gradient[*i] != 0.0) {
            let step = 1.0 / 16384.0;
            let at = |by: f32| {
                let mut moved = flow.clone();
                moved[index] += by;
                case.loss(&moved).value
            };
            let numeric = (at(step) - at(-step)) / f64::from(2.0 * step);
            let difference = (numeric - f64::from(gradient[index])).abs();
            assert!(difference < 5e-4 * f64::from(largest), "{index}: {numeric} and {}", gradient[index]);
            checked += 1;
        }
        assert!(checked > 50);
    }

    #[test]
    fn the_right_flow_has_the_least_loss() {
        // The partner shows the picture moved by (0.8, -0.4): the flow that undoes it.
        let case = case([0.8, -0.4]);
        let at = |dx: f32, dy: f32| case.loss(&constant_flow(dx, dy)).value;
        let best = at(0.8, -0.4);
        for (dx, dy) in [(0.0, 0.0), (0.4, -0.4), (1.2, -0.4), (0.8, 0.0), (0.8, -0.9)] {
            assert!(at(dx, dy) > 1.1 * best, "({dx}, {dy}): {} and {best}", at(dx, dy));
        }
    }

    #[test]
    fn light_does_not_matter_much() {
        // Census compares differences' signs: brightness and contrast of the partner change little.
        let mut case = case([0.0; 2]);
        let same = case.loss(&constant_flow(0.0, 0.0)).value;
        case.partners[0].0.iter_mut().for_each(|v| *v = 0.6 * *v + 50.0);
        let dimmed = case.loss(&constant_flow(0.0, 0.0)).value;
        let moved = case.loss(&constant_flow(1.5, 0.0)).value;
        assert!(dimmed - same < 0.5 * (moved - same), "{same} {dimmed} {moved}");
    }

    #[test]
    fn pixels_do_not_move_by_half() {
        // A field of zeros reads texels exactly: equal images give the least possible value.
        let least = CHARBONNIER.powf(POWER);
        assert!((case([0.0; 2]).loss(&constant_flow(0.0, 0.0)).value - least).abs() < 1e-9);
    }

    #[test]
    fn nothing_valid_or_out_of_view_is_no_loss() {
        let mut case = case([0.8, 0.0]);
        let out = case.loss(&constant_flow(500.0, 0.0));
        assert_eq!((out.value, out.gradient[0].iter().any(|g| *g != 0.0)), (0.0, false));
        case.valid.fill(0);
        assert_eq!(case.loss(&constant_flow(0.0, 0.0)).value, 0.0);
    }
}
