use super::{Evidence, GateModel, GateModelError, Stage, StageModel, Verdict};
use pseudoflow_solver::{PnpError, PnpResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::PathBuf;

/// When a refined pose replaces the initial one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GateConfig {
    /// The learnt model, a file that `pseudoflow calibrate` wrote; without one that of the binary (`config/gate.yaml`).
    pub model: Option<PathBuf>,
    /// Smallest probability, by the model, that the refined pose is better than the initial one, 0..1.
    pub min_better: f64,
    /// Blocks across the crop for the photometric comparison: 16 give 8 x 8 pixels at 128.
    pub blocks_across: usize,
    /// Largest mean displacement of the surface in the crop, as a share of its side: no model was fitted beyond.
    pub max_displacement: f64,
    /// Largest angle between the poses, radians: no model was fitted beyond.
    pub max_rotation_rad: f64,
    /// Smallest share of the surface that stays inside the crop, 0..1.
    pub min_share_in_view: f64,
}

impl Default for GateConfig {
    fn default() -> Self {
        Self {
            model: None,
            min_better: 0.5,
            blocks_across: 16,
            max_displacement: 0.3,
            max_rotation_rad: 0.9,
            min_share_in_view: 0.5,
        }
    }
}

/// Whether the refined pose replaces the initial one, and why.
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
    /// The object moved too far: share of the crop, limit.
    Displacement(f64, f64),
    /// The object turned too far: radians, limit.
    Rotation(f64, f64),
    /// Too little of the object stays in the crop: share, limit.
    InView(f64, f64),
    /// Probably not better than before: probability, limit.
    Better(f64, f64),
}

impl fmt::Display for GateReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Passed => write!(f, "passed"),
            Self::PnpFailed => write!(f, "PnP failed"),
            Self::Displacement(got, limit) => write!(f, "displacement of {got:.3} crop sides is over {limit:.3}"),
            Self::Rotation(got, limit) => write!(f, "rotation of {got:.3} rad is over {limit:.3}"),
            Self::InView(got, limit) => write!(f, "share in view {got:.3} is under {limit:.3}"),
            Self::Better(got, limit) => write!(f, "better with a probability of {got:.3}, under {limit:.3}"),
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
            ("min_better", self.min_better, share(self.min_better), "in 0..1"),
            ("blocks_across", self.blocks_across as f64, self.blocks_across > 0, "positive"),
            ("max_displacement", self.max_displacement, self.max_displacement > 0.0, "positive"),
            ("max_rotation_rad", self.max_rotation_rad, self.max_rotation_rad > 0.0, "positive"),
            ("min_share_in_view", self.min_share_in_view, share(self.min_share_in_view), "in 0..1"),
        ];
        match checks.into_iter().find(|(.., good, _)| !good) {
            Some((name, got, _, must)) => Err(PnpError::Setting { name, got, must }),
            None => Ok(()),
        }
    }

    /// The model that these settings name, of one stage.
    ///
    /// # Errors
    /// When the file cannot be read, is no such model or does not know the stage.
    pub fn stage_model(&self, stage: Stage) -> Result<StageModel, GateModelError> {
        self.validate()?;
        Ok(GateModel::load(self.model.as_deref())?.stage(stage)?.clone())
    }

    /// Accepts the refined pose of `result` or keeps the initial one. `size_px` is the side of the crop.
    #[must_use]
    pub fn decide(&self, result: &PnpResult, evidence: &Evidence, verdict: &Verdict, size_px: usize) -> Decision {
        let reason = self.first_failure(result, evidence, verdict, size_px);
        Decision { accept: reason.is_none(), reason: reason.unwrap_or(GateReason::Passed) }
    }

    fn first_failure(
        &self,
        result: &PnpResult,
        evidence: &Evidence,
        verdict: &Verdict,
        size_px: usize,
    ) -> Option<GateReason> {
        if !result.status.is_ok() {
            return Some(GateReason::PnpFailed);
        }
        let displacement = evidence.displacement_px / size_px as f64;
        // A NaN fails each of them.
        let fails = |holds: bool, reason: GateReason| (!holds).then_some(reason);
        fails(displacement <= self.max_displacement, GateReason::Displacement(displacement, self.max_displacement))
            .or_else(|| {
                let turned = evidence.rotation_rad;
                fails(turned <= self.max_rotation_rad, GateReason::Rotation(turned, self.max_rotation_rad))
            })
            .or_else(|| {
                let share = evidence.share_in_view;
                fails(share >= self.min_share_in_view, GateReason::InView(share, self.min_share_in_view))
            })
            .or_else(|| fails(verdict.better >= self.min_better, GateReason::Better(verdict.better, self.min_better)))
    }
}
