//! The loss of the poses that predicted flows say (docs/method.md, "Synthetic pre-training").

use nalgebra::{Point2, Point3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_learning::ExtraLoss;
use pseudoflow_solver::{PosedPixels, pose_error_slope};
use pseudoflow_synthetic::Sample;
use rayon::prelude::*;

/// Points of a pair that its pose is solved from.
const MOST_POINTS: usize = 400;
/// Half weight of a residual of this length at 256 px; pnp takes 3 px for an inlier there.
const WIDTH_AT_256: f64 = 4.0;
/// An ADD of this many diameters counts half of what it would count in proportion: a pose that is lost is not worth the rest.
const HALF: f64 = 0.3;

/// What the poses of a batch are judged by.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PoseLoss {
    weight: f64,
    size_px: usize,
    pairs: Vec<Pair>,
}

#[derive(Debug, Clone, PartialEq)]
struct Pair {
    /// Numbers of the pixels of the reference that show points which are seen in the real crop.
    places: Vec<usize>,
    /// The points, camera axes of the reference, metres.
    points_m: Vec<Point3<f64>>,
    camera: Intrinsics,
    real_from_reference: Pose,
    diameter_m: f64,
}

impl Pair {
    fn of(sample: &Sample) -> Self {
        let (label, size_px) = (&sample.label, sample.label.size_px as usize);
        let seen: Vec<usize> = (0..label.visible.len()).filter(|i| label.visible[*i]).collect();
        let places: Vec<usize> = seen.iter().copied().step_by(seen.len().div_ceil(MOST_POINTS).max(1)).collect();
        let point = |i: &usize| {
            let pixel = Point2::new((i % size_px) as f64, (i / size_px) as f64);
            sample.intrinsics.unproject(&pixel, f64::from(label.depth_m[*i]))
        };
        Self {
            points_m: places.iter().map(point).collect(),
            places,
            camera: sample.intrinsics,
            real_from_reference: sample.truth_camera_from_object * sample.reference_camera_from_object.inverse(),
            diameter_m: sample.diameter_m,
        }
    }

    /// The pair's loss for a weight of 1, and its slope by the flow (2, S, S); zero where the flow says no pose.
    fn loss(&self, flow_px: &[f32], size_px: usize, slope: &mut [f32], weight: f64) -> f64 {
        let area = size_px * size_px;
        let pixel = |i: &usize| {
            [(i % size_px) as f64 + f64::from(flow_px[*i]), (i / size_px) as f64 + f64::from(flow_px[area + i])]
        };
        let pixels: Vec<[f64; 2]> = self.places.iter().map(pixel).collect();
        let posed = PosedPixels {
            points_m: &self.points_m,
            pixels: &pixels,
            camera: self.camera,
            truth: self.real_from_reference,
            diameter_m: self.diameter_m,
            width_px: WIDTH_AT_256 * size_px as f64 / 256.0,
        };
        let Some(found) = pose_error_slope(&posed) else { return 0.0 };
        let bent = HALF / (HALF + found.add_of_diameter);
        for (place, by) in self.places.iter().zip(&found.by_pixel) {
            slope[*place] = (weight * bent * bent * by[0]) as f32;
            slope[area + place] = (weight * bent * bent * by[1]) as f32;
        }
        weight * found.add_of_diameter * bent
    }
}

impl PoseLoss {
    pub(crate) fn new(samples: &[&Sample], weight: f64) -> Self {
        let size_px = samples.first().map_or(0, |sample| sample.label.size_px as usize);
        Self { weight, size_px, pairs: samples.iter().map(|sample| Pair::of(sample)).collect() }
    }

    /// The mean over the pairs of what their flows (n, 2, S, S) cost, and its slope there. A crop of half the size has half the pixels for
    /// the same error, and counts half.
    pub(crate) fn of(&self, flow_px: &[f32]) -> ExtraLoss {
        let weight = self.weight * self.size_px as f64 / 256.0 / self.pairs.len().max(1) as f64;
        let each = 2 * self.size_px * self.size_px;
        let mut gradient = vec![0.0; flow_px.len()];
        let pairs = gradient.par_chunks_mut(each).zip(flow_px.par_chunks(each)).zip(&self.pairs);
        let values: Vec<f64> =
            pairs.map(|((slope, flow_px), pair)| pair.loss(flow_px, self.size_px, slope, weight)).collect();
        ExtraLoss { value: values.iter().sum::<f64>() as f32, gradient }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_synthetic::{ObjectPool, SampleGenerator, SynthConfig, write_sample_objects};
    use std::sync::Arc;

    /// The pairs of a scene and their true flows (n, 2, S, S).
    fn pairs() -> (Vec<Sample>, Vec<f32>) {
        let folder = tempfile::tempdir().unwrap();
        let pool = ObjectPool::load(&[write_sample_objects(folder.path()).unwrap()]).unwrap();
        let generator = SampleGenerator::new(Arc::new(pool), SynthConfig::default(), 3).unwrap();
        let samples = generator.batch(0, 2, 64).unwrap();
        let planes = |sample: &Sample| {
            (0..2)
                .map(|axis| sample.label.flow_px.iter().map(|f| f[axis]).collect::<Vec<_>>())
                .collect::<Vec<_>>()
                .concat()
        };
        let flows = samples.iter().flat_map(planes).collect();
        (samples, flows)
    }

    #[test]
    fn true_flow_costs_nothing_and_the_slope_leads_to_it() {
        let (samples, truth) = pairs();
        let loss = PoseLoss::new(&samples.iter().collect::<Vec<_>>(), 20.0);
        assert!(loss.of(&truth).value < 1e-3, "{}", loss.of(&truth).value);
        // Flow that contracts to the middle of the crop, as a doubtful network's does.
        let contracted: Vec<f32> = truth
            .iter()
            .enumerate()
            .map(|(i, flow)| {
                let (x, y) = (i % 64, i / 64 % 64);
                let place = if i / (64 * 64) % 2 == 0 { x } else { y };
                flow - 0.04 * (place as f32 - 31.5)
            })
            .collect();
        let there = loss.of(&contracted);
        let norm = there.gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
        let step =
            |by: f32| contracted.iter().zip(&there.gradient).map(|(f, g)| f - by * g / norm).collect::<Vec<f32>>();
        let (less, predicted) = (loss.of(&step(0.5)).value, 0.5 * norm);
        assert!(there.value > 0.1 && norm > 0.0, "{}", there.value);
        // Downhill at least as fast as it says: it is damped where points hardly determine the pose.
        assert!(there.value - less > 0.5 * predicted, "{} {less} {predicted}", there.value);
    }
}
