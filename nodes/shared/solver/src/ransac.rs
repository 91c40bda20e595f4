//! RANSAC with local optimisation (Chum, Matas and Kittler 2003) on a fixed random part of the points.

use crate::config::{MinimalSolver, PnpConfig};
use crate::epnp::epnp;
use crate::lm::{Limits, refine};
use crate::p3p::p3p;
use crate::points::PointSet;
use crate::score::{Score, score, score_against};
use nalgebra::{Point2, Point3, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use rand::Rng;

/// Points of a local optimisation: the first ones of the shuffled subset.
const LOCAL_POINTS: usize = 512;
/// Points of an EPnP sample.
const EPNP_SAMPLE: usize = 5;

/// The points RANSAC works on, and scratch space.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ransac {
    /// The scored points, shuffled.
    pub(crate) subset: PointSet,
    local: PointSet,
    order: Vec<usize>,
}

/// The best pose so far.
struct Best {
    pose: Pose,
    score: Score,
}

/// What does not change while sampling.
struct Search<'a> {
    subset: &'a PointSet,
    local: &'a PointSet,
    camera: &'a Intrinsics,
    config: &'a PnpConfig,
}

impl Ransac {
    /// The pose that explains most of `points`. The initial pose is the first hypothesis.
    pub(crate) fn run(
        &mut self,
        points: &PointSet,
        camera: &Intrinsics,
        initial: &Pose,
        config: &PnpConfig,
        rng: &mut impl Rng,
    ) -> Pose {
        self.subset.draw(points, config.max_ransac_points, &mut self.order, rng);
        self.local.take_first(&self.subset, LOCAL_POINTS);
        let search = Search { subset: &self.subset, local: &self.local, camera, config };
        let mut best = search.first(initial);
        let mut needed = search.needed(&best.score);
        let mut drawn = 0;
        while drawn < needed {
            drawn += 1;
            if search.try_sample(&mut best, rng) {
                needed = search.needed(&best.score);
            }
        }
        best.pose
    }
}

impl Search<'_> {
    fn threshold(&self) -> f64 {
        self.config.threshold_px
    }

    /// The initial pose, and where it gets by itself when the loss narrows down from far.
    fn first(&self, initial: &Pose) -> Best {
        let mut best = Best { pose: *initial, score: score(self.subset, self.camera, initial, self.threshold()) };
        self.optimise(&mut best, initial, &[16.0, 8.0, 4.0, 2.0]);
        best
    }

    /// Samples needed to draw a clean one with the wanted confidence, given the share of inliers.
    fn needed(&self, score: &Score) -> usize {
        let share = score.inliers / self.subset.len() as f64;
        let sample = match self.config.minimal {
            MinimalSolver::P3p => 3,
            MinimalSolver::Epnp => EPNP_SAMPLE as i32,
        };
        let miss = (1.0 - share.powi(sample)).ln();
        // No inlier: `miss` is 0 and the quotient infinite. All inliers: `miss` is -infinity and the quotient 0.
        let needed = ((1.0 - self.config.confidence).ln() / miss).abs().ceil();
        needed.clamp(1.0, self.config.max_iterations.max(1) as f64) as usize
    }

    /// Draws one sample, returns whether it led to a better pose.
    fn try_sample(&self, best: &mut Best, rng: &mut impl Rng) -> bool {
        let mut poses = [Pose::identity(); 4];
        let count = match self.config.minimal {
            MinimalSolver::P3p => self.sample_p3p(&mut poses, rng),
            MinimalSolver::Epnp => self.sample_epnp(&mut poses, rng),
        };
        let mut better = false;
        for pose in &poses[..count] {
            if let Some(score) = score_against(self.subset, self.camera, pose, self.threshold(), &best.score) {
                *best = Best { pose: *pose, score };
                self.optimise(best, pose, &[4.0, 2.0]);
                better = true;
            }
        }
        better
    }

    fn sample_p3p(&self, poses: &mut [Pose; 4], rng: &mut impl Rng) -> usize {
        let indices: [usize; 3] = distinct(self.subset.len(), rng);
        p3p(&indices.map(|i| self.subset.point(i).into()), &indices.map(|i| self.ray(i)), poses)
    }

    fn sample_epnp(&self, poses: &mut [Pose; 4], rng: &mut impl Rng) -> usize {
        let indices: [usize; EPNP_SAMPLE] = distinct(self.subset.len(), rng);
        let points: [Point3<f64>; EPNP_SAMPLE] = indices.map(|i| self.subset.point(i).into());
        let pixels = indices.map(|i| Point2::from(self.subset.pixel(i)));
        match epnp(&points, &pixels, self.camera) {
            Ok(pose) => {
                poses[0] = pose;
                1
            }
            // A sample on a line or without a pose in front of the camera is no hypothesis.
            Err(_) => 0,
        }
    }

    /// The unit ray on which point `i` is seen.
    fn ray(&self, i: usize) -> Vector3<f64> {
        let [u, v] = self.subset.pixel(i);
        self.camera.unproject(&Point2::new(u, v), 1.0).coords.normalize()
    }

    /// Refines `from` with ever narrower losses (in thresholds), and keeps what scores better.
    fn optimise(&self, best: &mut Best, from: &Pose, widths: &[f64]) {
        let mut pose = *from;
        for width in widths {
            let limits = Limits { passes: 4, step_px: 0.1 };
            pose = refine(self.local, self.camera, &pose, width * self.threshold(), limits);
        }
        if let Some(score) = score_against(self.subset, self.camera, &pose, self.threshold(), &best.score) {
            *best = Best { pose, score };
        }
    }
}

/// Different indices below `n`, which is at least `N`.
fn distinct<const N: usize>(n: usize, rng: &mut impl Rng) -> [usize; N] {
    let mut out = [0; N];
    for k in 0..N {
        loop {
            out[k] = rng.random_range(0..n);
            if !out[..k].contains(&out[k]) {
                break;
            }
        }
    }
    out
}
