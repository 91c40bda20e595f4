//! `pseudoflow adapt`: self-supervised training from recordings, then the judgement of what it brought.

mod chart;
mod find;
mod judge;
mod progress;
mod report;
mod training;

use anyhow::{Context as _, Result, bail, ensure};
use judge::judge;
use pseudoflow_network::ComputeDevice;
use pseudoflow_runtime::supervisor;
use pseudoflow_trainer::adapt::label_px;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args, Debug, Clone)]
pub(crate) struct Args {
    /// Recordings without annotations: rosbag2 folders, .mcap files or BOP scenes.
    #[arg(long = "bag", required = true, num_args = 1..)]
    bags: Vec<PathBuf>,
    /// The object set: a BOP `models/` folder.
    #[arg(long)]
    objects: PathBuf,
    /// Initial poses: a topic (`/initial_poses`), a BOP result file (.csv), a file as `init_poses.json`, or the weights of an
    /// initializer (.safetensors), which then searches every frame. BOP scenes bring their own.
    #[arg(long)]
    init: Option<String>,
    /// Weights to begin with (.safetensors).
    #[arg(long)]
    weights: PathBuf,
    /// The weights to write, if they are better. Log, checkpoint and report stand in a folder of the same name.
    #[arg(long)]
    out: PathBuf,
    /// What trains and labels: auto, cpu, vulkan[:N] or cuda[:N]. A training may go on with another one.
    #[arg(long, default_value = "auto")]
    device: ComputeDevice,
    /// Training steps. A hundred take about half an hour on two cores.
    #[arg(long, default_value_t = 100)]
    steps: u64,
    /// Instances in a step.
    #[arg(long, default_value_t = 4)]
    batch: u64,
    /// Updates of the student with the labels of a step, each with other colours.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=64))]
    repeats: u64,
    /// Rendered views of each instance.
    #[arg(long, default_value_t = 4)]
    views: u32,
    /// Other frames that the photometric loss compares with.
    #[arg(long, default_value_t = 1)]
    partners: u32,
    /// Largest disagreement of a label between the views, pixels of a 256 px crop. The paper's 1 wants a teacher that is good
    /// already.
    #[arg(long, default_value_t = 2.0)]
    tau: f32,
    /// Weight of the flow loss.
    #[arg(long, default_value_t = 1.0)]
    flow_weight: f64,
    /// Weight of the photometric loss.
    #[arg(long, default_value_t = 0.5)]
    photo_weight: f64,
    /// Accepts every label of the teacher, whether or not the views agree (the paper's baseline).
    #[arg(long)]
    accept_all_labels: bool,
    /// Renders the views around the initial poses as they are, instead of those that the teacher finds from them.
    #[arg(long)]
    single_look: bool,
    /// What a label is: the teacher's flow in each view (`teacher_flow`; paper, eq. 5), the mean of all views' votes, or
    /// where the one motion that explains most votes takes the pixel.
    #[arg(long, default_value = "rigid", value_parser = LABELS)]
    label: String,
    /// The network that the weights belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Width and height of the crops that the network will see in use, and the student in training, pixels.
    #[arg(long, default_value_t = 128)]
    size: u32,
    /// Width and height of the crops that the teacher labels, pixels: `--size` times 1, 2 or 4. Labels are better where
    /// it looks closer. [default: 256, or `--size` where that is more]
    #[arg(long)]
    label_size: Option<u32>,
    /// Peak of the one-cycle learning rate; the paper's 4e-4 wants its hundreds of thousands of steps.
    #[arg(long, default_value_t = 2e-4)]
    max_lr: f64,
    /// Share of the old teacher in the new one after a step. [default: its memory is a twentieth of the training, and 0.999,
    /// the paper's, at most]
    #[arg(long)]
    ema: Option<f64>,
    /// Keeps the teacher of every n-th step, in the folder `teachers` of the training.
    #[arg(long)]
    keep_every: Option<u64>,
    /// Uses this many frames of the recordings only; an initializer then searches twice as many.
    #[arg(long)]
    budget_frames: Option<u64>,
    /// Every n-th frame is left out of the training and used to judge it.
    #[arg(long, default_value_t = 5)]
    held_out_every: u64,
    /// Records samples and labels as topics (rosbag2 folder): rendering, crop, flow, sigma, valid labels.
    #[arg(long)]
    record: Option<PathBuf>,
    /// Writes OUT without a look at the held-out frames, for those who measure otherwise.
    #[arg(long)]
    unjudged: bool,
    /// Folder of the report; without: that of the training.
    #[arg(long)]
    report: Option<PathBuf>,
    /// Goes on from the checkpoint of an interrupted training.
    #[arg(long)]
    resume: bool,
    /// Only those of these objects.
    #[arg(long, num_args = 1..)]
    only_objects: Option<Vec<u32>>,
    /// Seed of the run.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The labels of [`pseudoflow_consistency::Label`], as in a graph file.
const LABELS: [&str; 3] = ["teacher_flow", "mean_vote", "rigid"];

/// The exit code of a training that made nothing better.
const NOT_BETTER: u8 = 3;

impl Args {
    /// Width and height of the teacher's crops.
    fn label_px(&self) -> u32 {
        label_px(self.label_size, self.size)
    }

    /// Where the training keeps its things.
    fn folder(&self) -> PathBuf {
        self.out.with_extension("adapt")
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    check(args)?;
    let folder = args.folder();
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let found = find::initializer(args).map(|weights| find::find(args, weights, &folder)).transpose()?;
    let args = &Args { init: found.map(|file| file.display().to_string()).or(args.init.clone()), ..args.clone() };
    let Some(trained) = train(args, &folder)? else { return Ok(ExitCode::FAILURE) };
    if args.unjudged {
        keep(&trained, &args.out)?;
        println!("{} (not judged)", args.out.display());
        return Ok(ExitCode::SUCCESS);
    }
    let verdict = judge(args, &trained)?;
    let page = report::write(args, &folder, &verdict)?;
    println!("{}", verdict.text());
    println!("report: {}", page.display());
    if !verdict.better() {
        println!("{} was not written: the held-out frames do not show a gain", args.out.display());
        return Ok(ExitCode::from(NOT_BETTER));
    }
    keep(&trained, &args.out)?;
    println!("{}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

fn check(args: &Args) -> Result<()> {
    ensure!(args.steps > 0 && args.batch > 0, "`--steps` and `--batch`: give at least 1");
    ensure!(args.held_out_every >= 2, "`--held-out-every {}`: give at least 2", args.held_out_every);
    ensure!(args.weights.is_file(), "`--weights {}`: no such file", args.weights.display());
    let (folder, started) = (args.folder(), args.folder().join(training::CHECKPOINT));
    match (args.resume, started.exists()) {
        (true, false) => bail!("`--resume`: there is no {}: leave `--resume` out", started.display()),
        (false, true) => bail!(
            "{} holds an earlier training: go on with `--resume`, or remove the folder, or give another `--out`",
            folder.display()
        ),
        _ => Ok(()),
    }
}

/// Runs the graph; `None` when it was asked to stop before the last step.
fn train(args: &Args, folder: &Path) -> Result<Option<PathBuf>> {
    let trained = folder.join(training::TEACHER);
    let first_step = training::steps_taken(folder, args.repeats)?;
    if first_step < args.steps {
        let graph = training::graph(args, folder, first_step)?;
        let options = supervisor::Options { print: false, ..supervisor::Options::new(&folder.join("run")) };
        let bar = progress::Watch::start(folder, args.steps);
        let summary = supervisor::run(&graph, &crate::registry(), &options);
        bar.stop();
        if matches!(summary, Err(supervisor::SupervisorError::Killed(_))) {
            // Asked to stop, in the middle of a step: what is in the last checkpoint stays.
            println!("stopped; go on with the same command and `--resume`");
            return Ok(None);
        }
        let summary = summary.with_context(|| format!("training stopped; its log is {}", options.run_dir.display()))?;
        training::print_stages(&summary);
        if summary.asked_to_stop {
            println!("stopped; go on with the same command and `--resume`");
            return Ok(None);
        }
    }
    ensure!(trained.is_file(), "{}: the trainer left no weights", trained.display());
    Ok(Some(trained))
}

/// Copies beside and renames.
fn keep(trained: &Path, out: &Path) -> Result<()> {
    let beside = out.with_extension("part");
    std::fs::copy(trained, &beside)
        .and_then(|_| std::fs::rename(&beside, out))
        .with_context(|| format!("{}: cannot be written; the weights are in {}", out.display(), trained.display()))
}
