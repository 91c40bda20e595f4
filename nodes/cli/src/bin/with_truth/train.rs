use crate::truth::TruthFiles;
use anyhow::{Context as _, Result};
use pseudoflow_cli::in_process::{Written, take_out};
use pseudoflow_cli::training::{FIRST_LOOK, TrainingArgs, files};
use pseudoflow_player::InitialPoses;
use pseudoflow_runtime::Graph;
use pseudoflow_runtime::graph::PortRef;
use serde_json::json;
use std::path::PathBuf;

/// The training of `pseudoflow adapt`, its labels made of the true poses.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    training: TrainingArgs,
    /// Folder of `SCENE/scene_gt.json`; the scenes are named as the recordings.
    #[arg(long)]
    truth: PathBuf,
}

/// Columns of the log that mean something here.
const LOGGED: [&str; 4] = ["step", "loss_flow", "epe_px", "grad_norm"];

/// `adapt.yaml` with the truth in the place of the teacher: what differs is the labels alone.
fn graph(args: &Args, first_step: u64) -> Result<Graph> {
    let labels = json!({"partners": 0, "photo_weight": 0.0});
    let mut graph = args.training.graph(&InitialPoses::default(), &labels, first_step)?;
    take_out(&mut graph, &FIRST_LOOK);
    take_out(&mut graph, &["flow", "consistency"]);
    let truth = TruthFiles { poses: args.truth.clone(), objects: args.training.objects.clone() };
    let node = json!({"kind": "truth", "inputs": {"views": "renderer/views"}, "config": truth});
    let at = graph.nodes.get_index_of("trainer").context("the graph has a trainer")?;
    graph.nodes.shift_insert(at, "truth".into(), serde_json::from_value(node)?);
    for port in ["flow", "labels"] {
        let from = PortRef { node: "truth".into(), port: port.into() };
        graph.nodes["trainer"].inputs.insert(port.into(), from);
    }
    graph.nodes["renderer"].inputs.shift_remove("partners");
    Ok(graph)
}

pub(crate) fn run(args: &Args) -> Result<()> {
    args.training.check()?;
    let (folder, batch, steps) = (args.training.folder(), args.training.batch, args.training.steps);
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let first_step = args.training.steps_taken()?;
    if first_step < steps {
        let written = Written { graph: &graph(args, first_step)?, file: &folder.join("train.yaml") };
        written.run(&crate::registry(), "train", steps * batch, first_step * batch)?;
    }
    let log = std::fs::read_to_string(folder.join(files::LOG)).context("the training's log")?;
    std::fs::write(args.training.out.with_extension("csv"), columns(&log, &LOGGED))?;
    args.training.keep()?;
    println!("{}", args.training.out.display());
    Ok(())
}

/// Columns of a table by name.
fn columns(csv: &str, names: &[&str]) -> String {
    let head: Vec<&str> = csv.lines().next().unwrap_or_default().split(',').collect();
    let places: Vec<usize> = names.iter().filter_map(|name| head.iter().position(|column| column == name)).collect();
    let row = |line: &str| {
        let values: Vec<&str> = line.split(',').collect();
        places.iter().map(|at| values.get(*at).copied().unwrap_or_default()).collect::<Vec<_>>().join(",") + "\n"
    };
    csv.lines().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_keep_the_order_asked_for() {
        assert_eq!(columns("a,b,c\n1,2,3\n4,NaN,6\n", &["c", "a"]), "c,a\n3,1\n6,4\n");
    }
}
