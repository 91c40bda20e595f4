//! Synthetic correspondences for the tests.

use crate::Correspondences;
use crate::points::PointSet;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose, standard_normal};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// K' of a crop of 256 px on an object of 0.15 m at 0.8 m.
pub(crate) const CAMERA: Intrinsics = Intrinsics { fx: 1230.0, fy: 1225.0, cx: 126.0, cy: 131.0 };

/// A pose in view of [`CAMERA`], any rotation.
pub(crate) fn random_pose(seed: u64) -> Pose {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let axis = Vector3::from_fn(|_, _| standard_normal(&mut rng));
    let rotation = UnitQuaternion::from_scaled_axis(axis.normalize() * rng.random_range(0.0..3.1));
    let mut shift = || rng.random_range(-0.01..0.01);
    Pose::from_parts(Translation3::new(shift(), shift(), 0.8 + 5.0 * shift()), rotation)
}

/// Points, where they are seen, and from where.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) points: Vec<[f32; 3]>,
    pub(crate) pixels: Vec<[f32; 2]>,
    pub(crate) pose: Pose,
    rng: ChaCha8Rng,
}

impl Scene {
    /// `n` points in a box of 2 x `half_m`, seen without noise.
    pub(crate) fn in_box(n: usize, seed: u64, half_m: [f64; 3]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
        let points: Vec<[f32; 3]> =
            (0..n).map(|_| half_m.map(|h| (h * (2.0 * rng.random::<f64>() - 1.0)) as f32)).collect();
        let pose = random_pose(seed);
        let pixels = points.iter().map(|p| see(&pose, p)).collect();
        Self { points, pixels, pose, rng }
    }

    pub(crate) fn solid(n: usize, seed: u64) -> Self {
        Self::in_box(n, seed, [0.05, 0.07, 0.04])
    }

    /// Starts another stream of noise.
    pub(crate) fn reseed(&mut self, seed: u64) {
        self.rng = ChaCha8Rng::seed_from_u64(seed);
    }

    /// Adds Gaussian noise, pixels.
    pub(crate) fn noisy(mut self, sigma_px: f64) -> Self {
        for pixel in &mut self.pixels {
            *pixel = pixel.map(|v| v + (sigma_px * standard_normal(&mut self.rng)) as f32);
        }
        self
    }

    /// Moves a share of the pixels anywhere in the crop.
    pub(crate) fn with_outliers(mut self, share: f64) -> Self {
        for pixel in &mut self.pixels {
            if self.rng.random::<f64>() < share {
                *pixel = [0, 1].map(|_| self.rng.random_range(0.0..256.0));
            }
        }
        self
    }

    pub(crate) fn correspondences(&self) -> Correspondences<'_> {
        Correspondences::new(&self.points, &self.pixels).unwrap()
    }

    /// A pose as far from the truth as the initial poses of a run.
    pub(crate) fn initial(&self) -> Pose {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.15, -0.12, 0.1));
        let shift = Vector3::new(0.004, -0.003, 0.02);
        Pose::from_parts(Translation3::from(self.pose.translation.vector + shift), turn * self.pose.rotation)
    }

    /// Mean displacement of the points between a pose and the truth (ADD), metres.
    pub(crate) fn add_m(&self, pose: &Pose) -> f64 {
        let moved = |p: &[f32; 3]| {
            let p = Point3::from(*p).cast::<f64>();
            (pose * p - self.pose * p).norm()
        };
        self.points.iter().map(moved).sum::<f64>() / self.points.len() as f64
    }
}

fn see(pose: &Pose, p: &[f32; 3]) -> [f32; 2] {
    let pixel = CAMERA.project(&(pose * Point3::from(*p).cast::<f64>())).expect("in front of the camera");
    [pixel.x as f32, pixel.y as f32]
}

pub(crate) fn point_set(points: &[[f32; 3]], pixels: &[[f32; 2]]) -> PointSet {
    let mut set = PointSet::default();
    set.fill(&Correspondences::new(points, pixels).unwrap(), usize::MAX);
    set
}
