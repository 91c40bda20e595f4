use super::ros_args::RosArgs;
use anyhow::{Context as _, Result};
use pseudoflow_runtime::{Graph, graph, supervisor};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The graph, a YAML file.
    graph: PathBuf,
    /// Folder for what the run leaves behind.
    #[arg(long, default_value = "out/run")]
    out: PathBuf,
    /// Overrides, such as `player.source=my.mcap` or `window=8`.
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    overrides: Vec<String>,
    /// Goes on under `RMW_IMPLEMENTATION=rmw_zenoh_cpp`, whose nodes do not hear DDS.
    #[arg(long)]
    allow_rmw_mismatch: bool,
}

#[derive(clap::Args)]
pub(crate) struct CheckArgs {
    /// The graph, a YAML file.
    graph: PathBuf,
    /// Overrides, as for `run`.
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    overrides: Vec<String>,
}

#[derive(clap::Args)]
pub(crate) struct NodeArgs {
    /// Name of the node in its graph.
    name: String,
    /// The graph as it runs.
    #[arg(long)]
    graph: PathBuf,
    /// Folder of the run.
    #[arg(long)]
    run_dir: PathBuf,
}

pub(crate) fn read_graph(path: &std::path::Path, overrides: &[String]) -> Result<Graph> {
    let mut graph = read_stated(path, overrides)?;
    super::inherit::fill_in(&mut graph);
    Ok(graph)
}

/// The graph as file and overrides state it.
fn read_stated(path: &std::path::Path, overrides: &[String]) -> Result<Graph> {
    let mut graph = Graph::read(path)?;
    for text in overrides {
        let (key, value) = text.split_once('=').with_context(|| format!("`--set {text}`: write KEY=VALUE"))?;
        graph.set(key, value)?;
    }
    Ok(graph)
}

/// `ros` is what stood behind `--ros-args` on the command line.
pub(crate) fn run(args: &Args, ros: &RosArgs) -> Result<ExitCode> {
    let mut graph = read_stated(&args.graph, &args.overrides)?;
    ros.apply(&mut graph)?;
    if args.allow_rmw_mismatch {
        allow_rmw_mismatch(&mut graph);
    }
    super::inherit::fill_in(&mut graph);
    supervisor::run(&graph, &crate::registry(), &supervisor::Options::new(&args.out))?;
    Ok(ExitCode::SUCCESS)
}

fn allow_rmw_mismatch(graph: &mut Graph) {
    for node in graph.nodes.values_mut().filter(|node| node.kind == "bridge") {
        if let Some(config) = node.config.as_mapping_mut() {
            config.insert("allow_rmw_mismatch".into(), true.into());
        }
    }
}

pub(crate) fn check(args: &CheckArgs) -> Result<ExitCode> {
    let read = read_graph(&args.graph, &args.overrides)?;
    match graph::check(&read, &crate::registry()) {
        Ok(()) => {
            println!("{}: {} nodes, no problems", args.graph.display(), read.nodes.len());
            Ok(ExitCode::SUCCESS)
        }
        Err(problems) => {
            problems.iter().for_each(|problem| eprintln!("{problem}"));
            Ok(ExitCode::FAILURE)
        }
    }
}

pub(crate) fn schema() -> Result<ExitCode> {
    println!("{}", serde_json::to_string_pretty(&graph::schema(&crate::registry()))?);
    Ok(ExitCode::SUCCESS)
}

pub(crate) fn node(args: &NodeArgs) -> Result<ExitCode> {
    crate::registry().run_node(&args.name, &args.graph, &args.run_dir)?;
    Ok(ExitCode::SUCCESS)
}
