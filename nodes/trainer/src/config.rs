use crate::TrainerError;
use pseudoflow_network::{ComputeDevice, FlowNetwork};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the trainer node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainerConfig {
    /// Weights that student and teacher begin with (.safetensors).
    pub weights: PathBuf,
    /// The network that they belong to: auto (as the weights say), refiner, nano, small, paper, or the YAML file of a RAFT as in
    /// config/networks.
    #[serde(default = "auto")]
    pub network: String,
    /// Width and height of the crops, pixels; the renderer's `size_px`.
    #[serde(default = "default_size_px")]
    pub size_px: u32,
    /// Width and height that the student sees, pixels: `size_px` divided by 1, 2 or 4; `size_px` by default. Labels are
    /// better where the teacher looks closer.
    #[serde(default)]
    pub student_px: Option<u32>,
    /// What trains: auto, cpu, `vulkan[:N]` or `cuda[:N]`. The same bits come out on the processor only.
    #[serde(default)]
    pub device: ComputeDevice,
    /// Folder of checkpoint, log and result.
    pub out: PathBuf,
    /// Steps of the whole training.
    pub steps: u64,
    /// Steps that were taken before this run: frame 0 belongs to the next one.
    #[serde(default)]
    pub first_step: u64,
    /// Frames of a step.
    #[serde(default = "default_frames")]
    pub frames_per_step: u64,
    /// Updates of the student in a step, each with other colours: labels cost more than the student's look at them.
    #[serde(default = "once")]
    pub repeats: u64,
    /// Steps between two publications of the teacher; the flow node's `lockstep.publish_every`.
    #[serde(default = "default_publish")]
    pub publish_every: u64,
    /// Steps between two checkpoints. What is not in one is repeated after a crash: the graph's `window` must hold more
    /// than so many steps.
    #[serde(default = "default_checkpoint")]
    pub checkpoint_every: u64,
    /// Steps between two teachers that are kept, in the folder `teachers`; none by default.
    #[serde(default)]
    pub keep_every: Option<u64>,
    /// Peak of the one-cycle learning rate; 4e-4 in the paper, for 16 instances a step.
    #[serde(default = "default_max_lr")]
    pub max_lr: f64,
    /// Share of the old teacher in the new one. By default the teacher's memory, 1 / (1 - alpha) updates, is a twentieth of the
    /// training, and at most the paper's (0.999): a longer one would still hold what the training began with.
    #[serde(default)]
    pub ema_alpha: Option<f64>,
    /// Iterations of the student in training; the network's own by default.
    #[serde(default)]
    pub train_iterations: Option<usize>,
    /// Weight of the flow loss.
    #[serde(default = "one")]
    pub flow_weight: f64,
    /// Weight of the photometric loss.
    #[serde(default = "half")]
    pub photo_weight: f64,
    /// Whether the student sees other colours than the teacher.
    #[serde(default = "yes")]
    pub augment: bool,
}

fn auto() -> String {
    "auto".into()
}

fn default_size_px() -> u32 {
    128
}

fn default_frames() -> u64 {
    4
}

fn once() -> u64 {
    1
}

fn default_publish() -> u64 {
    10
}

fn default_checkpoint() -> u64 {
    1
}

fn default_max_lr() -> f64 {
    1e-4
}

fn one() -> f64 {
    1.0
}

fn half() -> f64 {
    0.5
}

fn yes() -> bool {
    true
}

/// Where nano's labels agree with the true flow, pixels (tables in docs/results).
const LABEL_PX: u32 = 256;

/// Width and height of the teacher's crops, pixels: as given, else `LABEL_PX`, or those of the student where they are larger.
#[must_use]
pub fn label_px(given: Option<u32>, student_px: u32) -> u32 {
    given.unwrap_or(student_px.max(LABEL_PX))
}

impl TrainerConfig {
    /// A training with the defaults.
    #[must_use]
    pub fn new(weights: PathBuf, out: PathBuf, steps: u64) -> Self {
        Self {
            weights,
            network: auto(),
            size_px: default_size_px(),
            student_px: None,
            device: ComputeDevice::default(),
            out,
            steps,
            first_step: 0,
            frames_per_step: default_frames(),
            repeats: once(),
            publish_every: default_publish(),
            checkpoint_every: default_checkpoint(),
            keep_every: None,
            max_lr: default_max_lr(),
            ema_alpha: None,
            train_iterations: None,
            flow_weight: one(),
            photo_weight: half(),
            augment: yes(),
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn check(&self) -> Result<(), TrainerError> {
        let iterations = |n: usize| (1..=64).contains(&n);
        let checks = [
            (
                "size_px",
                self.size_px.is_multiple_of(8) && (64..=1024).contains(&self.size_px),
                "a multiple of 8 in 64..=1024",
            ),
            (
                "student_px",
                self.student_px.is_none_or(|px| [1, 2, 4].into_iter().any(|by| px >= 64 && px * by == self.size_px)),
                "`size_px` divided by 1, 2 or 4, and at least 64",
            ),
            ("steps", self.steps > 0 && self.first_step < self.steps, "more than `first_step`"),
            ("frames_per_step", self.frames_per_step > 0, "at least 1"),
            ("repeats", (1..=64).contains(&self.repeats), "1..=64"),
            ("publish_every", self.publish_every > 0, "at least 1"),
            ("checkpoint_every", self.checkpoint_every > 0, "at least 1"),
            ("keep_every", self.keep_every != Some(0), "at least 1"),
            ("max_lr", self.max_lr > 0.0 && self.max_lr < 1.0, "a rate in 0..1"),
            ("ema_alpha", self.ema_alpha.is_none_or(|alpha| (0.0..1.0).contains(&alpha)), "0 <= alpha < 1"),
            ("train_iterations", self.train_iterations.is_none_or(iterations), "1..=64"),
            ("flow_weight", self.flow_weight >= 0.0, "at least 0"),
            ("photo_weight", self.photo_weight >= 0.0, "at least 0"),
            ("flow_weight", self.flow_weight + self.photo_weight > 0.0, "more than 0, or `photo_weight`"),
        ];
        match checks.into_iter().find(|(_, good, _)| !good) {
            Some((field, _, wanted)) => Err(TrainerError::Config { field: field.into(), wanted }),
            None => Ok(()),
        }
    }

    /// Updates of the student in the whole training.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.steps * self.repeats
    }

    /// Share of the old teacher in the new one.
    #[must_use]
    pub fn ema_alpha(&self) -> f64 {
        self.ema_alpha.unwrap_or_else(|| (1.0 - 20.0 / self.updates() as f64).clamp(0.0, 0.999))
    }

    /// How many times smaller the student's crops are than the teacher's.
    #[must_use]
    pub fn shrink(&self) -> usize {
        self.student_px.map_or(1, |px| (self.size_px / px) as usize)
    }

    /// The network with the iterations of this training.
    ///
    /// # Errors
    /// The name is none of the presets and no readable file, or the weights are unreadable.
    pub fn resolve_network(&self) -> Result<FlowNetwork, TrainerError> {
        let mut network = match self.network.as_str() {
            "auto" => FlowNetwork::of_weights(&self.weights)?,
            name => FlowNetwork::named(name)?,
        };
        if let Some(iterations) = self.train_iterations {
            network.set_iterations_train(iterations);
        }
        Ok(network)
    }
}
