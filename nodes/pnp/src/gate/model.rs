use super::{Features, Logistic};
use pseudoflow_solver::PnpError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is learnt about refinements, by stage: the content of `config/gate.yaml`, which `pseudoflow calibrate` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GateModel {
    /// The commands that made it, and from what: a line for each stage, `stage: command`.
    pub made_by: String,
    /// By what the solver saw.
    pub stages: BTreeMap<Stage, StageModel>,
}

/// What a pose was solved from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Flow alone.
    #[default]
    Flow,
    /// The contour alone.
    Region,
    /// Both.
    Joint,
}

/// What is learnt about one stage. "Right" is ADD(-S) below a tenth of the diameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StageModel {
    /// Refinements that it was fitted on.
    pub samples: usize,
    /// Whether the refined pose has a smaller ADD(-S) than the initial one.
    pub better: Logistic,
    /// Whether the refined pose is right.
    pub refined_right: Logistic,
    /// Whether the initial pose is right.
    pub initial_right: Logistic,
    /// What makes the solver's covariance one of the true error.
    pub covariance: CovarianceScale,
}

/// What the solver's standard deviations are multiplied with: `exp(translation + translation_slope (1 - confidence))`,
/// rotation likewise; its correlations are multiplied with `1 - decorrelation`. The solver knows the noise of its inliers; that
/// they may be wrong together, also along directions that it holds for certain, is learnt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CovarianceScale {
    /// Logarithm of the factor of the translation at a confidence of 1.
    pub translation: f64,
    /// What it gains down to a confidence of 0.
    pub translation_slope: f64,
    /// Logarithm of the factor of the rotation at a confidence of 1.
    pub rotation: f64,
    /// What it gains down to a confidence of 0.
    pub rotation_slope: f64,
    /// How much of the correlations is not believed, 0..1.
    pub decorrelation: f64,
}

impl CovarianceScale {
    /// The factors of translation and rotation.
    #[must_use]
    pub fn factors(&self, confidence: f64) -> [f64; 2] {
        let doubt = 1.0 - confidence;
        [self.translation + self.translation_slope * doubt, self.rotation + self.rotation_slope * doubt].map(f64::exp)
    }

    /// A solver's covariance (row-major 6 x 6, translation first), scaled.
    #[must_use]
    pub fn apply(&self, covariance: &[f64; 36], confidence: f64) -> [f64; 36] {
        let factors = self.factors(confidence);
        let believed = |i: usize| if i.is_multiple_of(7) { 1.0 } else { 1.0 - self.decorrelation };
        std::array::from_fn(|i| covariance[i] * factors[i / 6 / 3] * factors[i % 6 / 3] * believed(i))
    }

    fn is_sound(&self) -> bool {
        let all = [self.translation, self.translation_slope, self.rotation, self.rotation_slope];
        all.iter().all(|v| v.abs() <= 20.0) && (0.0..=1.0).contains(&self.decorrelation)
    }
}

/// What the models say about one refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// Probability that the refined pose is better than the initial one.
    pub better: f64,
    /// Probability that the refined pose is right.
    pub refined_right: f64,
    /// Probability that the initial pose is right.
    pub initial_right: f64,
}

impl StageModel {
    /// What the models say about a refinement.
    #[must_use]
    pub fn verdict(&self, features: &Features) -> Verdict {
        Verdict {
            better: self.better.probability(features),
            refined_right: self.refined_right.probability(features),
            initial_right: self.initial_right.probability(features),
        }
    }

    fn is_sound(&self) -> bool {
        let models = [&self.better, &self.refined_right, &self.initial_right];
        models.iter().all(|model| model.is_sound()) && self.covariance.is_sound()
    }
}

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub enum GateModelError {
    /// The file cannot be read.
    #[error("gate model {path}: {source}; `pseudoflow calibrate` writes such a file")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not such a model.
    #[error("gate model {origin}: {source}")]
    Yaml {
        /// The file, or that of the binary.
        origin: String,
        /// The cause, with line and column.
        source: serde_yaml::Error,
    },
    /// A number is not usable.
    #[error(
        "gate model {origin}, stage {stage:?}: a number is not finite, a scale not positive or a factor beyond e^20"
    )]
    Unsound {
        /// The file, or that of the binary.
        origin: String,
        /// The stage.
        stage: Stage,
    },
    /// The stage was never calibrated.
    #[error("gate model {origin} has no stage {stage:?}, only {known:?}: run `pseudoflow calibrate` for it")]
    NoStage {
        /// The file, or that of the binary.
        origin: String,
        /// The stage asked for.
        stage: Stage,
        /// Those there are.
        known: Vec<Stage>,
    },
    /// A setting of the gate is out of range.
    #[error(transparent)]
    Setting(#[from] PnpError),
}

/// The model that is compiled in: `config/gate.yaml`.
const BUILT_IN: &str = include_str!("../../../../config/gate.yaml");

impl GateModel {
    /// Reads a model; without a path the one that is compiled in.
    ///
    /// # Errors
    /// When the file cannot be read or is no such model.
    pub fn load(path: Option<&Path>) -> Result<Self, GateModelError> {
        let Some(path) = path else { return Self::parse(BUILT_IN, "config/gate.yaml of the binary") };
        let text =
            std::fs::read_to_string(path).map_err(|source| GateModelError::Io { path: path.to_owned(), source })?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Reads the text of a model; `origin` names it in errors.
    ///
    /// # Errors
    /// When it is no such model.
    pub fn parse(text: &str, origin: &str) -> Result<Self, GateModelError> {
        let model: Self =
            serde_yaml::from_str(text).map_err(|source| GateModelError::Yaml { origin: origin.to_owned(), source })?;
        match model.stages.iter().find(|(_, stage)| !stage.is_sound()) {
            Some((stage, _)) => Err(GateModelError::Unsound { origin: origin.to_owned(), stage: *stage }),
            None => Ok(model),
        }
    }

    /// Puts what was learnt about a stage in place of what was known of it.
    pub fn learn(&mut self, stage: Stage, model: StageModel, command: &str) {
        let name = format!("{stage:?}: ").to_lowercase();
        let others = self.made_by.lines().filter(|line| !line.starts_with(&name)).map(str::to_owned);
        let mut lines: Vec<String> = others.chain([format!("{name}{command}")]).collect();
        lines.sort();
        self.made_by = lines.join("\n");
        self.stages.insert(stage, model);
    }

    /// The model of one stage.
    ///
    /// # Errors
    /// When there is none.
    pub fn stage(&self, stage: Stage) -> Result<&StageModel, GateModelError> {
        self.stages.get(&stage).ok_or_else(|| GateModelError::NoStage {
            origin: self.made_by.clone(),
            stage,
            known: self.stages.keys().copied().collect(),
        })
    }
}
