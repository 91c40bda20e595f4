use super::Args;
use anyhow::{Context as _, Result};
use pseudoflow_runtime::supervisor::Summary;
use pseudoflow_runtime::{Graph, NodeSpec};
use serde_json::json;
use std::path::Path;

pub(super) use pseudoflow_trainer::adapt::files::{CHECKPOINT, LOG, TEACHER};

const GRAPH: &str = include_str!("../../../../../config/graphs/adapt.yaml");

/// Folder of label pictures, and how many of them.
pub(super) const LABELS: &str = "labels";
const PICTURES: u64 = 12;

/// Steps that the checkpoint in a folder has behind it; 0 without one.
pub(super) fn steps_taken(folder: &Path, repeats: u64) -> Result<u64> {
    let path = folder.join(CHECKPOINT);
    if !path.exists() {
        return Ok(0);
    }
    pseudoflow_trainer::adapt::steps_taken(&path, repeats)
        .with_context(|| format!("{}: cannot be resumed", path.display()))
}

/// The graph of `config/graphs/adapt.yaml` with the arguments put in.
pub(super) fn graph(args: &Args, folder: &Path, first_step: u64) -> Result<Graph> {
    let mut graph = Graph::parse(GRAPH, Path::new("config/graphs/adapt.yaml"))?;
    let (samples, first) = ((args.steps - first_step) * args.batch, first_step * args.batch);
    let (topic, file) = initial_poses(args);
    let network = serde_json::to_value(super::super::export::network(&args.network)?)?;
    let settings = [
        ("seed", json!(args.seed)),
        ("window", json!((3 * args.batch).clamp(8, 64))),
        ("source", json!(args.bags[0])),
        ("objects", json!(args.objects)),
        ("weights", json!(args.weights)),
        ("network", network),
        ("device", json!(args.device)),
        ("size_px", json!(args.label_px())),
        ("views", json!(args.views)),
        ("frames_per_step", json!(args.batch)),
        ("first_step", json!(first_step)),
        ("first_frame", json!(first)),
        ("out", json!(folder)),
        ("player.also", json!(args.bags[1..])),
        ("player.only_objects", json!(args.only_objects)),
        ("player.initial_poses", json!({"topic": topic, "file": file})),
        ("player.sampling.samples", json!(samples)),
        ("player.sampling.partners", json!(args.partners)),
        ("player.sampling.held_out_every", json!(args.held_out_every)),
        ("player.sampling.budget_frames", json!(args.budget_frames)),
        ("consistency.tau_px_at_256", json!(args.tau)),
        ("consistency.label", json!(args.label)),
        ("consistency.accept_all", json!(args.accept_all_labels)),
        ("consistency.picture_every", json!((samples / PICTURES).max(1))),
        ("consistency.pictures", json!(folder.join(LABELS))),
        ("trainer.student_px", json!(args.size)),
        ("trainer.steps", json!(args.steps)),
        ("trainer.repeats", json!(args.repeats)),
        ("trainer.max_lr", json!(args.max_lr)),
        ("trainer.ema_alpha", json!(args.ema)),
        ("trainer.keep_every", json!(args.keep_every)),
        ("trainer.flow_weight", json!(args.flow_weight)),
        ("trainer.photo_weight", json!(args.photo_weight)),
    ];
    for (key, value) in settings {
        graph.set(key, &value.to_string())?;
    }
    if args.single_look {
        look_once(&mut graph)?;
    }
    if let Some(path) = &args.record {
        graph.nodes.insert("recorder".into(), recorder(path)?);
    }
    Ok(graph)
}

/// Renders the views around the initial poses as they come, as in the paper.
fn look_once(graph: &mut Graph) -> Result<()> {
    graph.nodes.retain(|name, _| !["look", "look_flow", "pnp"].contains(&name.as_str()));
    let renderer = graph.nodes.get_mut("renderer").context("the graph has a renderer")?;
    renderer.inputs.shift_remove("around");
    Ok(())
}

/// Samples and the pictures of their labels, ten a second in the order of the training.
fn recorder(path: &Path) -> Result<NodeSpec> {
    let node = json!({
        "kind": "recorder",
        "inputs": {
            "frame": "player/frame",
            "initial_poses": "player/initial_poses",
            "pictures": "consistency/pictures",
        },
        "config": {"path": path, "period_ms": 100},
    });
    Ok(serde_json::from_value(node)?)
}

/// Topic and file that `--init` names.
pub(super) fn initial_poses(args: &Args) -> (Option<String>, Option<String>) {
    match &args.init {
        None => (None, None),
        Some(file) if Path::new(file).is_file() => (None, Some(file.clone())),
        Some(topic) => (Some(topic.clone()), None),
    }
}

/// Busy share and times of the stages.
pub(super) fn print_stages(summary: &Summary) {
    println!("{:12} {:>7} {:>7} {:>10} {:>10}", "node", "frames", "busy %", "ms p50", "ms p99");
    for node in &summary.nodes {
        if let Some([p50, p99]) = node.work_ms {
            let busy = 100.0 * node.busy.unwrap_or(0.0);
            println!("{:12} {:>7} {busy:>7.0} {p50:>10.1} {p99:>10.1}", node.name, node.frames);
        }
    }
}
