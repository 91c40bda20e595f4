use crate::audit_node::{AuditConfig, TAUS_AT_256, Tally};
use crate::truth::TruthFiles;
use anyhow::{Context as _, Result, ensure};
use pseudoflow_cli::graphs::network;
use pseudoflow_cli::in_process::{Written, take_out};
use pseudoflow_cli::training::{adapt_graph, look_once};
use pseudoflow_player::{PlayerConfig, open_recording};
use pseudoflow_runtime::{Draws, Graph, Stride, read_lines};
use serde_json::{Value, json};
use std::num::NonZeroU64;
use std::path::PathBuf;

/// Prints, for each tau, the share of the object's pixels that keep a label, and the share of these within 2 px (of a
/// 256 px crop) of the truth.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Recordings: BOP scenes, whose names are those of `--truth`.
    #[arg(long = "bag", required = true, num_args = 1..)]
    bags: Vec<PathBuf>,
    /// Folder of `SCENE/scene_gt.json`.
    #[arg(long)]
    truth: PathBuf,
    /// The object set: a BOP `models/` folder.
    #[arg(long)]
    objects: PathBuf,
    /// The teacher's weights.
    #[arg(long)]
    weights: PathBuf,
    /// The network that the weights belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Width and height of the crops, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Looks at every n-th frame.
    #[arg(long, default_value = "4")]
    every: NonZeroU64,
    /// Fewest views that must see a point.
    #[arg(long, default_value_t = 3)]
    min_views: usize,
    /// What a label is: `teacher_flow`, `mean_vote` or `rigid`, as for `pseudoflow adapt`.
    #[arg(long, default_value = "teacher_flow")]
    label: String,
    /// Looks twice: the views are rendered around the pose that the teacher finds from the initial one.
    #[arg(long)]
    refine_first: bool,
    /// What that pose is found from: `flow`, or `joint` with the contour.
    #[arg(long, default_value = "flow", value_parser = ["flow", "joint"])]
    stages: String,
    /// Draws the labels of the first frames into this folder.
    #[arg(long)]
    pictures: Option<PathBuf>,
    /// Folder of the graph and of the counts.
    #[arg(long, default_value = "out/audit")]
    out: PathBuf,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// No label is refused, for the counts are by tau: the largest that a graph can say.
const EVERY_TAU: f32 = 64.0;
/// Fields in one run of the network.
const MAX_BATCH: u32 = 8;

/// What labels are made by in `adapt.yaml`, and the audit in the trainer's place.
fn graph(args: &Args) -> Result<Graph> {
    let mut graph = adapt_graph()?;
    graph.seed = args.seed;
    graph.set_params(&json!({
        "source": args.bags[0],
        "also": args.bags[1..],
        "initial_poses": {},
        "objects": args.objects,
        "weights": args.weights,
        "network": network(&args.network)?,
        "size_px": args.size,
        "stages": args.stages,
        "label": args.label,
        "tau": EVERY_TAU,
    }))?;
    take_out(&mut graph, &["trainer"]);
    if !args.refine_first {
        look_once(&mut graph);
    }
    graph.nodes["renderer"].inputs.shift_remove("partners");
    let frames = Stride { start: 0, step: args.every };
    // What is drawn depends on an image's place in the recordings, whichever are looked at.
    let draws = Draws { name: Some("with-truth".into()), frames, ..Draws::default() };
    let settings = [
        ("player", "sampling", Value::Null),
        ("player", "frames", json!(frames)),
        ("renderer", "draws", json!(draws)),
        ("pnp", "draws", json!(draws)),
        ("flow", "lockstep", Value::Null),
        ("flow", "max_batch", json!(MAX_BATCH)),
        ("look_flow", "lockstep", Value::Null),
        ("consistency", "min_views", json!(args.min_views)),
    ];
    for (node, key, value) in settings {
        if graph.nodes.contains_key(node) {
            graph.set(&format!("{node}.{key}"), &value.to_string())?;
        }
    }
    let truth = TruthFiles { poses: args.truth.clone(), objects: args.objects.clone() };
    let config = AuditConfig { truth, lines: counts(args), pictures: args.pictures.clone() };
    let inputs = json!({"views": "renderer/views", "flow": "flow/flow", "labels": "consistency/labels"});
    let node = json!({"kind": "audit", "inputs": inputs, "config": config});
    graph.nodes.insert("audit".into(), serde_json::from_value(node)?);
    Ok(graph)
}

fn counts(args: &Args) -> PathBuf {
    args.out.join("counts.jsonl")
}

pub(crate) fn run(args: &Args) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("{}: cannot be made", args.out.display()))?;
    let recordings = PlayerConfig { also: args.bags[1..].to_vec(), ..PlayerConfig::new(args.bags[0].clone()) };
    let frames = (open_recording(&recordings)?.count() as u64).div_ceil(args.every.get());
    let written = Written { graph: &graph(args)?, file: &args.out.join("audit.yaml") };
    written.run(&crate::registry(), "audit", frames, 0)?;
    let tally: Tally = read_lines::<Tally>(&counts(args))?.into_iter().sum();
    ensure!(tally.visible > 0, "no frame shows an object whose pose is known");
    print(&tally);
    Ok(())
}

fn print(tally: &Tally) {
    println!("without a rule: {:.3} within 2 px", tally.all_right as f64 / tally.visible as f64);
    println!("{:>12} {:>10} {:>14}", "tau at 256", "kept", "within 2 px");
    for (i, tau) in TAUS_AT_256.iter().enumerate() {
        let kept = tally.kept[i] as f64 / tally.visible as f64;
        let right = tally.right[i] as f64 / tally.kept[i].max(1) as f64;
        println!("{tau:>12} {kept:>10.3} {right:>14.3}");
    }
}
