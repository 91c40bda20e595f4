//! A training on recordings: its options, and `config/graphs/adapt.yaml` with them put in.

use crate::RARE;
use crate::graphs::network;
use crate::in_process::take_out;
use anyhow::{Context as _, Result, bail, ensure};
use pseudoflow_network::ComputeDevice;
use pseudoflow_player::InitialPoses;
use pseudoflow_runtime::Graph;
pub use pseudoflow_trainer::files;
use pseudoflow_trainer::{label_px, steps_taken};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const GRAPH: &str = include_str!("../../../config/graphs/adapt.yaml");

/// Extension of the folder beside the weights where a training keeps its files.
pub const FOLDER: &str = "adapt";

/// Nodes of the teacher's first look.
pub const FIRST_LOOK: [&str; 3] = ["look", "look_flow", "pnp"];

/// Options of a training, whoever makes its labels.
#[derive(clap::Args, Debug, Clone)]
pub struct TrainingArgs {
    /// Recordings: rosbag2 folders, .mcap files or BOP scenes.
    ///
    /// Annotations are not needed.
    #[arg(long = "bag", required = true, num_args = 1.., value_parser = pseudoflow_runtime::shipped::input)]
    pub bags: Vec<PathBuf>,
    /// The object set: a BOP `models/` folder.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    pub objects: PathBuf,
    /// Weights to begin with (.safetensors).
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    pub weights: PathBuf,
    /// The weights to write; log, checkpoint and report stand beside them.
    ///
    /// Their folder has the same name, `.adapt`.
    #[arg(long)]
    pub out: PathBuf,
    /// What trains and labels: auto, cpu, `vulkan[:N]` or `cuda[:N]`.
    ///
    /// A training may go on with another one.
    #[arg(long, default_value = "auto")]
    pub device: ComputeDevice,
    /// Training steps.
    ///
    /// A hundred take about half an hour on two cores.
    #[arg(long, default_value_t = 100)]
    pub steps: u64,
    /// Instances in a step.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 4)]
    pub batch: u64,
    /// Updates of the student with the labels of a step, each with other colours.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=64))]
    pub repeats: u64,
    /// Rendered views of each instance.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 4)]
    pub views: u32,
    /// The network that the weights belong to: auto, refiner, nano, small or paper.
    ///
    /// `auto`: as the weights say.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value = "auto")]
    pub network: String,
    /// Width and height of the crops that the network will see in use, pixels.
    ///
    /// The student trains at this size.
    #[arg(long, default_value_t = 128)]
    pub size: u32,
    /// Width and height of the crops that are labelled, pixels.
    ///
    /// `--size` times 1, 2 or 4. Labels are better where the teacher looks closer. [default: 256, or `--size` where
    /// that is more]
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    pub label_size: Option<u32>,
    /// Peak of the one-cycle learning rate.
    ///
    /// The paper's 4e-4 wants its hundreds of thousands of steps.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 2e-4)]
    pub max_lr: f64,
    /// Share of the old teacher in the new one after a step.
    ///
    /// [default: its memory is a twentieth of the training, and 0.999, the paper's, at most]
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    pub ema: Option<f64>,
    /// Keeps the teacher of every n-th step, in the folder `teachers` of the training.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    pub keep_every: Option<u64>,
    /// Uses this many frames of the recordings only.
    ///
    /// An initializer then searches twice as many.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    pub budget_frames: Option<u64>,
    /// Every n-th frame is left out of the training and used to judge it.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 5)]
    pub held_out_every: u64,
    /// Goes on from the checkpoint of an interrupted training.
    #[arg(long)]
    pub resume: bool,
    /// Only those of these objects.
    #[arg(long, help_heading = RARE, hide_short_help = true, num_args = 1..)]
    pub only_objects: Option<Vec<u32>>,
    /// Seed of the run.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 1)]
    pub seed: u64,
}

impl TrainingArgs {
    /// Width and height of the crops that are labelled, pixels.
    #[must_use]
    pub fn label_px(&self) -> u32 {
        label_px(self.label_size, self.size)
    }

    /// Where the training keeps its files.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        self.out.with_extension(FOLDER)
    }

    /// Refuses what no training could use, and to go on or begin by mistake.
    ///
    /// # Errors
    /// Names the option.
    pub fn check(&self) -> Result<()> {
        ensure!(self.steps > 0 && self.batch > 0, "`--steps` and `--batch`: give at least 1");
        ensure!(self.held_out_every >= 2, "`--held-out-every {}`: give at least 2", self.held_out_every);
        ensure!(self.weights.is_file(), "`--weights {}`: no such file", self.weights.display());
        let (folder, started) = (self.folder(), self.folder().join(files::CHECKPOINT));
        match (self.resume, started.exists()) {
            (true, false) => bail!("`--resume`: there is no {}: leave `--resume` out", started.display()),
            (false, true) => bail!(
                "{} holds an earlier training: go on with `--resume`, or remove the folder, or give another `--out`",
                folder.display()
            ),
            _ => Ok(()),
        }
    }

    /// Steps that the checkpoint has behind it; 0 without one.
    ///
    /// # Errors
    /// It is damaged.
    pub fn steps_taken(&self) -> Result<u64> {
        let path = self.folder().join(files::CHECKPOINT);
        if !path.exists() {
            return Ok(0);
        }
        steps_taken(&path, self.repeats).with_context(|| format!("{}: cannot be resumed", path.display()))
    }

    /// The weights that the training made: its teacher.
    #[must_use]
    pub fn trained(&self) -> PathBuf {
        self.folder().join(files::TEACHER)
    }

    /// Copies them to `--out`, beside and renamed: they are there whole or not at all.
    ///
    /// # Errors
    /// There are none, or the place cannot be written.
    pub fn keep(&self) -> Result<()> {
        let (trained, beside) = (self.trained(), self.out.with_extension("part"));
        ensure!(trained.is_file(), "{}: the trainer left no weights", trained.display());
        std::fs::copy(&trained, &beside).and_then(|_| std::fs::rename(&beside, &self.out)).with_context(|| {
            format!("{}: cannot be written; the weights are in {}", self.out.display(), trained.display())
        })
    }

    /// The graph of the training from a step on. `labels` are the parameters that say where labels and losses come from.
    ///
    /// # Errors
    /// An option that the graph cannot take.
    pub fn graph(&self, initial_poses: &InitialPoses, labels: &Value, first_step: u64) -> Result<Graph> {
        let mut graph = adapt_graph()?;
        graph.seed = self.seed;
        graph.window = (3 * self.batch).clamp(8, 64);
        graph.set_params(&json!({
            "source": self.bags[0],
            "also": self.bags[1..],
            "initial_poses": initial_poses,
            "objects": self.objects,
            "weights": self.weights,
            "network": network(&self.network)?,
            "device": self.device,
            "size_px": self.label_px(),
            "views": self.views,
            "held_out_every": self.held_out_every,
            "samples": (self.steps - first_step) * self.batch,
            "steps": self.steps,
            "frames_per_step": self.batch,
            "repeats": self.repeats,
            "first_step": first_step,
            "first_frame": first_step * self.batch,
            "max_lr": self.max_lr,
            "out": self.folder(),
        }))?;
        graph.set_params(labels)?;
        // What a graph leaves to the nodes where nothing is said is no parameter.
        let given = [
            ("player.only_objects", json!(self.only_objects)),
            ("player.sampling.budget_frames", json!(self.budget_frames)),
            ("trainer.student_px", json!(self.size)),
            ("trainer.ema_alpha", json!(self.ema)),
            ("trainer.keep_every", json!(self.keep_every)),
        ];
        for (key, value) in given.iter().filter(|(_, value)| !value.is_null()) {
            graph.set(key, &value.to_string())?;
        }
        Ok(graph)
    }
}

/// `config/graphs/adapt.yaml` as it is.
///
/// # Errors
/// It is no graph.
pub fn adapt_graph() -> Result<Graph> {
    Ok(Graph::parse(GRAPH, Path::new("config/graphs/adapt.yaml"))?)
}

/// Lets the views be rendered around the initial poses as they come, as in the paper.
pub fn look_once(graph: &mut Graph) {
    take_out(graph, &FIRST_LOOK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_graphs_own_steps_and_samples_agree() {
        let graph = adapt_graph().unwrap();
        let number = |name: &str| graph.params[name].as_u64().unwrap();
        assert_eq!(number("samples"), number("steps") * number("frames_per_step"));
    }

    #[test]
    fn what_a_node_gave_goes_with_it() {
        let mut graph = adapt_graph().unwrap();
        look_once(&mut graph);
        assert!(!graph.nodes.contains_key("look") && !graph.nodes["renderer"].inputs.contains_key("around"));
        assert_eq!(graph.feedback.len(), 1, "the other flow node still takes the weights");
        take_out(&mut graph, &["trainer"]);
        assert!(graph.feedback.is_empty() && graph.nodes["flow"].inputs.len() == 1);
    }
}
