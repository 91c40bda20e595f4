use super::Evidence;
use pseudoflow_solver::{PnpError, PnpResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Limits of the gate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GateConfig {
    /// Smallest share of inliers, 0..1.
    pub min_inlier_ratio: f64,
    /// Blocks across the crop for the photometric comparison: 16 give 8 x 8 pixels at 128.
    pub blocks_across: usize,
    /// The photometric comparison counts from this many textured blocks on; below it is left out.
    pub min_blocks: usize,
    /// The photometric comparison can refuse only where the rendering correlates at least this much with the crop at one
    /// of both poses, 0..1: below it the mesh's texture is not what the camera sees, and the contour decides.
    pub informative_correlation: f64,
    /// Smallest change of the photometric agreement, -2..2. Slightly negative: equal is not worse.
    pub min_photometric_gain: f64,
    /// Smallest agreement of flow and pictures, 0..2: the inlier ratio plus the photometric and the silhouette gain, each
    /// gain taken between 0 and 0.5. A pose that few inliers carry has to show its gain in the picture.
    pub min_agreement: f64,
    /// Smallest change of the contrast across the contour where the texture says nothing, -1..1.
    pub min_silhouette_gain: f64,
    /// Largest mean displacement of the surface in the crop, as a share of its side.
    pub max_displacement: f64,
    /// Largest angle between the poses, radians.
    pub max_rotation_rad: f64,
    /// Smallest share of the surface that stays inside the crop, 0..1.
    pub min_share_in_view: f64,
}

impl Default for GateConfig {
    fn default() -> Self {
        Self {
            min_inlier_ratio: 0.2,
            blocks_across: 16,
            min_blocks: 4,
            informative_correlation: 0.15,
            min_photometric_gain: -0.05,
            min_agreement: 0.775,
            min_silhouette_gain: -0.1,
            max_displacement: 0.3,
            max_rotation_rad: 0.9,
            min_share_in_view: 0.5,
        }
    }
}

/// Whether the refined pose replaces the initial one, and the test that decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// `true`: use the refined pose. `false`: keep the initial one.
    pub accept: bool,
    /// The first test that failed, or `Passed`.
    pub reason: GateReason,
}

/// Outcome of the tests, in their order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GateReason {
    /// All tests passed.
    Passed,
    /// PnP itself failed; its status says why.
    PnpFailed,
    /// Too few inliers: found, limit.
    InlierRatio(f64, f64),
    /// The object moved too far: share of the crop, limit.
    Displacement(f64, f64),
    /// The object turned too far: radians, limit.
    Rotation(f64, f64),
    /// Too little of the object stays in the crop: share, limit.
    InView(f64, f64),
    /// The rendering agrees less with the crop than before: gain, limit.
    Photometric(f64, f64),
    /// Few inliers, and no gain in the picture that makes up for it: agreement, limit.
    Agreement(f64, f64),
    /// The contour lies on less contrast than before: gain, limit.
    Silhouette(f64, f64),
}

impl fmt::Display for GateReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Passed => write!(f, "passed"),
            Self::PnpFailed => write!(f, "PnP failed"),
            Self::InlierRatio(got, limit) => write!(f, "inlier ratio {got:.3} is under {limit:.3}"),
            Self::Displacement(got, limit) => write!(f, "displacement of {got:.3} crop sides is over {limit:.3}"),
            Self::Rotation(got, limit) => write!(f, "rotation of {got:.3} rad is over {limit:.3}"),
            Self::InView(got, limit) => write!(f, "share in view {got:.3} is under {limit:.3}"),
            Self::Photometric(got, limit) => write!(f, "photometric gain {got:.4} is under {limit:.4}"),
            Self::Agreement(got, limit) => write!(f, "agreement of flow and picture {got:.3} is under {limit:.3}"),
            Self::Silhouette(got, limit) => write!(f, "silhouette gain {got:.4} is under {limit:.4}"),
        }
    }
}

impl GateConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), PnpError> {
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let checks = [
            ("min_inlier_ratio", self.min_inlier_ratio, share(self.min_inlier_ratio), "in 0..1"),
            ("blocks_across", self.blocks_across as f64, self.blocks_across > 0, "positive"),
            ("min_photometric_gain", self.min_photometric_gain, self.min_photometric_gain.abs() <= 2.0, "in -2..2"),
            ("informative_correlation", self.informative_correlation, share(self.informative_correlation), "in 0..1"),
            ("min_agreement", self.min_agreement, (0.0..=2.0).contains(&self.min_agreement), "in 0..2"),
            ("min_silhouette_gain", self.min_silhouette_gain, self.min_silhouette_gain.abs() <= 1.0, "in -1..1"),
            ("max_displacement", self.max_displacement, self.max_displacement > 0.0, "positive"),
            ("max_rotation_rad", self.max_rotation_rad, self.max_rotation_rad > 0.0, "positive"),
            ("min_share_in_view", self.min_share_in_view, share(self.min_share_in_view), "in 0..1"),
        ];
        match checks.into_iter().find(|(.., good, _)| !good) {
            Some((name, got, _, must)) => Err(PnpError::Setting { name, got, must }),
            None => Ok(()),
        }
    }

    /// Accepts the refined pose of `result` or keeps the initial one. `size_px` is the side of the crop.
    #[must_use]
    pub fn decide(&self, result: &PnpResult, evidence: &Evidence, size_px: usize) -> Decision {
        let reason = self.first_failure(result, evidence, size_px);
        Decision { accept: reason.is_none(), reason: reason.unwrap_or(GateReason::Passed) }
    }

    fn first_failure(&self, result: &PnpResult, evidence: &Evidence, size_px: usize) -> Option<GateReason> {
        if !result.status.is_ok() {
            return Some(GateReason::PnpFailed);
        }
        let displacement = evidence.displacement_px / size_px as f64;
        let photometric = evidence.photometric_refined - evidence.photometric_initial;
        let silhouette = evidence.silhouette_refined - evidence.silhouette_initial;
        let at_least = |value: f64, limit: f64, reason: fn(f64, f64) -> GateReason| {
            // A NaN fails.
            let passed = value >= limit;
            (!passed).then(|| reason(value, limit))
        };
        let at_most = |value: f64, limit: f64, reason: fn(f64, f64) -> GateReason| {
            let passed = value <= limit;
            (!passed).then(|| reason(value, limit))
        };
        let textured = evidence.blocks >= self.min_blocks;
        let best = evidence.photometric_initial.max(evidence.photometric_refined);
        let informative = textured && best >= self.informative_correlation;
        let seen = if textured { photometric.clamp(0.0, 0.5) } else { 0.0 };
        let agreement = result.inlier_ratio + seen + silhouette.clamp(0.0, 0.5);
        let pictures = || {
            if informative {
                at_least(photometric, self.min_photometric_gain, GateReason::Photometric)
            } else {
                at_least(silhouette, self.min_silhouette_gain, GateReason::Silhouette)
            }
        };
        at_least(result.inlier_ratio, self.min_inlier_ratio, GateReason::InlierRatio)
            .or_else(|| at_most(displacement, self.max_displacement, GateReason::Displacement))
            .or_else(|| at_most(evidence.rotation_rad, self.max_rotation_rad, GateReason::Rotation))
            .or_else(|| at_least(evidence.share_in_view, self.min_share_in_view, GateReason::InView))
            .or_else(pictures)
            .or_else(|| at_least(agreement, self.min_agreement, GateReason::Agreement))
    }
}
