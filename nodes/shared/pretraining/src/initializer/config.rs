use crate::PretrainError;
use crate::pretrain::WarmStart;
use pseudoflow_imaging::ObjectSet;
use pseudoflow_learning::Trunk;
use pseudoflow_network::{ComputeDevice, DetectorConfig};
use pseudoflow_synthetic::{SceneConfig, SceneGenerator};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// A training of the initializer on synthetic scenes. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitializerTraining {
    /// BOP `models/` folder; one network is trained for all its objects.
    pub objects: PathBuf,
    /// `nano`, `full`, or the path of a YAML file.
    pub network: String,
    /// Where the weights go (safetensors). Log (.csv), plot (.svg) and checkpoint (.checkpoint) stand beside it.
    pub out: PathBuf,
    /// Optimiser steps.
    pub steps: u64,
    /// Images in a step.
    pub batch: usize,
    /// Peak of the one-cycle learning rate.
    pub max_lr: f64,
    /// Seed of data and fresh weights.
    pub seed: u64,
    /// Weights to start from: an initializer, also of other objects, or a flow network whose backbone is taken. By default the
    /// initializer of this repository, or for networks of other widths RAFT-small as its authors trained it.
    pub warm_start: WarmStart,
    /// Share of the steps, from the first on, in which the trunk stays as it started: the steps are cheaper, and features of
    /// a trained flow network are good already. A training that begins with an initializer of the same objects has none.
    pub frozen_trunk: f64,
    /// How often a rendered scene is used, each time turned, zoomed and coloured anew.
    pub uses: u64,
    /// Scenes that are rendered, then used in changing order; a multiple of `batch`.
    pub block: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u64,
    /// Continue from the checkpoint, which must exist.
    pub resume: bool,
    /// What trains. A run may go on with another device; it then has other bits.
    #[serde(default)]
    pub device: ComputeDevice,
    /// Threads that render beside the training step. They do not change the result.
    pub data_threads: usize,
    /// Folders of photographs, and of pictures of the room without the objects, for tables, walls and cards.
    #[serde(default)]
    pub backgrounds: Vec<PathBuf>,
    /// BOP `models/` folders of other things that stand between the objects.
    #[serde(default)]
    pub others: Vec<PathBuf>,
    /// Leaves out meshes and pictures of which their folder's `meta.json` does not say that they may be shipped.
    #[serde(default)]
    pub only_shippable: bool,
    /// The synthetic scenes; by default those of [`SceneConfig::for_images`] at the network's input.
    pub scenes: Option<SceneConfig>,
}

impl InitializerTraining {
    /// The defaults for an object set, a network and an output file.
    #[must_use]
    pub fn new(objects: PathBuf, network: &str, out: PathBuf) -> Self {
        Self {
            objects,
            network: network.to_owned(),
            out,
            steps: 20_000,
            batch: 8,
            max_lr: 1e-3,
            seed: 0,
            warm_start: WarmStart::Auto,
            frozen_trunk: 0.6,
            uses: 4,
            block: 256,
            checkpoint_every: 200,
            resume: false,
            device: ComputeDevice::default(),
            data_threads: 1,
            backgrounds: vec![],
            others: vec![],
            only_shippable: false,
            scenes: None,
        }
    }

    /// What makes its scenes.
    ///
    /// # Errors
    /// A range that cannot be, or a folder that cannot be read.
    pub(crate) fn generator(
        &self,
        objects: &Arc<ObjectSet>,
        network: &DetectorConfig,
    ) -> Result<SceneGenerator, PretrainError> {
        let generator = SceneGenerator::new(Arc::clone(objects), self.scenes(network), self.seed)?;
        Ok(generator.with_clutter(&self.others, &self.backgrounds, self.only_shippable)?)
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<(), PretrainError> {
        let block = self.block > 0 && self.block <= 65_536 && self.block.is_multiple_of(self.batch.max(1) as u64);
        let rules = [
            ("steps", (1..=100_000_000).contains(&self.steps), "1 to 100000000"),
            ("batch", (1..=256).contains(&self.batch), "1 to 256"),
            ("max_lr", self.max_lr > 0.0 && self.max_lr <= 0.1, "a number over 0, at most 0.1"),
            ("frozen_trunk", (0.0..=1.0).contains(&self.frozen_trunk), "0 to 1"),
            ("uses", (1..=1000).contains(&self.uses), "1 to 1000"),
            ("block", block, "a multiple of `batch`, at most 65536"),
            ("checkpoint_every", self.checkpoint_every > 0, "at least 1"),
            ("data_threads", (1..=64).contains(&self.data_threads), "1 to 64"),
        ];
        match rules.iter().find(|(_, holds, _)| !holds) {
            Some((field, _, wanted)) => Err(PretrainError::Config { field: (*field).to_owned(), wanted }),
            None => Ok(self.scenes.as_ref().map_or(Ok(()), SceneConfig::check)?),
        }
    }

    /// The scenes for a network: images as they are seen before they are padded to the input.
    #[must_use]
    pub fn scenes(&self, network: &DetectorConfig) -> SceneConfig {
        let [width, height] = network.input_px.map(|v| v as u32);
        self.scenes.clone().unwrap_or_else(|| SceneConfig::for_images(width, height.min(width * 3 / 4)))
    }

    /// What becomes of the trunk in a step.
    pub(crate) fn trunk_at(&self, step: u64) -> Trunk {
        if (step as f64) < self.frozen_trunk * self.steps as f64 { Trunk::Frozen } else { Trunk::Trained }
    }

    /// The checkpoint's path.
    #[must_use]
    pub fn checkpoint_path(&self) -> PathBuf {
        self.out.with_extension("checkpoint")
    }

    /// Where the run's configuration is kept, to be compared on resuming.
    #[must_use]
    pub fn run_path(&self) -> PathBuf {
        self.out.with_extension("run.json")
    }
}
