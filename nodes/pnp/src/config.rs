use crate::gate::GateConfig;
use crate::joint::Stages;
use pseudoflow_runtime::Draws;
use pseudoflow_solver::{JointConfig, PnpConfig};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the pnp node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PnpNodeConfig {
    /// The solver. Pixel thresholds are those of a crop of 256 px and scale with the crop.
    pub solver: PnpConfig,
    /// What poses are solved from. `region` and `joint` need `objects` and the `frame` port, `region` needs neither `views`
    /// nor `flow` but `initial_poses`.
    pub stages: Stages,
    /// Folder of the object set (BOP `models/`), for its contours.
    pub objects: Option<PathBuf>,
    /// Folder where contour models are kept for the next start; without it one in the system's temporary folder.
    pub contours: Option<PathBuf>,
    /// The joint solver of `region` and `joint`.
    pub joint: JointConfig,
    /// When a refined pose replaces the initial one, and how sure a pose is; `null` accepts every solution.
    pub gate: Option<GateConfig>,
    /// Smallest agreement of flow and picture with a pose for the object to count as seen there, -1 to 3: inlier ratio,
    /// correlation of the rendering with the crop and contrast across its contour. Below it the status is `NotSeen`.
    pub min_seen: f64,
    /// Frames of a training that went before this run: they decide what is drawn at random.
    pub first_frame: u64,
    /// What decides which numbers RANSAC draws.
    pub draws: Draws,
}

impl Default for PnpNodeConfig {
    fn default() -> Self {
        Self {
            solver: PnpConfig::default(),
            stages: Stages::default(),
            objects: None,
            contours: None,
            joint: JointConfig::default(),
            gate: Some(GateConfig::default()),
            min_seen: MIN_SEEN,
            first_frame: 0,
            draws: Draws::default(),
        }
    }
}

/// Between right poses and poses at places where other things are: on data/tabletop's test images (273 and 268 of them) one in
/// twenty of the former lies below, one in twenty of the latter above.
const MIN_SEEN: f64 = 1.1;
