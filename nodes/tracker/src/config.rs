use pseudoflow_imaging::ObjectSet;
use pseudoflow_runtime::NodeError;
use pseudoflow_tracking::TrackingConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the tracker node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrackerNodeConfig {
    /// Folder of the object set (BOP `models/`).
    pub objects: PathBuf,
    /// Ids of the objects that are expected in view; all of the set without.
    #[serde(default)]
    pub expected: Option<Vec<u32>>,
    /// Folder in which contour models are kept; without, in the system's folder for temporary files.
    #[serde(default)]
    pub contours: Option<PathBuf>,
    /// Score from which a look of the network says that its pose is right, 0..1.
    #[serde(default = "default_look_score")]
    pub look_score: f64,
    /// In replay a look at a frame is used this many frames later.
    #[serde(default = "default_look_delay")]
    pub look_delay: u64,
    /// In replay what was found in a frame is used this many frames later.
    #[serde(default = "default_found_delay")]
    pub found_delay: u64,
    /// How objects are followed.
    #[serde(default)]
    pub track: TrackingConfig,
}

fn default_look_score() -> f64 {
    0.7
}

fn default_look_delay() -> u64 {
    3
}

fn default_found_delay() -> u64 {
    10
}

impl TrackerNodeConfig {
    /// The defaults for an object set.
    #[must_use]
    pub fn new(objects: PathBuf) -> Self {
        Self {
            objects,
            expected: None,
            contours: None,
            look_score: default_look_score(),
            look_delay: default_look_delay(),
            found_delay: default_found_delay(),
            track: TrackingConfig::default(),
        }
    }

    pub(crate) fn check(&self) -> Result<(), NodeError> {
        self.track.validate()?;
        if !(0.0..=1.0).contains(&self.look_score) {
            return Err(format!("`look_score: {}`: give 0 to 1", self.look_score).into());
        }
        ObjectSet::check(&self.objects)?;
        match &self.expected {
            Some(ids) if ids.is_empty() => Err("`expected: []`: name at least one object, or leave it out".into()),
            _ => Ok(()),
        }
    }
}
