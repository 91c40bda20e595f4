//! Whether a training made the network better, told without any truth: a graph refines the held-out frames with the weights that
//! went in and those that came out ([`pseudoflow_pnp::judge`]).

use super::{Args, training};
use anyhow::{Context as _, Result, ensure};
use pseudoflow_cli::graphs::network;
use pseudoflow_cli::in_process::Written;
use pseudoflow_player::{Sampling, open_recording};
use pseudoflow_pnp::judge::{JudgedFrame, Verdict};
use pseudoflow_runtime::{Graph, Stride, read_lines};
use serde_json::json;
use std::num::NonZeroU64;
use std::path::Path;

const GRAPH: &str = include_str!("../../../../../config/graphs/judge.yaml");

/// At most this many held-out frames are refined.
const MOST_FRAMES: NonZeroU64 = NonZeroU64::new(80).unwrap();

/// The verdict, and what it was made from.
pub(super) struct Judgement {
    pub(super) verdict: Verdict,
    pub(super) frames: Vec<JudgedFrame>,
    /// Which frames of the recordings they are.
    pub(super) played: Stride,
}

/// Refines the held-out frames with the weights that went in and those that came out. `out` gets the verdict.
pub(super) fn judge(args: &Args, trained: &Path, out: &Path) -> Result<Judgement> {
    const ADVICE: &str = "give more frames, or a smaller `--held-out-every`";
    std::fs::create_dir_all(out).with_context(|| format!("{}: cannot be made", out.display()))?;
    let count = open_recording(&args.recordings())?.count() as u64;
    let every = NonZeroU64::new(args.training.held_out_every).context("`--held-out-every 0`: give at least 2")?;
    let played = Sampling::held_out(every, count, MOST_FRAMES);
    ensure!(played.count(count) > 0, "no frame is held out: {ADVICE}");
    let graph = graph(args, trained, out, played)?;
    let written = Written { graph: &graph, file: &out.join("judge.yaml") };
    written
        .run(&crate::registry(), "judging", played.count(count), 0)
        .with_context(|| format!("the held-out frames: {ADVICE}"))?;
    let read = |name: &str| std::fs::read(out.join(name)).with_context(|| format!("{name}: not written"));
    let verdict = serde_json::from_slice(&read("verdict.json")?).context("verdict.json")?;
    Ok(Judgement { verdict, frames: read_lines(&out.join("judged.jsonl"))?, played })
}

fn graph(args: &Args, trained: &Path, out: &Path, frames: Stride) -> Result<Graph> {
    let mut graph = Graph::parse(GRAPH, Path::new("config/graphs/judge.yaml"))?;
    graph.set_params(&json!({
        "source": args.training.bags[0],
        "also": args.training.bags[1..],
        "initial_poses": training::initial_poses(args),
        "frames": frames,
        "objects": args.training.objects,
        "before": args.training.weights,
        "after": trained,
        "network": network(&args.training.network)?,
        "device": args.training.device,
        "size_px": args.training.size,
        "out": out,
    }))?;
    args.only_objects(&mut graph, "player")?;
    Ok(graph)
}

/// The verdict as the terminal and the report show it.
pub(super) fn text(verdict: &Verdict) -> String {
    let row = |name: &str, [a, b]: [f64; 2]| format!("{name:32} {a:>8.3} {b:>8.3}\n");
    format!(
        "held out: {} instances in {} frames\n{:32} {:>8} {:>8}\n{}{}{}{}gain {:+.3}, 95 % interval {:+.3} .. {:+.3}: {}",
        verdict.instances,
        verdict.frames,
        "",
        "before",
        "after",
        row("inlier ratio (does not count)", verdict.inlier_ratio),
        row("correlation with the picture", verdict.photometric),
        row("contrast across the contour", verdict.silhouette),
        row("agreement (sum of these two)", [verdict.before, verdict.after]),
        verdict.after - verdict.before,
        verdict.interval[0],
        verdict.interval[1],
        match verdict.enough() {
            false => "too few frames to tell",
            true if verdict.better() => "better",
            true => "not better",
        },
    )
}
