use super::Args;
use anyhow::Result;
use pseudoflow_cli::training::look_once;
use pseudoflow_player::InitialPoses;
use pseudoflow_runtime::supervisor::Summary;
use pseudoflow_runtime::{Graph, NodeSpec};
use serde_json::json;
use std::path::Path;

/// Folder of label pictures, and how many of them.
pub(super) const LABELS: &str = "labels";
const PICTURES: u64 = 12;

/// The graph of `config/graphs/adapt.yaml` with the arguments put in.
pub(super) fn graph(args: &Args, first_step: u64) -> Result<Graph> {
    let labels = json!({
        "partners": args.labels.partners,
        "stages": args.labels.stages,
        "label": args.labels.label,
        "tau": args.labels.tau,
        "accept_all": args.labels.accept_all_labels,
        "flow_weight": args.labels.flow_weight,
        "photo_weight": args.labels.photo_weight,
    });
    let mut graph = args.training.graph(&initial_poses(args), &labels, first_step)?;
    let samples = (args.training.steps - first_step) * args.training.batch;
    graph.set("consistency.picture_every", &(samples / PICTURES).max(1).to_string())?;
    graph.set("consistency.pictures", &json!(args.training.folder().join(LABELS)).to_string())?;
    if args.labels.single_look {
        look_once(&mut graph);
    }
    if let Some(path) = &args.record {
        graph.nodes.insert("recorder".into(), recorder(path)?);
    }
    Ok(graph)
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

/// Topic or file that `--init` names.
pub(super) fn initial_poses(args: &Args) -> InitialPoses {
    match &args.init {
        None => InitialPoses::default(),
        Some(file) if Path::new(file).is_file() => InitialPoses { file: Some(file.into()), topic: None },
        Some(topic) => InitialPoses { topic: Some(topic.clone()), file: None },
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
