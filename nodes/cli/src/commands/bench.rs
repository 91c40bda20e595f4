//! `pseudoflow bench`: whether this computer keeps up with a camera. A recording is played in real time into a live graph; what
//! came when, and how right it was, becomes a report.

mod beside;
pub(super) mod played;

use super::run::read_graph;
use anyhow::{Context as _, Result};
use beside::Beside;
use pseudoflow_evaluator::live::{Expectation, LiveReport};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_runtime::Graph;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// What is played: a rosbag2 folder, an .mcap file, or a BOP scene folder.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    source: PathBuf,
    /// Folder of the object set.
    ///
    /// It takes the place of `objects` in every node of the graph.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    objects: PathBuf,
    /// Scores against the ground truth of this BOP scene folder.
    #[arg(long, conflicts_with = "reference", value_parser = pseudoflow_runtime::shipped::input)]
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
    /// Plays it so often, every second time backwards.
    #[arg(long, default_value_t = 1)]
    passes: u32,
    /// Plays at most this many frames.
    #[arg(long)]
    max_frames: Option<u64>,
    /// Folder for `report.json`, `report.html` and what the run leaves behind.
    #[arg(long)]
    report: PathBuf,
    /// The graph; its camera or player becomes the recording.
    ///
    /// What publishes or records becomes a stopwatch.
    #[arg(long, default_value = "config/graphs/live_track.yaml", value_parser = pseudoflow_runtime::shipped::input)]
    graph: PathBuf,
    /// Overrides, as for `run`.
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    overrides: Vec<String>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let models = &args.objects;
    ObjectSet::check(models).context("--objects")?;
    // Wrong truth should not be found out after the recording was played.
    let expectation = expectation(args)?;
    let (objects, arrivals) = (ObjectSet::load(models)?, args.report.join("arrivals.jsonl"));
    let graph = graph(args, &arrivals)?;
    let Some(run) = played::play(&graph, &args.report.join("run"), &arrivals, &objects)? else {
        return Ok(ExitCode::FAILURE);
    };
    let report = LiveReport::new(&run, &objects, expectation.as_ref())?;
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

/// The graph beside the recording.
fn graph(args: &Args, arrivals: &Path) -> Result<Graph> {
    let (source, objects) = (args.source.as_path(), args.objects.as_path());
    let beside = Beside { source, objects, hz: args.hz, passes: args.passes, max_frames: args.max_frames, arrivals };
    let mut graph = beside.graph(read_graph(&args.graph, &[])?)?;
    for text in &args.overrides {
        let (key, value) = text.split_once('=').with_context(|| format!("`--set {text}`: write KEY=VALUE"))?;
        graph.set(key, value)?;
    }
    Ok(graph)
}

/// A path as graphs write it.
fn text(path: &Path) -> serde_yaml::Value {
    serde_yaml::Value::String(path.display().to_string())
}
