//! `pseudoflow demo`: a recording played in real time; objects are found and followed, and every pose is scored.

mod pictures;

use super::bench::played::{play, player};
use super::run::read_graph;
use anyhow::{Context as _, Result};
use pseudoflow_evaluator::live::{Expectation, LiveReport};
use pseudoflow_imaging::ObjectSet;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The graph to run.
    #[arg(long, default_value = "config/graphs/demo.yaml", value_parser = pseudoflow_runtime::shipped::input)]
    graph: PathBuf,
    /// Ground truth of its recording, a BOP scene folder.
    #[arg(long, default_value = "bags/tabletop_dense_truth", value_parser = pseudoflow_runtime::shipped::input)]
    truth: PathBuf,
    /// Folder for scores, pictures and the animation.
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let out = args.out.display();
    let arrivals = args.out.join("arrivals.jsonl");
    let graph = read_graph(&args.graph, &[format!("stopwatch.out={}", arrivals.display())])?;
    let player = player(&graph)?;
    let folder = player.objects.clone().context("the graph's player needs `objects`")?;
    let (objects, truth) = (ObjectSet::load(&folder)?, Expectation::of_truth(&args.truth)?);
    let overlays = args.out.join("overlays");
    if overlays.exists() {
        std::fs::remove_dir_all(&overlays).with_context(|| format!("{}: cannot be replaced", overlays.display()))?;
    }
    let Some(run) = play(&graph, &args.out.join("run"), &arrivals, &objects)? else {
        return Ok(ExitCode::FAILURE);
    };
    let report = LiveReport::new(&run, &objects, Some(&truth))?;
    report.write_json(&args.out.join("report.json"))?;
    report.write_html(&args.out.join("report.html"))?;
    pictures::draw(&player, &run.arrivals, &objects, &args.out)?;
    println!("{report}");
    println!(
        "animation: {out}/demo.gif   pictures: {out}/overlays   timeline: {out}/report.html   scores: {out}/report.json"
    );
    Ok(ExitCode::SUCCESS)
}
