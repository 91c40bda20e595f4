//! How well a pose explains correspondences: truncated squared reprojection error (MSAC; Torr and Zisserman 2000).

use crate::lanes::{Singles, with_avx2};
use crate::normal::Z_MIN_M;
use crate::points::PointSet;
use pseudoflow_geometry::{Intrinsics, Pose};
use std::ops::Range;

/// Points between two looks at whether a hypothesis can still win.
const STEP: usize = 128;

/// The score of a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Score {
    /// Sum of `min(r^2 / threshold^2, 1)`: the lower the better.
    pub(crate) cost: f64,
    /// Correspondences within the threshold.
    pub(crate) inliers: f64,
}

/// Scores `pose`, or gives up (`None`) when it can't or most likely won't beat `best`.
///
/// A cost can only grow, so passing `best.cost` is final. In addition the mean over the first points may not exceed
/// the best pose's mean by three standard deviations (each term lies in 0..1, so its deviation is at most 1/2).
pub(crate) fn score_against(
    points: &PointSet,
    camera: &Intrinsics,
    pose: &Pose,
    threshold_px: f64,
    best: &Score,
) -> Option<Score> {
    let padded = points.x.len();
    let best_mean = best.cost / padded as f64;
    let mut sum = Score { cost: 0.0, inliers: 0.0 };
    let mut start = 0;
    while start < padded {
        let end = (start + STEP).min(padded);
        let part = score_range(points, start..end, camera, pose, threshold_px);
        sum = Score { cost: sum.cost + part.cost, inliers: sum.inliers + part.inliers };
        let seen = end as f64;
        if sum.cost >= best.cost || (end < padded && sum.cost / seen > best_mean + 1.5 / seen.sqrt()) {
            return None;
        }
        start = end;
    }
    Some(sum)
}

/// Scores `pose` on all points. The padding adds the same to every pose.
pub(crate) fn score(points: &PointSet, camera: &Intrinsics, pose: &Pose, threshold_px: f64) -> Score {
    score_range(points, 0..points.x.len(), camera, pose, threshold_px)
}

fn score_range(points: &PointSet, range: Range<usize>, camera: &Intrinsics, pose: &Pose, threshold_px: f64) -> Score {
    with_avx2!(score_lanes(
        points: &PointSet, range: Range<usize>, camera: &Intrinsics, pose: &Pose, threshold_px: f64
    ) -> Score)
}

#[inline(always)]
fn score_lanes(points: &PointSet, range: Range<usize>, camera: &Intrinsics, pose: &Pose, threshold_px: f64) -> Score {
    let rows = rows_of(camera, pose, threshold_px);
    let s = Singles::splat;
    let (cx, cy, unit) = (s(camera.cx), s(camera.cy), s(1.0 / threshold_px));
    let (z_min, one) = (s(Z_MIN_M), s(1.0));
    let (mut gain, mut inliers) = (Singles::ZERO, Singles::ZERO);
    for block in range.start / LANES..range.end / LANES {
        let (x, y, z) = (load(&points.x, block), load(&points.y, block), load(&points.z, block));
        let (u, v) = (load(&points.u, block), load(&points.v, block));
        let mut seen = [Singles::ZERO; 3];
        for i in 0..3 {
            seen[i] = rows[i][0] * x + rows[i][1] * y + rows[i][2] * z + rows[i][3];
        }
        let inverse = seen[2].max(z_min).recip();
        let du = seen[0] * inverse - (u - cx) * unit;
        let dv = seen[1] * inverse - (v - cy) * unit;
        let left = (one - (du * du + dv * dv)).max(Singles::ZERO).where_above(seen[2], z_min);
        gain += left;
        inliers += one.where_above(left, Singles::ZERO);
    }
    Score { cost: (range.len() as f64) - gain.sum(), inliers: inliers.sum() }
}

/// Points of a block.
const LANES: usize = 16;

#[inline(always)]
fn load(plane: &[f32], block: usize) -> Singles {
    Singles::load(&plane.as_chunks().0[block])
}

/// The rows of the pose. The focal lengths and the threshold are folded in: residuals come out in thresholds.
fn rows_of(camera: &Intrinsics, pose: &Pose, threshold_px: f64) -> [[Singles; 4]; 3] {
    let (r, t) = (pose.rotation.to_rotation_matrix(), pose.translation.vector);
    let factors = [camera.fx / threshold_px, camera.fy / threshold_px, 1.0];
    std::array::from_fn(|i| std::array::from_fn(|j| Singles::splat(factors[i] * if j < 3 { r[(i, j)] } else { t[i] })))
}
