//! `pseudoflow bench`: whether this computer keeps up with a camera. A recording is played in real time into a live graph; what
//! came when, and how right it was, becomes a report.

mod beside;

use super::run::read_graph;
use anyhow::{Context as _, Result, bail, ensure};
use beside::Beside;
use pseudoflow_evaluator::live::{Expectation, LiveReport, LiveRun, NodeCost, read_arrivals};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_player::{PlayerConfig, open_recording};
use pseudoflow_runtime::supervisor::{self, Summary};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// What is played: a rosbag2 folder, an .mcap file, or a BOP scene folder.
    #[arg(long)]
    source: PathBuf,
    /// Folder of the object set; takes the place of `objects` in every node of the graph.
    #[arg(long)]
    objects: PathBuf,
    /// Scores against the ground truth of this BOP scene folder.
    #[arg(long, conflicts_with = "reference")]
    truth: Option<PathBuf>,
    /// Scores against this BOP result file of a method that is believed.
    #[arg(long)]
    reference: Option<PathBuf>,
    /// Only poses of the reference with at least this score count.
    #[arg(long, default_value_t = 0.0, requires = "reference")]
    sure: f64,
    /// Frames per second.
    #[arg(long, default_value_t = 30.0)]
    hz: f64,
    /// Plays at most this many frames.
    #[arg(long)]
    max_frames: Option<u64>,
    /// Folder for `report.json`, `report.html` and what the run leaves behind.
    #[arg(long)]
    report: PathBuf,
    /// The graph; its camera or player becomes the recording, and what publishes or records becomes a stopwatch.
    #[arg(long, default_value = "config/graphs/live_track.yaml")]
    graph: PathBuf,
    /// Overrides, as for `run`.
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    overrides: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let (run, asked_to_stop) = play(args)?;
    if asked_to_stop {
        return Ok(ExitCode::FAILURE);
    }
    let report = LiveReport::new(&run, &ObjectSet::load(&args.objects)?, expectation(args)?.as_ref())?;
    report.write_json(&args.report.join("report.json"))?;
    report.write_html(&args.report.join("report.html"))?;
    println!("{report}");
    println!("report: {0}/report.json   {0}/report.html", args.report.display());
    Ok(ExitCode::SUCCESS)
}

fn expectation(args: &Args) -> Result<Option<Expectation>> {
    match (&args.truth, &args.reference) {
        (Some(truth), _) => Ok(Some(Expectation::of_truth(truth).context("--truth")?)),
        (None, Some(results)) => Ok(Some(Expectation::of_reference(results, args.sure).context("--reference")?)),
        (None, None) => Ok(None),
    }
}

/// Plays the recording; also says whether it was asked to stop.
fn play(args: &Args) -> Result<(LiveRun, bool)> {
    ensure!(
        args.objects.join("models_info.json").is_file(),
        "--objects {}: no BOP models folder",
        args.objects.display()
    );
    // Wrong truth should not be found out after the recording was played.
    expectation(args)?;
    let frames = frames(args)?;
    let arrivals = args.report.join("arrivals.jsonl");
    let beside = Beside {
        source: &args.source,
        objects: &args.objects,
        hz: args.hz,
        max_frames: args.max_frames,
        arrivals: &arrivals,
    };
    let mut graph = beside.graph(read_graph(&args.graph, &[])?)?;
    for text in &args.overrides {
        let (key, value) = text.split_once('=').with_context(|| format!("`--set {text}`: write KEY=VALUE"))?;
        graph.set(key, value)?;
    }
    let folder = args.report.join("run");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("{}: cannot be replaced", folder.display()))?;
    }
    let summary = supervisor::run(&graph, &crate::registry(), &supervisor::Options::new(&folder))?;
    let run = LiveRun {
        source: args.source.display().to_string(),
        graph: args.graph.display().to_string(),
        hz: args.hz,
        nodes: costs(&summary, frames.len()),
        frames,
        arrivals: read_arrivals(&arrivals)?,
        startup_s: summary.startup_s.unwrap_or(0.0),
    };
    Ok((run, summary.asked_to_stop))
}

/// Scene and image of each frame that will be played.
fn frames(args: &Args) -> Result<Vec<(u32, u32)>> {
    let mut source = open_recording(&PlayerConfig::new(args.source.clone())).context("--source")?;
    let count = args.max_frames.map_or(source.count(), |most| source.count().min(most as usize));
    if count == 0 {
        bail!("--source {}: no frame in it", args.source.display());
    }
    let ids = (0..count).map(|number| source.facts(number).map(|facts| (facts.scene_id, facts.image_id)));
    Ok(ids.collect::<Result<_, _>>()?)
}

/// What each node used; the stopwatch and the player are no part of what is measured, but run beside it.
fn costs(summary: &Summary, frames: usize) -> Vec<(String, NodeCost)> {
    let cost = |node: &supervisor::NodeSummary| NodeCost {
        cpu_ms_per_frame: node.cpu_ms[1] / frames.max(1) as f64,
        startup_cpu_ms: node.cpu_ms[0],
        frames: node.frames,
        work_ms: node.work_ms,
    };
    summary.nodes.iter().map(|node| (node.name.clone(), cost(node))).collect()
}

/// A path as graphs write it.
fn text(path: &Path) -> serde_yaml::Value {
    serde_yaml::Value::String(path.display().to_string())
}
