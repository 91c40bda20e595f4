//! The initializer's network (docs/method.md, pipeline step 1; Hu et al., "Wide-Depth-Range 6D Object Pose Estimation in
//! Space", CVPR 2021): every location inside an object says which object it is and where the eight corners of its
//! bounding box project, at three resolutions. Beyond the recipe, it also says which point of the object's surface it shows:
//! texture tells that from its neighbourhood alone, long before a network has learned to see a whole box. And it gives the upright
//! rectangle around the projection: corners that are not sure how a box is turned shrink to its middle and say nothing of its size.
//!
//! Backbone: the feature encoder of RAFT-small to 1/8 (so its published weights start it), residual stages at 1/8, 1/16 and
//! 1/32, a feature pyramid over them, and one head for all levels.

mod config;
mod grid;

pub use config::{CORNERS, DetectorConfig, SURFACE_UNIT};
pub use grid::{Cell, Grid, STRIDES};

use crate::error::{NetworkError, Result};
use crate::layout::detector::{self, TRUNK};
use crate::model::{Model, TensorSpec, fingerprint};
use crate::weights::{NamedTensor, Weights, WeightsInfo};

impl Model for DetectorConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn hash(&self) -> String {
        fingerprint(&format!(
            "detector with surface, rectangle {:?} {:?} {} {}",
            self.input_px, self.widths, self.pyramid, self.objects
        ))
    }

    fn layout(&self) -> Vec<TensorSpec> {
        detector::layout(self)
    }

    fn check(&self) -> Result<()> {
        self.check()
    }
}

impl Weights {
    /// Random weights, but the trunk from the feature encoder of RAFT-small: as its authors trained it, or that of a flow
    /// network for the same objects.
    ///
    /// # Errors
    /// `raft_small` belongs to another architecture.
    pub fn detector_from_raft(config: &DetectorConfig, raft_small: &Self, seed: u64) -> Result<Self> {
        let mut weights = Self::random(config, seed);
        for tensor in weights.tensors_mut().filter(|t| t.name.starts_with(TRUNK)) {
            let name = tensor.name.replacen(TRUNK, "fnet", 1);
            let found = raft_small.get(&name).filter(|t| t.shape == tensor.shape);
            let found = found.ok_or_else(|| NetworkError::WeightsMismatch {
                origin: format!("weights of `{}`", raft_small.info.network),
                network: config.name.clone(),
                tensor: name,
                problem: "is missing or has another shape; the trunk starts from RAFT-small".into(),
            })?;
            tensor.data.clone_from(&found.data);
        }
        Ok(weights)
    }

    /// Weights for other objects, from an initializer that finds some already: where things are and how large is the same
    /// question for all objects, so most is taken as it is; what the network says of each object by itself starts as the mean
    /// over those that `known` was trained for.
    ///
    /// # Errors
    /// `known` has other widths.
    pub fn detector_from_known(config: &DetectorConfig, known: &Self) -> Result<Self> {
        let objects = known.get("class.bias").map_or(1, |bias| bias.data.len().max(1));
        let of_new_objects = |tensor: &NamedTensor| {
            let mut tensor = tensor.clone();
            if ["class.", "corners.", "surface."].iter().any(|head| tensor.name.starts_with(head)) {
                tensor.shape[0] = tensor.shape[0] / objects * config.objects;
                tensor.data = mean_of(&tensor.data, objects).repeat(config.objects);
            }
            (tensor.name.clone(), tensor)
        };
        let info = WeightsInfo { network: config.name.clone(), config_hash: config.hash(), ..WeightsInfo::default() };
        let origin = format!("weights of `{}`, of which only the number of objects may differ", known.info.network);
        Self::from_parts(info, known.tensors().iter().map(of_new_objects).collect(), config, &origin)
    }
}

/// The mean of `parts` runs of values that lie one behind the other.
fn mean_of(values: &[f32], parts: usize) -> Vec<f32> {
    let length = values.len() / parts;
    (0..length).map(|i| (0..parts).map(|part| values[part * length + i]).sum::<f32>() / parts as f32).collect()
}
