use crate::InstanceErrors;
use pseudoflow_metrics::{CHI2_95_OF_3, CHI2_95_OF_6, recall, spearman};
use serde::{Deserialize, Serialize};

const BINS: usize = 10;

/// Whether a confidence of 0.7 is right seven times in ten.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConfidenceCalibration {
    /// Estimates with a confidence.
    pub n: usize,
    /// Spearman's rank correlation of the confidence with the accuracy (falling ADD(-S) in diameters): 1 is best, 0 says
    /// nothing.
    pub rank_correlation: Option<f64>,
    /// Mean distance between claimed and observed share over the bins, weighted by their counts (expected calibration
    /// error; Guo et al., ICML 2017, eq. 3).
    pub calibration_error: f64,
    /// Mean squared distance between confidence and outcome (Brier score); a quarter is what 0.5 for everything gets.
    pub brier: f64,
    /// Ten bins of equal width; empty ones are left out.
    pub bins: Vec<ConfidenceBin>,
}

/// Estimates whose confidence lies in a tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConfidenceBin {
    /// Estimates.
    pub n: usize,
    /// Their mean confidence.
    pub claimed: f64,
    /// The share of them with ADD(-S) below a tenth of the diameter.
    pub observed: f64,
}

impl ConfidenceCalibration {
    pub(super) fn of(instances: &[&InstanceErrors]) -> Option<Self> {
        let claims: Vec<(f64, bool, f64)> = instances
            .iter()
            .filter_map(|i| Some((i.confidence?, i.add_s_correct, i.add_s_of_diameter.unwrap_or(f64::INFINITY))))
            .collect();
        if claims.is_empty() {
            return None;
        }
        let n = claims.len();
        let outcome = |right: bool| f64::from(u8::from(right));
        let bins: Vec<ConfidenceBin> = (0..BINS).filter_map(|bin| confidence_bin(&claims, bin)).collect();
        let off = |b: &ConfidenceBin| b.n as f64 * (b.claimed - b.observed).abs();
        Some(Self {
            n,
            rank_correlation: spearman(&claims.iter().map(|(c, _, e)| (*c, -e)).collect::<Vec<_>>()),
            calibration_error: bins.iter().map(off).sum::<f64>() / n as f64,
            brier: claims.iter().map(|(c, right, _)| (c - outcome(*right)).powi(2)).sum::<f64>() / n as f64,
            bins,
        })
    }
}

fn confidence_bin(claims: &[(f64, bool, f64)], bin: usize) -> Option<ConfidenceBin> {
    let of = |confidence: f64| ((confidence * BINS as f64) as usize).min(BINS - 1);
    let these: Vec<&(f64, bool, f64)> = claims.iter().filter(|(confidence, ..)| of(*confidence) == bin).collect();
    let n = these.len();
    (n > 0).then(|| ConfidenceBin {
        n,
        claimed: these.iter().map(|(confidence, ..)| confidence).sum::<f64>() / n as f64,
        observed: recall(these.iter().filter(|(_, right, _)| *right).count(), n),
    })
}

/// How often the truth lies within the 95 % ellipsoid of the covariance: 0.95 is right, less is boasting.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Estimates with a covariance.
    pub n: usize,
    /// Of the whole covariance (6 degrees of freedom).
    pub pose: f64,
    /// Of its translation alone (3).
    pub translation: f64,
    /// Of its rotation alone (3).
    pub rotation: f64,
    /// The same of the whole, over the estimates that are right (ADD(-S) below a tenth of the diameter).
    pub pose_of_right: f64,
}

impl Coverage {
    pub(super) fn of(instances: &[&InstanceErrors]) -> Option<Self> {
        let all: Vec<(&[f64; 3], bool)> =
            instances.iter().filter_map(|i| Some((i.mahalanobis2.as_ref()?, i.add_s_correct))).collect();
        let share = |which: usize, limit: f64, only_right: bool| {
            let these: Vec<_> = all.iter().filter(|(_, right)| *right || !only_right).collect();
            recall(these.iter().filter(|(d, _)| d[which] <= limit).count(), these.len())
        };
        (!all.is_empty()).then(|| Self {
            n: all.len(),
            pose: share(0, CHI2_95_OF_6, false),
            translation: share(1, CHI2_95_OF_3, false),
            rotation: share(2, CHI2_95_OF_3, false),
            pose_of_right: share(0, CHI2_95_OF_6, true),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(confidence: f64, add: f64) -> InstanceErrors {
        InstanceErrors {
            confidence: Some(confidence),
            add_s_of_diameter: Some(add),
            add_s_correct: add < 0.1,
            ..Default::default()
        }
    }

    #[test]
    fn an_honest_confidence_has_no_error_and_a_boast_has() {
        let honest: Vec<InstanceErrors> = (0..100).map(|i| claim(0.75, if i % 4 == 0 { 0.5 } else { 0.01 })).collect();
        let found = ConfidenceCalibration::of(&honest.iter().collect::<Vec<_>>()).unwrap();
        assert!(found.calibration_error < 1e-12 && (found.brier - 0.1875).abs() < 1e-12);
        assert_eq!((found.bins.len(), found.bins[0].n, found.rank_correlation), (1, 100, None));
        let boast = [claim(1.0, 0.4), claim(0.9, 0.05), claim(0.95, 0.3)];
        let found = ConfidenceCalibration::of(&boast.iter().collect::<Vec<_>>()).unwrap();
        assert!(found.calibration_error > 0.5 && found.rank_correlation.unwrap() < -0.9, "{found:?}");
        assert_eq!(ConfidenceCalibration::of(&[&InstanceErrors::default()]), None);
    }

    #[test]
    fn coverage_is_the_share_within_the_quantile() {
        let of =
            |d: [f64; 3], right| InstanceErrors { mahalanobis2: Some(d), add_s_correct: right, ..Default::default() };
        let all = [of([12.0, 1.0, 9.0], true), of([13.0, 7.0, 2.0], false)];
        let found = Coverage::of(&all.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!((found.pose, found.translation, found.rotation, found.pose_of_right), (0.5, 1.0, 0.5, 1.0));
    }
}
