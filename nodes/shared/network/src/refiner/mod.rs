//! The refiner: a compact network for all objects that knows the rendering's depth and says how sure it is.
//!
//! It follows RAFT's plan (features, all-pairs correlation, recurrent refinement) at a fraction of its price: first flow and
//! context come from a look at 1/16 of the resolution that sees the whole crop (NeuFlow v2, Zhang et al. 2024), three or four
//! iterations refine at 1/8, and all of it shares one trunk. Beside the flow each pixel gets a *visibility* (is this point of
//! the rendered surface seen in the photograph?) and a *confidence* (the sure component's share of a mixture of two Laplace
//! distributions; SEA-RAFT, Wang et al., ECCV 2024).
//!
//! Input: the rendering (N, 5, S, S): red, green, blue in [-1, 1], relative depth, mask ([`reference_geometry`]); the
//! photograph's crop (N, 3, S, S). S is a multiple of 16.

mod geometry;

pub use geometry::reference_geometry;

use crate::error::{NetworkError, Result, io_error};
use crate::model::{Model, TensorSpec, fingerprint};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Channels of the rendering that the refiner takes: red, green, blue, relative depth, mask.
pub const REFERENCE_CHANNELS: usize = 5;

/// The refiner and the size it is trained at. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefinerConfig {
    /// Name, written into the weights.
    pub name: String,
    /// Side S of the square crops in training, px; a multiple of 16, from 64 to 1024.
    pub size_px: usize,
    /// Recurrent iterations in training.
    pub iterations_train: usize,
    /// Recurrent iterations at run time.
    pub iterations_infer: usize,
}

impl Default for RefinerConfig {
    fn default() -> Self {
        Self { name: "refiner".into(), size_px: 128, iterations_train: 3, iterations_infer: 4 }
    }
}

impl RefinerConfig {
    /// Reads and checks a YAML file.
    ///
    /// # Errors
    /// The file is unreadable, has unknown keys, or a value is out of range.
    pub fn from_yaml_file(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(io_error(path))?;
        let config: Self = serde_yaml::from_str(&text)
            .map_err(|e| NetworkError::ConfigSyntax { path: path.into(), message: e.to_string() })?;
        Model::check(&config)?;
        Ok(config)
    }

    /// Checks a crop side in px: a multiple of 16 from 64 to 1024.
    ///
    /// # Errors
    /// It is another number.
    pub fn check_size(size_px: usize) -> Result<()> {
        if size_px.is_multiple_of(16) && (64..=1024).contains(&size_px) {
            return Ok(());
        }
        let problem = format!("is {size_px}; the refiner takes a multiple of 16 from 64 to 1024");
        Err(NetworkError::ConfigValue { field: "size_px", problem })
    }
}

impl Model for RefinerConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn hash(&self) -> String {
        fingerprint("refiner 1")
    }

    fn layout(&self) -> Vec<TensorSpec> {
        crate::layout::refiner::layout()
    }

    fn check(&self) -> Result<()> {
        if self.name.is_empty() {
            let problem = "is empty; give the network a name".into();
            return Err(NetworkError::ConfigValue { field: "name", problem });
        }
        for (field, n) in [("iterations_train", self.iterations_train), ("iterations_infer", self.iterations_infer)] {
            if !(1..=64).contains(&n) {
                return Err(NetworkError::ConfigValue { field, problem: format!("is {n}; use 1 to 64") });
            }
        }
        Self::check_size(self.size_px)
    }
}
