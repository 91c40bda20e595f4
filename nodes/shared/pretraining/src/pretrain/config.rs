use crate::PretrainError;
use pseudoflow_learning::{Plateau, Schedule, TrainConfig};
use pseudoflow_network::{Architecture, ComputeDevice, FlowNetwork};
use pseudoflow_synthetic::SynthConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A pre-training run. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PretrainConfig {
    /// BOP `models/` folders; one network is trained for all their objects.
    pub objects: Vec<PathBuf>,
    /// `refiner`, `nano`, `small`, `paper`, or the path of a YAML file as in config/networks.
    pub network: String,
    /// Where the weights go (safetensors). Log (.csv), plot (.svg) and checkpoint (.checkpoint) stand beside it.
    pub out: PathBuf,
    /// Optimiser steps.
    #[serde(default = "defaults::steps")]
    pub steps: u64,
    /// Pairs per step at the network's size; larger crops get fewer, so that the pixels stay about the same.
    #[serde(default = "defaults::batch")]
    pub batch: usize,
    /// Peak of the one-cycle learning rate.
    #[serde(default = "defaults::max_lr")]
    pub max_lr: f64,
    /// Seed of data and fresh weights.
    #[serde(default)]
    pub seed: u64,
    /// Weights to start from.
    #[serde(default)]
    pub warm_start: WarmStart,
    /// RAFT iterations in training, in place of the network's.
    #[serde(default)]
    pub iterations: Option<usize>,
    /// Crop sizes to train at; empty for those of [`PretrainConfig::size_shares`].
    #[serde(default)]
    pub sizes: Vec<SizeShare>,
    /// Weight in the loss of foreground whose point is hidden or outside the crop; visible foreground has 1. The
    /// paper takes 0.
    #[serde(default)]
    pub hidden_weight: f64,
    /// Weight in the loss of the error of the poses that the flows say (docs/method.md, "Synthetic pre-training"), crop pixels at 256 for
    /// an ADD of one diameter. 0 for none; RAFT takes none.
    #[serde(default)]
    pub pose_weight: f64,
    /// How the learning rate changes; the refiner's default is a plateau, RAFT's one cycle.
    #[serde(default)]
    pub schedule: Option<Course>,
    /// Memory of the moving average of the weights, in steps; the average is what is written. 0: the last step's weights.
    #[serde(default)]
    pub average: Option<u64>,
    /// Every n-th object is kept out of the training, and the error is measured on renderings of these. 0: none.
    #[serde(default)]
    pub hold_out: usize,
    /// Steps between measurements on the objects kept out.
    #[serde(default = "defaults::validate_every")]
    pub validate_every: u64,
    /// Steps between checkpoints.
    #[serde(default = "defaults::checkpoint_every")]
    pub checkpoint_every: u64,
    /// Continue from the checkpoint, which must exist.
    #[serde(default)]
    pub resume: bool,
    /// What trains. A run may go on with another device; it then has other bits.
    #[serde(default)]
    pub device: ComputeDevice,
    /// Threads that make samples beside the training step. They do not change the result.
    #[serde(default = "defaults::data_threads")]
    pub data_threads: usize,
    /// Folders of photographs for walls, tables and cards of the scenes; none for patterns alone.
    #[serde(default)]
    pub backgrounds: Vec<PathBuf>,
    /// Leaves out meshes and pictures of which the `meta.json` of their folder does not say that they may be shipped; those of
    /// folders without one are taken as the user's own.
    #[serde(default)]
    pub only_shippable: bool,
    /// The synthetic scenes.
    #[serde(default)]
    pub synth: SynthConfig,
}

/// The learning rate over a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Course {
    /// Rises over the first 5 % of the steps and falls over the rest: for a number of steps known beforehand.
    OneCycle,
    /// Constant after `warm_up` steps until it falls over the last `cool_down` steps: such a training goes on, with more steps,
    /// from where its cool-down began.
    Plateau {
        /// Steps over which the rate rises.
        warm_up: u64,
        /// Steps at the end over which it falls; 0 for none.
        cool_down: u64,
    },
}

/// What a run starts from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WarmStart {
    /// [`SHIPPED_WEIGHTS`] for RAFT-small, [`SHIPPED_REFINER`] for the refiner, random weights for RAFT Basic (none are shipped for it).
    #[default]
    Auto,
    /// Random weights.
    Random,
    /// A safetensors file.
    File(PathBuf),
}

/// RAFT-small as its authors trained it, relative to the repository.
pub const SHIPPED_WEIGHTS: &str = "config/weights/raft_small.safetensors";

/// The refiner for all objects, relative to the repository.
pub const SHIPPED_REFINER: &str = "config/weights/refiner.safetensors";

/// Weights of this repository.
pub(crate) fn shipped(path: &str) -> Result<PathBuf, PretrainError> {
    let not_shipped = |cause: String| PretrainError::NotShipped { path: path.into(), cause };
    let found = pseudoflow_runtime::shipped::input(path).map_err(|error| not_shipped(error.to_string()))?;
    if found.is_file() { Ok(found) } else { Err(not_shipped("no such file".into())) }
}

/// How often a crop size is used. As text: `256`, or `256:2` with a weight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SizeShare {
    /// Side of the crop, pixels; a multiple of 8.
    pub size_px: usize,
    /// Relative frequency in steps. A step has about as many pixels at each size.
    pub weight: f64,
}

impl std::str::FromStr for SizeShare {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (size, weight) = text.split_once(':').unwrap_or((text, "1"));
        match (size.trim().parse(), weight.trim().parse()) {
            (Ok(size_px), Ok(weight)) => Ok(Self { size_px, weight }),
            _ => Err(format!("`{text}` is not a crop size; write pixels, or pixels and a weight: 256 or 256:2")),
        }
    }
}

mod defaults {
    pub(super) fn steps() -> u64 {
        20_000
    }
    pub(super) fn batch() -> usize {
        4
    }
    pub(super) fn max_lr() -> f64 {
        2e-4
    }
    pub(super) fn validate_every() -> u64 {
        500
    }
    pub(super) fn checkpoint_every() -> u64 {
        200
    }
    pub(super) fn data_threads() -> usize {
        1
    }
}

impl PretrainConfig {
    /// The defaults for an object set, a network and an output file.
    #[must_use]
    pub fn new(objects: Vec<PathBuf>, network: &str, out: PathBuf) -> Self {
        Self {
            objects,
            network: network.to_owned(),
            out,
            steps: defaults::steps(),
            batch: defaults::batch(),
            max_lr: defaults::max_lr(),
            seed: 0,
            warm_start: WarmStart::default(),
            iterations: None,
            sizes: Vec::new(),
            hidden_weight: 0.0,
            pose_weight: 0.0,
            schedule: None,
            average: None,
            hold_out: 0,
            validate_every: defaults::validate_every(),
            checkpoint_every: defaults::checkpoint_every(),
            resume: false,
            device: ComputeDevice::default(),
            data_threads: defaults::data_threads(),
            backgrounds: Vec::new(),
            only_shippable: false,
            synth: SynthConfig::default(),
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<(), PretrainError> {
        let size_ok = |s: &SizeShare| {
            s.size_px.is_multiple_of(8) && (64..=1024).contains(&s.size_px) && s.weight > 0.0 && s.weight.is_finite()
        };
        let rules = [
            ("objects", !self.objects.is_empty(), "at least one folder"),
            ("steps", (1..=100_000_000).contains(&self.steps), "1 to 100000000"),
            ("batch", (1..=256).contains(&self.batch), "1 to 256"),
            ("max_lr", self.max_lr > 0.0 && self.max_lr <= 0.1, "a number over 0, at most 0.1"),
            ("iterations", self.iterations.is_none_or(|n| (1..=64).contains(&n)), "1 to 64"),
            ("sizes", self.sizes.iter().all(size_ok), "multiples of 8 from 64 to 1024, with weights over 0"),
            ("hidden_weight", (0.0..=1.0).contains(&self.hidden_weight), "0 to 1"),
            ("pose_weight", (0.0..=1000.0).contains(&self.pose_weight), "0 to 1000"),
            ("checkpoint_every", self.checkpoint_every > 0, "at least 1"),
            ("validate_every", self.validate_every > 0, "at least 1"),
            ("hold_out", self.hold_out != 1, "0, or at least 2: something must be left to train on"),
            ("data_threads", (1..=64).contains(&self.data_threads), "1 to 64"),
        ];
        match rules.iter().find(|(_, holds, _)| !holds) {
            Some((field, _, wanted)) => Err(PretrainError::Config { field: (*field).to_owned(), wanted }),
            None => Ok(self.synth.check()?),
        }
    }

    /// The network that `network` names, with `iterations` put in.
    ///
    /// # Errors
    /// When the YAML file is bad.
    pub(crate) fn resolve_network(&self) -> Result<FlowNetwork, PretrainError> {
        let mut network = FlowNetwork::named(&self.network)?;
        let iterations = match &mut network {
            FlowNetwork::Raft(raft) => &mut raft.iterations_train,
            FlowNetwork::Refiner(refiner) => &mut refiner.iterations_train,
        };
        *iterations = self.iterations.unwrap_or(*iterations);
        Ok(network)
    }

    /// Side of the network's crops, pixels.
    ///
    /// # Errors
    /// When the YAML file is bad.
    pub fn network_size_px(&self) -> Result<usize, PretrainError> {
        Ok(self.resolve_network()?.size_px())
    }

    /// The crop sizes to train at. RAFT trains at the size of its network, the refiner also at twice that, where it is used:
    /// trained at 128 px alone it goes on improving there and unlearns 256 px (docs/method.md, "Synthetic pre-training").
    ///
    /// # Errors
    /// When the network's YAML file is bad.
    pub fn size_shares(&self) -> Result<Vec<SizeShare>, PretrainError> {
        let network = self.resolve_network()?;
        let own_px = network.size_px();
        let share = |size_px, weight| SizeShare { size_px, weight };
        Ok(match (self.sizes.is_empty(), network.is_refiner()) {
            (false, _) => self.sizes.clone(),
            (true, true) => vec![share(own_px, 1.0), share(2 * own_px, 2.0)],
            (true, false) => vec![share(own_px, 1.0)],
        })
    }

    /// The weights file to start from, or `None` for random weights.
    ///
    /// # Errors
    /// When the default is meant and not there.
    pub(super) fn start_weights(&self, network: &FlowNetwork) -> Result<Option<PathBuf>, PretrainError> {
        Ok(match (&self.warm_start, network) {
            (WarmStart::File(path), _) => Some(path.clone()),
            (WarmStart::Random, _) => None,
            (WarmStart::Auto, FlowNetwork::Refiner(_)) => Some(shipped(SHIPPED_REFINER)?),
            (WarmStart::Auto, FlowNetwork::Raft(raft)) if raft.arch == Architecture::Small => {
                Some(shipped(SHIPPED_WEIGHTS)?)
            }
            (WarmStart::Auto, FlowNetwork::Raft(_)) => None,
        })
    }

    /// Learning rate, optimiser and clipping.
    pub(super) fn train_config(&self) -> TrainConfig {
        let (max_lr, total_steps) = (self.max_lr, self.steps);
        match self.course() {
            Course::OneCycle => TrainConfig::new(max_lr, total_steps),
            Course::Plateau { warm_up, cool_down } => {
                TrainConfig::scheduled(Schedule::Plateau(Plateau { max_lr, total_steps, warm_up, cool_down }))
            }
        }
    }

    /// Memory of the moving average, steps; 0 for none.
    pub(super) fn averaged_steps(&self) -> u64 {
        self.average.unwrap_or(if self.on_plateau() { 1000 } else { 0 })
    }

    /// The checkpoint's path.
    #[must_use]
    pub fn checkpoint_path(&self) -> PathBuf {
        self.out.with_extension("checkpoint")
    }

    /// The checkpoint of the step at which a cool-down began.
    #[must_use]
    pub fn plateau_path(&self) -> PathBuf {
        self.out.with_extension("plateau")
    }
}
