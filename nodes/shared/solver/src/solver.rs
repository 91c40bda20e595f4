use crate::config::PnpConfig;
use crate::covariance::covariance;
use crate::lm::{Limits, refine};
use crate::normal::Z_MIN_M;
use crate::points::PointSet;
use crate::ransac::Ransac;
use crate::{Correspondences, PnpError};
use nalgebra::Matrix6;
use pseudoflow_geometry::{Intrinsics, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fmt;

/// The variance on the diagonal of the covariance of a pose that was not found, m^2 and rad^2.
pub const UNKNOWN_VARIANCE: f64 = 1e6;

/// Ratio of the second to the largest extent of the points under which they count as a line.
const LINEAR: f64 = 1e-3;
/// A larger share of the points behind the camera is a failure.
const MAX_SHARE_BEHIND: f64 = 0.05;

/// Whether a pose was found, and if not, why. All but `Ok` keep the initial pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PnpStatus {
    /// A pose was found.
    Ok,
    /// Not enough finite correspondences.
    TooFewPoints {
        /// Finite correspondences given.
        got: usize,
        /// Needed.
        need: usize,
    },
    /// No pose explains enough of the correspondences.
    TooFewInliers {
        /// Inliers of the best pose, out of the points used.
        got: usize,
        /// Needed.
        need: usize,
    },
    /// The initial pose or the intrinsics have a number that is not finite, or a focal length is not positive.
    NotFinite,
    /// The points lie on a line, or leave a rotation undetermined.
    Degenerate {
        /// Largest standard deviation of the rotation about any axis, radians; infinite when singular.
        rotation_std_rad: f64,
    },
    /// The best pose puts points behind the camera.
    BehindCamera {
        /// Share of the points, 0..1.
        share: f64,
    },
}

impl PnpStatus {
    /// Whether a pose was found.
    #[must_use]
    pub fn is_ok(&self) -> bool {
        *self == Self::Ok
    }
}

impl fmt::Display for PnpStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ok => write!(f, "ok"),
            Self::TooFewPoints { got, need } => write!(f, "{got} finite correspondences, {need} needed"),
            Self::TooFewInliers { got, need } => write!(f, "the best pose has {got} inliers, {need} needed"),
            Self::NotFinite => {
                write!(f, "the initial pose or the intrinsics are not finite, or a focal length is not positive")
            }
            Self::Degenerate { rotation_std_rad } => {
                write!(f, "the points leave the rotation open: standard deviation {rotation_std_rad:.2} rad")
            }
            Self::BehindCamera { share } => write!(f, "{:.0} % of the points are behind the camera", share * 100.0),
        }
    }
}

/// What [`Solver::solve`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct PnpResult {
    /// The pose; the initial pose unless `status` is `Ok`.
    pub camera_from_object: Pose,
    /// 6 x 6, row-major, as in `geometry_msgs/PoseWithCovariance`: x, y, z (m), then rotations (rad) about the fixed
    /// x, y, z axes of the *camera*, at the object's origin (`t = t0 + dt`, `R = exp(dphi) R0`). From the residuals
    /// (sandwich estimate); it does not know errors that all pixels share. On failure [`UNKNOWN_VARIANCE`] on the
    /// diagonal.
    pub covariance: [f64; 36],
    /// Share of the used correspondences within the threshold, 0..1. On failure that of the best pose found.
    pub inlier_ratio: f64,
    /// Correspondences within the threshold, out of those used.
    pub inliers: usize,
    /// Root mean square reprojection error of the inliers (length of the 2D error), pixels; 0 without inliers.
    pub rms_px: f64,
    /// Whether a pose was found, and if not, why.
    pub status: PnpStatus,
}

/// Finds poses. Holds its working memory: once that has grown to the size of the input, [`Solver::solve`] allocates
/// nothing.
#[derive(Debug, Clone)]
pub struct Solver {
    config: PnpConfig,
    points: PointSet,
    ransac: Ransac,
    histogram: Vec<u32>,
}

/// What the points say about a pose.
struct Judged {
    inliers: usize,
    rms_px: f64,
    share_behind: f64,
}

impl Solver {
    /// A solver with these settings.
    ///
    /// # Errors
    /// [`PnpError::Setting`] when a setting is out of range.
    pub fn new(config: PnpConfig) -> Result<Self, PnpError> {
        config.validate()?;
        Ok(Self { config, points: PointSet::default(), ransac: Ransac::default(), histogram: vec![0; BINS] })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &PnpConfig {
        &self.config
    }

    /// The pose that explains the correspondences. The initial pose is tried first and is kept on failure. The same
    /// input and `seed` give the same bits.
    pub fn solve(
        &mut self,
        correspondences: &Correspondences<'_>,
        intrinsics: &Intrinsics,
        initial_camera_from_object: &Pose,
        seed: u64,
    ) -> PnpResult {
        let initial = initial_camera_from_object;
        if !is_finite(initial, intrinsics) {
            return failure(initial, None, 0, PnpStatus::NotFinite);
        }
        let got = self.points.fill(correspondences, self.config.max_refine_points);
        let need = self.config.min_inliers;
        if got < need {
            return failure(initial, None, got, PnpStatus::TooFewPoints { got, need });
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let rough = self.ransac.run(&self.points, intrinsics, initial, &self.config, &mut rng);
        let (pose, width_px) = self.polish(&rough, intrinsics);
        let judged = self.judge(&pose, intrinsics);
        match self.check(&pose, intrinsics, width_px, &judged) {
            Ok(covariance) => success(&pose, &covariance, &judged, self.points.len()),
            Err(status) => failure(initial, Some(&judged), self.points.len(), status),
        }
    }

    /// Refines on the subset, measures the noise there, then refines on all points. Returns the width of the last loss,
    /// pixels.
    fn polish(&mut self, rough: &Pose, camera: &Intrinsics) -> (Pose, f64) {
        let wide = 2.0 * self.config.threshold_px;
        let near = refine(&self.ransac.subset, camera, rough, wide, Limits { passes: 8, step_px: 0.02 });
        let width = self.width_px(&near, camera);
        (refine(&self.points, camera, &near, width, Limits { passes: 10, step_px: 1e-3 }), width)
    }

    /// Width of Tukey's loss: `tukey_width` robust standard deviations of the inliers of the subset.
    fn width_px(&mut self, pose: &Pose, camera: &Intrinsics) -> f64 {
        let threshold = self.config.threshold_px;
        self.histogram.fill(0);
        let mut inliers = 0;
        for i in 0..self.ransac.subset.len() {
            let share = error2_px2(&self.ransac.subset, i, pose, camera).sqrt() / threshold;
            if share < 1.0 {
                self.histogram[(share * BINS as f64) as usize] += 1;
                inliers += 1;
            }
        }
        // The median length of a 2D Gaussian error is 1.1774 standard deviations of one coordinate.
        let sigma = median_bin(&self.histogram, inliers) * threshold / 1.1774;
        (self.config.tukey_width * sigma).clamp(0.1 * threshold, 2.0 * threshold)
    }

    fn judge(&self, pose: &Pose, camera: &Intrinsics) -> Judged {
        let (mut inliers, mut sum, mut behind) = (0, 0.0, 0);
        for i in 0..self.points.len() {
            let error2 = error2_px2(&self.points, i, pose, camera);
            if error2 < self.config.threshold_px.powi(2) {
                inliers += 1;
                sum += error2;
            }
            behind += usize::from(error2.is_infinite());
        }
        let rms_px = if inliers > 0 { (sum / inliers as f64).sqrt() } else { 0.0 };
        Judged { inliers, rms_px, share_behind: behind as f64 / self.points.len() as f64 }
    }

    /// The covariance of a good pose, or what is wrong with a bad one.
    fn check(
        &self,
        pose: &Pose,
        camera: &Intrinsics,
        width_px: f64,
        judged: &Judged,
    ) -> Result<Matrix6<f64>, PnpStatus> {
        if judged.share_behind > MAX_SHARE_BEHIND {
            return Err(PnpStatus::BehindCamera { share: judged.share_behind });
        }
        let share = (self.config.min_inlier_ratio * self.points.len() as f64).ceil() as usize;
        let need = self.config.min_inliers.max(share);
        if judged.inliers < need {
            return Err(PnpStatus::TooFewInliers { got: judged.inliers, need });
        }
        let [longest, second, _] = self.ransac.subset.extents_m();
        let open = PnpStatus::Degenerate { rotation_std_rad: f64::INFINITY };
        if second <= LINEAR * longest {
            return Err(open);
        }
        let n = judged.inliers as f64;
        let shared = self.config.points_per_independent_error;
        let found = covariance(&self.points, camera, pose, width_px, n, shared).ok_or(open)?;
        let rotation_std_rad = found.fixed_view::<3, 3>(3, 3).symmetric_eigenvalues().max().max(0.0).sqrt();
        if rotation_std_rad > self.config.max_rotation_std_rad {
            return Err(PnpStatus::Degenerate { rotation_std_rad });
        }
        Ok(found)
    }
}

/// Bins of the histogram of errors up to the threshold.
const BINS: usize = 512;

/// The middle of the bin that holds the median, in 0..1; `count` is the sum of the bins.
fn median_bin(histogram: &[u32], count: u32) -> f64 {
    let mut below = 0;
    for (i, bin) in histogram.iter().enumerate() {
        below += bin;
        if 2 * below > count {
            return (i as f64 + 0.5) / histogram.len() as f64;
        }
    }
    1.0
}

/// Squared reprojection error of point `i`, pixels^2; infinite behind the camera.
fn error2_px2(points: &PointSet, i: usize, pose: &Pose, camera: &Intrinsics) -> f64 {
    let p = pose.rotation * points.point(i) + pose.translation.vector;
    if p.z <= Z_MIN_M {
        return f64::INFINITY;
    }
    let [u, v] = points.pixel(i);
    (camera.fx * p.x / p.z + camera.cx - u).powi(2) + (camera.fy * p.y / p.z + camera.cy - v).powi(2)
}

fn is_finite(pose: &Pose, k: &Intrinsics) -> bool {
    let pose_finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
    pose_finite && k.to_row_major().iter().all(|v| v.is_finite()) && k.fx > 0.0 && k.fy > 0.0
}

fn success(pose: &Pose, covariance: &Matrix6<f64>, judged: &Judged, used: usize) -> PnpResult {
    PnpResult {
        camera_from_object: *pose,
        covariance: std::array::from_fn(|i| covariance[(i / 6, i % 6)]),
        inlier_ratio: judged.inliers as f64 / used as f64,
        inliers: judged.inliers,
        rms_px: judged.rms_px,
        status: PnpStatus::Ok,
    }
}

fn failure(initial: &Pose, judged: Option<&Judged>, used: usize, status: PnpStatus) -> PnpResult {
    let unknown = Matrix6::identity() * UNKNOWN_VARIANCE;
    let none = Judged { inliers: 0, rms_px: 0.0, share_behind: 0.0 };
    PnpResult { status, ..success(initial, &unknown, judged.unwrap_or(&none), used.max(1)) }
}
