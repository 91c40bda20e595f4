use super::run::read_graph;
use anyhow::{Context as _, Result};
use pseudoflow_evaluator::Report;
use pseudoflow_runtime::supervisor::{self, Summary};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The graph to run.
    #[arg(long, default_value = "config/graphs/demo.yaml")]
    graph: PathBuf,
    /// Folder for recording, overlay pictures and scores.
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let out = args.out.display();
    let overrides = [
        format!("recorder.path={out}/recording"),
        format!("recorder.overlay.pictures={out}/overlays"),
        format!("evaluator.out={out}"),
    ];
    let graph = read_graph(&args.graph, &overrides)
        .context("the demo runs in the repository's root folder, where config/ and bags/ are")?;
    // A demo shows this run: what an earlier one left would be gone on with, or mixed in.
    for leftover in ["recording", "overlays", "run"] {
        let folder = args.out.join(leftover);
        if folder.exists() {
            std::fs::remove_dir_all(&folder).with_context(|| format!("{}: cannot be replaced", folder.display()))?;
        }
    }
    let summary = supervisor::run(&graph, &crate::registry(), &supervisor::Options::new(&args.out.join("run")))?;
    if summary.asked_to_stop {
        return Ok(ExitCode::FAILURE);
    }
    let report = Report::read_json(&args.out.join("report.json"))?;
    print!("{}", add_table(&report));
    print!("{}", stage_table(&summary));
    println!("recording: {out}/recording   pictures: {out}/overlays   scores: {out}/report.json");
    Ok(ExitCode::SUCCESS)
}

fn add_table(report: &Report) -> String {
    let mut text = format!("\n{:24} {:>5} {:>16} {:>16}\n", "object", "n", "ADD(-S)-0.1d", "after refinement");
    let mut row = |name: &str, sets: &std::collections::BTreeMap<String, pseudoflow_evaluator::Scores>| {
        let share = |set: &str| sets.get(set).map_or("-".into(), |s| format!("{:.2}", s.add_s_recall));
        let n = sets.get("refined").map_or(0, |s| s.n);
        text += &format!("{name:24} {n:>5} {:>16} {:>16}\n", share("init"), share("refined"));
    };
    for (id, sets) in &report.per_object {
        row(&report.objects.get(id).map_or_else(|| id.to_string(), |o| o.name.clone()), sets);
    }
    row("all", &report.overall);
    text
}

fn stage_table(summary: &Summary) -> String {
    let mut text = format!("\n{:12} {:>7} {:>12} {:>12}\n", "node", "frames", "ms p50", "ms p99");
    for node in &summary.nodes {
        if let Some([p50, p99]) = node.work_ms {
            text += &format!("{:12} {:>7} {p50:>12.1} {p99:>12.1}\n", node.name, node.frames);
        }
    }
    text + "\n"
}
