//! `pseudoflow adapt`: self-supervised training from recordings, then the judgement of what it brought.

mod chart;
mod find;
mod judge;
mod progress;
mod report;
mod training;

use anyhow::{Context as _, Result};
use pseudoflow_cli::RARE;
use pseudoflow_cli::training::TrainingArgs;
use pseudoflow_player::PlayerConfig;
use pseudoflow_runtime::{Graph, supervisor};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args, Debug, Clone)]
pub(crate) struct Args {
    #[command(flatten)]
    training: TrainingArgs,
    /// Initial poses: a topic, a file, or the weights of an initializer.
    ///
    /// A topic (`/initial_poses`), a BOP result file (.csv), a file as `init_poses.json`, or an initializer
    /// (.safetensors), which then searches every frame. BOP scenes bring their own.
    #[arg(long)]
    init: Option<String>,
    #[command(flatten)]
    labels: LabelArgs,
    /// Records samples and labels as topics, a rosbag2 folder.
    ///
    /// Rendering, crop, flow, sigma, valid labels.
    #[arg(long)]
    record: Option<PathBuf>,
    /// Writes OUT without a look at the held-out frames.
    ///
    /// For those who measure otherwise.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    unjudged: bool,
    /// Folder of the report; without: that of the training.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    report: Option<PathBuf>,
}

/// How labels are made, and what is learned from them.
#[derive(clap::Args, Debug, Clone)]
pub(crate) struct LabelArgs {
    /// Other frames that the photometric loss compares with.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value_t = 1)]
    partners: u32,
    /// Largest disagreement of a label between the views, pixels of a 256 px crop.
    ///
    /// The paper's 1 wants a teacher that is good already.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value_t = 2.0)]
    tau: f32,
    /// Weight of the flow loss.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value_t = 1.0)]
    flow_weight: f64,
    /// Weight of the photometric loss.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value_t = 0.5)]
    photo_weight: f64,
    /// Accepts every label of the teacher, whether or not the views agree.
    ///
    /// The paper's baseline.
    #[arg(long, help_heading = LABELLING, hide_short_help = true)]
    accept_all_labels: bool,
    /// Renders the views around the initial poses as they are.
    ///
    /// Instead of those that the teacher finds from them.
    #[arg(long, help_heading = LABELLING, hide_short_help = true)]
    single_look: bool,
    /// What the teacher's first look finds a pose from: flow, or joint, with the contour.
    ///
    /// On plain things in clutter a flow network alone finds few poses, and where poses are wrong no labels agree.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value = "flow", value_parser = ["flow", "joint"])]
    stages: String,
    /// What a label is.
    ///
    /// The teacher's flow in each view (`teacher_flow`; paper, eq. 5), the mean of all views' votes, or where the one
    /// motion that explains most votes takes the pixel.
    #[arg(long, help_heading = LABELLING, hide_short_help = true, default_value = "rigid", value_parser = LABELS)]
    label: String,
}

/// Heading of the options about labels, which `-h` leaves out, too.
const LABELLING: &str = "Labels, and what is learned from them";

/// The labels of [`pseudoflow_consistency::Label`], as in a graph file.
const LABELS: [&str; 3] = ["teacher_flow", "mean_vote", "rigid"];

/// The exit code of a training that made nothing better.
const NOT_BETTER: u8 = 3;

impl Args {
    /// The recordings from begin to end, to look into them.
    fn recordings(&self) -> PlayerConfig {
        let bags = &self.training.bags;
        PlayerConfig { also: bags[1..].to_vec(), ..PlayerConfig::new(bags[0].clone()) }
    }

    /// Lets a node of a graph send poses of wanted objects only.
    fn only_objects(&self, graph: &mut Graph, node: &str) -> Result<()> {
        let set = |only| graph.set(&format!("{node}.only_objects"), &serde_json::json!(only).to_string());
        Ok(self.training.only_objects.as_ref().map_or(Ok(()), set)?)
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    args.training.check()?;
    let (folder, out) = (args.training.folder(), &args.training.out);
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let found = find::initializer(args).map(|weights| find::find(args, weights, &folder)).transpose()?;
    let args = &Args { init: found.map(|file| file.display().to_string()).or(args.init.clone()), ..args.clone() };
    if !train(args, &folder)? {
        return Ok(ExitCode::FAILURE);
    }
    if args.unjudged {
        args.training.keep()?;
        println!("{} (not judged)", out.display());
        return Ok(ExitCode::SUCCESS);
    }
    let report = args.report.as_deref().unwrap_or(&folder);
    let judgement = judge::judge(args, &args.training.trained(), report)?;
    let page = report::write(args, &folder, &judgement, report)?;
    println!("{}", judge::text(&judgement.verdict));
    println!("report: {}", page.display());
    if !judgement.verdict.better() {
        println!("{} was not written: the held-out frames do not show a gain", out.display());
        return Ok(ExitCode::from(NOT_BETTER));
    }
    args.training.keep()?;
    println!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}

/// Runs the graph; false when it was asked to stop before the last step.
fn train(args: &Args, folder: &Path) -> Result<bool> {
    let (first_step, steps) = (args.training.steps_taken()?, args.training.steps);
    if first_step < steps {
        let graph = training::graph(args, first_step)?;
        let options = supervisor::Options { print: false, ..supervisor::Options::new(&folder.join("run")) };
        let bar = progress::Watch::start(folder, steps);
        let summary = supervisor::run(&graph, &crate::registry(), &options);
        bar.stop();
        if matches!(summary, Err(supervisor::SupervisorError::Killed(_))) {
            // Asked to stop, in the middle of a step: what is in the last checkpoint stays.
            println!("stopped; go on with the same command and `--resume`");
            return Ok(false);
        }
        let summary = summary.with_context(|| format!("training stopped; its log is {}", options.run_dir.display()))?;
        training::print_stages(&summary);
        if summary.asked_to_stop {
            println!("stopped; go on with the same command and `--resume`");
            return Ok(false);
        }
    }
    Ok(true)
}
