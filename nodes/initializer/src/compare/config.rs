use crate::InitializerError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How the views of an object are compared with an image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompareConfig {
    /// Weights of a flow network (`.safetensors`): the refiner for all objects, or a RAFT-small for the same objects.
    pub model: PathBuf,
    /// Directions from which each object is rendered.
    #[serde(default = "default_directions")]
    pub directions: u32,
    /// Turns about the line of sight for each direction.
    #[serde(default = "default_turns")]
    pub turns: u32,
    /// Steps, in degrees, by which the best views are turned about each axis to find better ones between them.
    #[serde(default = "default_steps_deg")]
    pub steps_deg: Vec<f64>,
    /// And to measure them at twice the resolution.
    #[serde(default = "default_fine_steps_deg")]
    pub fine_steps_deg: Vec<f64>,
    /// Folder in which encoded views are kept, so that the next start takes no time; without: `pseudoflow/views` in the user's
    /// cache (`$XDG_CACHE_HOME`, `~/.cache`).
    #[serde(default)]
    pub cache: Option<PathBuf>,
    /// Poses of an instance that are sent, the most similar first: the refiner tries them all, and pnp keeps the one that flow
    /// and picture agree with best.
    #[serde(default = "default_hypotheses")]
    pub hypotheses: u32,
}

fn default_hypotheses() -> u32 {
    4
}

fn default_steps_deg() -> Vec<f64> {
    vec![14.0, 7.0]
}

fn default_fine_steps_deg() -> Vec<f64> {
    vec![10.0, 5.0, 2.5]
}

fn default_directions() -> u32 {
    64
}

fn default_turns() -> u32 {
    12
}

impl CompareConfig {
    /// The defaults for a flow network.
    #[must_use]
    pub fn new(model: PathBuf) -> Self {
        Self {
            model,
            directions: default_directions(),
            turns: default_turns(),
            steps_deg: default_steps_deg(),
            fine_steps_deg: default_fine_steps_deg(),
            hypotheses: default_hypotheses(),
            cache: None,
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), InitializerError> {
        let count = |v: u32| (4..=1000).contains(&v);
        let rules = [("compare.directions", self.directions), ("compare.turns", self.turns)];
        match rules.into_iter().find(|(_, v)| !count(*v)) {
            Some((field, v)) => Err(InitializerError::Setting { field, got: f64::from(v), wanted: "4 to 1000" }),
            None if !(1..=20).contains(&self.hypotheses) => {
                let got = f64::from(self.hypotheses);
                Err(InitializerError::Setting { field: "compare.hypotheses", got, wanted: "1 to 20" })
            }
            None if !self.steps().all(|v| *v > 0.0 && *v <= 90.0) => {
                let got = self.steps().copied().fold(0.0, f64::max);
                Err(InitializerError::Setting { field: "compare.steps_deg", got, wanted: "numbers over 0, at most 90" })
            }
            None if !self.model.is_file() => {
                Err(InitializerError::Model { path: self.model.clone(), cause: "no such file".into() })
            }
            None => Ok(()),
        }
    }

    fn steps(&self) -> impl Iterator<Item = &f64> {
        self.steps_deg.iter().chain(&self.fine_steps_deg)
    }
}
