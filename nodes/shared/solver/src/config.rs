use crate::PnpError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What makes a pose from a random sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MinimalSolver {
    /// Three points, up to four poses. At 70 % outliers 1 sample in 37 is clean, against 1 in 411 for five points, and a
    /// sample costs about a twentieth of EPnP's: the default.
    #[default]
    P3p,
    /// Five points and EPnP, as in the paper and in OpenCV: for comparison.
    Epnp,
}

/// Settings of [`crate::Solver`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PnpConfig {
    /// A correspondence is an inlier up to this reprojection error, crop pixels. The paper's 3 px belong to a crop
    /// of 256 px: scale with S / 256.
    pub threshold_px: f64,
    /// RANSAC stops when a better pose would have been sampled with this probability.
    pub confidence: f64,
    /// RANSAC draws at most this many samples.
    pub max_iterations: usize,
    /// Hypotheses are scored on at most this many points, drawn evenly over the input.
    pub max_ransac_points: usize,
    /// The last refinement uses at most this many points, taken evenly from the input.
    pub max_refine_points: usize,
    /// What makes a pose from a sample.
    pub minimal: MinimalSolver,
    /// Fewer inliers than this is a failure. At least 6.
    pub min_inliers: usize,
    /// A smaller share of inliers than this is a failure, 0..1.
    pub min_inlier_ratio: f64,
    /// A larger standard deviation of the rotation about any axis is a failure (`Degenerate`), radians.
    pub max_rotation_std_rad: f64,
    /// Width of Tukey's loss in robust standard deviations of one pixel coordinate. 7 keeps 98 % of the efficiency
    /// of least squares under Gaussian noise.
    pub tukey_width: f64,
    /// How many neighbouring correspondences share one error. The covariance is multiplied by it. 1 for independent
    /// noise; a flow network that works on a coarse grid is nearer to the area of one coarse cell.
    pub points_per_independent_error: f64,
}

impl Default for PnpConfig {
    fn default() -> Self {
        Self {
            threshold_px: 3.0,
            confidence: 0.999,
            max_iterations: 1000,
            max_ransac_points: 2000,
            max_refine_points: 65_536,
            minimal: MinimalSolver::P3p,
            min_inliers: 12,
            min_inlier_ratio: 0.05,
            max_rotation_std_rad: 0.35,
            tukey_width: 7.0,
            points_per_independent_error: 1.0,
        }
    }
}

impl PnpConfig {
    /// The settings with a pixel threshold scaled from a crop of 256 px to one of `size_px`.
    #[must_use]
    pub fn scaled_to(mut self, size_px: usize) -> Self {
        self.threshold_px *= size_px as f64 / 256.0;
        self
    }

    /// Checks every range.
    ///
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), PnpError> {
        let checks = [
            ("threshold_px", self.threshold_px, self.threshold_px > 0.0, "positive"),
            ("confidence", self.confidence, (0.0..1.0).contains(&self.confidence), "in 0..1"),
            ("max_ransac_points", self.max_ransac_points as f64, self.max_ransac_points >= 64, "at least 64"),
            ("max_refine_points", self.max_refine_points as f64, self.max_refine_points >= 64, "at least 64"),
            ("min_inliers", self.min_inliers as f64, self.min_inliers >= 6, "at least 6"),
            ("min_inlier_ratio", self.min_inlier_ratio, (0.0..=1.0).contains(&self.min_inlier_ratio), "in 0..1"),
            ("max_rotation_std_rad", self.max_rotation_std_rad, self.max_rotation_std_rad > 0.0, "positive"),
            ("tukey_width", self.tukey_width, self.tukey_width >= 2.0, "at least 2"),
            (
                "points_per_independent_error",
                self.points_per_independent_error,
                self.points_per_independent_error >= 1.0,
                "at least 1",
            ),
        ];
        match checks.into_iter().find(|(_, value, good, _)| !good || !value.is_finite()) {
            Some((name, got, _, must)) => Err(PnpError::Setting { name, got, must }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_out_of_range_is_named() {
        assert_eq!(PnpConfig::default().validate(), Ok(()));
        let bad = PnpConfig { threshold_px: f64::NAN, ..PnpConfig::default() };
        assert!(matches!(bad.validate(), Err(PnpError::Setting { name: "threshold_px", .. })));
        let bad = PnpConfig { min_inliers: 2, ..PnpConfig::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("min_inliers"));
    }

    #[test]
    fn unknown_keys_are_refused() {
        assert!(serde_json::from_str::<PnpConfig>(r#"{"treshold_px": 3}"#).is_err());
        assert_eq!(serde_json::from_str::<PnpConfig>(r#"{"threshold_px": 1.5}"#).unwrap().threshold_px, 1.5);
    }
}
