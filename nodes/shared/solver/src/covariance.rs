use crate::normal::sandwich;
use crate::points::PointSet;
use nalgebra::Matrix6;
use pseudoflow_geometry::{Intrinsics, Pose};

/// Covariance of the pose that minimises Tukey's loss: `A^-1 B A^-1`, the sandwich of M-estimation (Huber 1981,
/// section 6.3), times 2n / (2n - 6) for the six fitted numbers and times the points that share one error.
///
/// The noise level comes from the residuals themselves, which may differ in size from point to point. Order and
/// axes: see [`crate::PnpResult::covariance`]. `None` when the points do not determine the pose.
pub(crate) fn covariance(
    points: &PointSet,
    camera: &Intrinsics,
    pose: &Pose,
    width_px: f64,
    inliers: f64,
    points_per_error: f64,
) -> Option<Matrix6<f64>> {
    let sums = sandwich(points, camera, pose, width_px);
    let inverse = scaled_inverse(&sums.bread)?;
    let correction = inliers / (inliers - 3.0).max(1.0) * points_per_error;
    let out = inverse * sums.filling * inverse * correction;
    let symmetric = (out + out.transpose()) * 0.5;
    symmetric.iter().all(|v| v.is_finite()).then_some(symmetric)
}

/// Inverse of a positive definite matrix whose entries have different units: scaled to a unit diagonal first.
/// `None` when it is singular to working precision.
fn scaled_inverse(matrix: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let diagonal = matrix.diagonal();
    if !diagonal.iter().all(|d| *d > 0.0 && d.is_finite()) {
        return None;
    }
    let scale = Matrix6::from_diagonal(&diagonal.map(|d| 1.0 / d.sqrt()));
    let unit = scale * matrix * scale;
    let smallest = unit.symmetric_eigenvalues().min();
    if smallest < 1e-12 {
        return None;
    }
    Some(scale * unit.cholesky()?.inverse() * scale)
}
