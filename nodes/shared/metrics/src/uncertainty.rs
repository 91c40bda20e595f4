//! What an estimate claims about itself, held against the truth: its covariance and its confidence.

use crate::MatrixPose;
use nalgebra::{DMatrix, DVector, Vector6};

/// The 95 % quantile of the chi-squared distribution with 3 degrees of freedom.
pub const CHI2_95_OF_3: f64 = 7.814_727_903_251_18;
/// The 95 % quantile of the chi-squared distribution with 6 degrees of freedom.
pub const CHI2_95_OF_6: f64 = 12.591_587_243_743_98;

/// Squared Mahalanobis distances of a pose error, `e^T C^-1 e`: of the whole covariance (6 degrees of freedom), and of its
/// translation and rotation blocks alone (3 each).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mahalanobis2 {
    /// Translation and rotation together.
    pub pose: f64,
    /// Translation.
    pub translation: f64,
    /// Rotation.
    pub rotation: f64,
}

/// How far the truth is from an estimate, in the coordinates of its covariance: translation (m), then rotation (rad) about
/// the camera's fixed axes, `t_gt = t_est + dt`, `R_gt = exp(dphi) R_est`.
#[must_use]
pub fn pose_error(est: &MatrixPose, gt: &MatrixPose) -> Vector6<f64> {
    let dt = gt.translation_m() - est.translation_m();
    let dphi = (gt.pose().rotation * est.pose().rotation.inverse()).scaled_axis();
    Vector6::new(dt.x, dt.y, dt.z, dphi.x, dphi.y, dphi.z)
}

/// The distances of `error` ([`pose_error`]) under a row-major 6 x 6 covariance in m and rad. `None` when the covariance
/// (or a block of it) is not positive definite, as one of zeros, which says that nothing is known.
#[must_use]
pub fn mahalanobis2(error: &Vector6<f64>, covariance: &[f64; 36]) -> Option<Mahalanobis2> {
    Some(Mahalanobis2 {
        pose: of_block(error, covariance, 0..6)?,
        translation: of_block(error, covariance, 0..3)?,
        rotation: of_block(error, covariance, 3..6)?,
    })
}

/// The block is scaled to a unit diagonal before it is inverted: its entries have different units.
fn of_block(error: &Vector6<f64>, covariance: &[f64; 36], range: std::ops::Range<usize>) -> Option<f64> {
    let (start, n) = (range.start, range.len());
    let at = |i: usize, j: usize| covariance[6 * (start + i) + start + j];
    let sigma: Vec<f64> = (0..n).map(|i| at(i, i).sqrt()).collect();
    if !sigma.iter().all(|s| *s > 0.0 && s.is_finite()) {
        return None;
    }
    let correlation = DMatrix::from_fn(n, n, |i, j| at(i, j) / (sigma[i] * sigma[j]));
    let scaled = DVector::from_fn(n, |i, _| error[start + i] / sigma[i]);
    let distance2 = scaled.dot(&correlation.cholesky()?.solve(&scaled));
    distance2.is_finite().then_some(distance2)
}

/// Spearman's rank correlation, -1 to 1; equal values share the mean of their ranks. `None` for fewer than three pairs, or
/// when one side is constant or has a NaN.
#[must_use]
pub fn spearman(pairs: &[(f64, f64)]) -> Option<f64> {
    if pairs.len() < 3 || pairs.iter().any(|(a, b)| a.is_nan() || b.is_nan()) {
        return None;
    }
    let (a, b): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    pearson(&ranks(&a), &ranks(&b))
}

/// The rank of each value, counted from 1.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut below = 0;
    for equal in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let rank = below as f64 + (equal.len() as f64 + 1.0) / 2.0;
        equal.iter().for_each(|i| ranks[*i] = rank);
        below += equal.len();
    }
    ranks
}

fn pearson(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let [mut aa, mut bb, mut ab] = [0.0; 3];
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        (aa, bb, ab) = (aa + a * a, bb + b * b, ab + a * b);
    }
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_geometry::{Pose, exp_se3};

    fn diagonal(sigma: [f64; 6]) -> [f64; 36] {
        std::array::from_fn(|i| if i / 6 == i % 6 { sigma[i / 6].powi(2) } else { 0.0 })
    }

    #[test]
    fn the_error_is_what_leads_from_the_estimate_to_the_truth() {
        let est = exp_se3(&Vector6::new(0.1, -0.2, 0.8, 0.4, -0.3, 0.2));
        let error = Vector6::new(0.01, 0.02, -0.03, 0.1, -0.05, 0.02);
        let turn = Pose::rotation(error.fixed_rows::<3>(3).into());
        let moved = est.translation.vector + error.fixed_rows::<3>(0);
        let gt = Pose::from_parts(moved.into(), turn.rotation * est.rotation);
        assert!((pose_error(&est.into(), &gt.into()) - error).norm() < 1e-12);
    }

    #[test]
    fn a_diagonal_covariance_counts_sigmas() {
        let error = Vector6::new(0.01, 0.0, 0.04, 0.0, 0.1, 0.0);
        let found = mahalanobis2(&error, &diagonal([0.01, 0.01, 0.02, 0.1, 0.05, 0.1])).unwrap();
        assert!((found.translation - 5.0).abs() < 1e-9 && (found.rotation - 4.0).abs() < 1e-9);
        assert!((found.pose - 9.0).abs() < 1e-9);
        assert_eq!(mahalanobis2(&error, &[0.0; 36]), None);
    }

    #[test]
    fn correlated_errors_are_cheap_along_their_direction() {
        let mut covariance = diagonal([0.01, 0.01, 0.01, 1.0, 1.0, 1.0]);
        (covariance[1], covariance[6]) = (0.99e-4, 0.99e-4);
        let distance =
            |x: f64, y: f64| mahalanobis2(&Vector6::new(x, y, 0.0, 0.0, 0.0, 0.0), &covariance).unwrap().translation;
        assert!(distance(0.01, 0.01) < 1.1 && distance(0.01, -0.01) > 100.0);
    }

    #[test]
    fn ranks_decide_and_ties_share() {
        let rising: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), f64::from(i).exp())).collect();
        assert!((spearman(&rising).unwrap() - 1.0).abs() < 1e-12);
        let falling: Vec<(f64, f64)> = rising.iter().map(|(a, b)| (*a, -b)).collect();
        assert!((spearman(&falling).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(ranks(&[2.0, 1.0, 2.0, 3.0]), [2.5, 1.0, 2.5, 4.0]);
        // scipy.stats.spearmanr([1, 2, 2, 4, 5], [2, 1, 3, 3, 9]).statistic
        let tied = [(1.0, 2.0), (2.0, 1.0), (2.0, 3.0), (4.0, 3.0), (5.0, 9.0)];
        assert!((spearman(&tied).unwrap() - 0.763_157_894_736_842).abs() < 1e-9);
        assert_eq!(spearman(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(spearman(&rising[..2]), None);
    }
}
