use super::ros_args::RosArgs;
use anyhow::{Context as _, Result};
use pseudoflow_runtime::{Graph, graph, local, shipped, supervisor};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A graph and what is other than its file says.
#[derive(clap::Args)]
pub(crate) struct GraphArgs {
    /// The graph, a YAML file.
    #[arg(value_parser = shipped::input)]
    graph: PathBuf,
    /// Overrides: `size_px=256`, `player.source=my.mcap`, `window=8`.
    ///
    /// A parameter of the graph, a node's setting, or a setting of the graph itself.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Nodes to leave out: an `evaluator` where there is no truth.
    #[arg(long, value_name = "NODE", value_delimiter = ',')]
    without: Vec<String>,
}

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    graph: GraphArgs,
    /// Folder for what the run leaves behind.
    #[arg(long, default_value = "out/run")]
    out: PathBuf,
    /// Run all nodes in this process, one after the other. Replay graphs only.
    ///
    /// The same results, slower, and easy to debug.
    #[arg(long)]
    in_process: bool,
    /// Goes on under `RMW_IMPLEMENTATION=rmw_zenoh_cpp`, whose nodes do not hear DDS.
    #[arg(long)]
    allow_rmw_mismatch: bool,
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

pub(crate) fn read_graph(path: &Path, overrides: &[String]) -> Result<Graph> {
    let mut graph = read_stated(path, overrides)?;
    fill_in(&mut graph)?;
    Ok(graph)
}

/// What a graph leaves to be found: the files that come with the program, and settings that follow from other nodes'.
fn fill_in(graph: &mut Graph) -> Result<()> {
    shipped::fill_in(graph)?;
    super::inherit::fill_in(graph);
    Ok(())
}

/// The graph as file and overrides state it.
fn read_stated(path: &Path, overrides: &[String]) -> Result<Graph> {
    let mut graph = Graph::read(path)?;
    for text in overrides {
        let (key, value) = text.split_once('=').with_context(|| format!("`--set {text}`: write KEY=VALUE"))?;
        graph.set(key, value)?;
    }
    Ok(graph)
}

impl GraphArgs {
    /// The graph as file and arguments state it.
    fn stated(&self) -> Result<Graph> {
        let mut graph = read_stated(&self.graph, &self.overrides)?;
        for name in &self.without {
            let names = graph.nodes.keys().cloned().collect::<Vec<_>>().join(", ");
            let removed = graph.nodes.shift_remove(name);
            removed
                .with_context(|| format!("`--without {name}`: the graph has no such node: its nodes are {names}"))?;
        }
        Ok(graph)
    }

    fn read(&self) -> Result<Graph> {
        let mut graph = self.stated()?;
        fill_in(&mut graph)?;
        Ok(graph)
    }
}

/// `ros` is what stood behind `--ros-args` on the command line.
pub(crate) fn run(args: &Args, ros: &RosArgs) -> Result<ExitCode> {
    let mut graph = args.graph.stated()?;
    ros.apply(&mut graph)?;
    if args.allow_rmw_mismatch {
        allow_rmw_mismatch(&mut graph);
    }
    fill_in(&mut graph)?;
    if args.in_process {
        return run_in_process(&graph, &args.out);
    }
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

fn run_in_process(graph: &Graph, out: &Path) -> Result<ExitCode> {
    std::fs::create_dir_all(out).with_context(|| format!("`--out {}`: cannot be made", out.display()))?;
    let bar = pseudoflow_cli::progress::progress_spinner("frames");
    let summary = local::run(graph, &crate::registry(), out, &mut |frames| bar.set_position(frames))?;
    bar.finish_and_clear();
    println!("{:16} {:>7} {:>12}", "node", "frames", "ms a frame");
    for node in &summary.nodes {
        let ms = node.work.as_secs_f64() * 1e3 / node.frames.max(1) as f64;
        println!("{:16} {:>7} {ms:>12.1}", node.name, node.frames);
    }
    Ok(ExitCode::SUCCESS)
}

pub(crate) fn draw(args: &GraphArgs) -> Result<ExitCode> {
    print!("{}", graph::mermaid(&args.read()?, &crate::registry())?);
    Ok(ExitCode::SUCCESS)
}

pub(crate) fn check(args: &GraphArgs) -> Result<ExitCode> {
    let problems = pseudoflow_cli::graphs::check(&args.read()?, &args.graph, &crate::registry());
    Ok(if problems == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

pub(crate) fn schema() -> Result<ExitCode> {
    println!("{}", serde_json::to_string_pretty(&graph::schema(&crate::registry()))?);
    Ok(ExitCode::SUCCESS)
}

pub(crate) fn node(args: &NodeArgs) -> Result<ExitCode> {
    crate::registry().run_node(&args.name, &args.graph, &args.run_dir)?;
    Ok(ExitCode::SUCCESS)
}
