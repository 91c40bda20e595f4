//! The one binary, `pseudoflow`: starts graphs and nodes, and holds the offline commands.

mod commands;

use anyhow::Result;
use clap::{Parser, Subcommand};
use commands::ros_args::{self, RosArgs};
use pseudoflow_runtime::Registry;
use std::process::ExitCode;

/// 6D object poses from RGB images: render, compare by flow, solve, adapt.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Plays a small recording through all node processes and prints what came out.
    Demo(commands::demo::Args),
    /// Starts, watches and ends the nodes of a graph.
    Run(commands::run::Args),
    /// Checks a graph without starting anything.
    Check(commands::run::GraphArgs),
    /// Draws a graph: mermaid text, as GitHub and many editors show it.
    Graph(commands::run::GraphArgs),
    /// Prints the JSON schema of graphs.
    Schema,
    /// Prints the page about ROS 2: topics, settings, arguments.
    Interface,
    /// One node of a run, as the supervisor starts it.
    #[command(hide = true)]
    Node(commands::run::NodeArgs),
    #[cfg(feature = "training")]
    #[command(flatten)]
    Training(commands::trainings::Command),
    /// Writes weights as a standard ONNX file.
    Export(commands::export::Args),
    /// Plays a recording in real time into a graph: does this computer keep up?
    Bench(commands::bench::Args),
    /// Scores poses on a BOP dataset: refined here, or those of a result file.
    Eval(commands::eval::Args),
    /// Shows the difference of two reports, object by object.
    Compare(commands::eval::CompareArgs),
    /// Makes, describes and rescues recordings.
    #[command(subcommand)]
    Bag(commands::bag::Command),
}

/// What to do where a graph names a kind that only training needs.
#[cfg(not(feature = "training"))]
const WITHOUT_TRAINING: &str = "this binary cannot train: build it with its feature `training`";

/// Every kind of node that graphs may name.
fn registry() -> Registry {
    let registry = Registry::new()
        .with::<pseudoflow_player::PlayerNode>()
        .with::<pseudoflow_initializer::InitializerNode>()
        .with::<pseudoflow_initializer::RectangleFinder>()
        .with::<pseudoflow_tracker::TrackerNode>()
        .with::<pseudoflow_renderer::RendererNode>()
        .with::<pseudoflow_flow::FlowNode>()
        .with::<pseudoflow_consistency::ConsistencyNode>()
        .with::<pseudoflow_pnp::PnpNode>()
        .with::<pseudoflow_pnp::judge::JudgeNode>()
        .with::<pseudoflow_bridge::Bridge>()
        .with::<pseudoflow_evaluator::EvaluatorNode>()
        .with::<pseudoflow_evaluator::live::StopwatchNode>()
        .with::<pseudoflow_evaluator::results::ResultsNode>()
        .with::<pseudoflow_recorder::RecorderNode>();
    #[cfg(feature = "training")]
    let registry = registry.with::<pseudoflow_trainer::TrainerNode>().with::<commands::calibrate::ScenesNode>();
    #[cfg(not(feature = "training"))]
    let registry = registry.without("trainer", WITHOUT_TRAINING).without("scenes", WITHOUT_TRAINING);
    registry
}

/// Quiet libraries: RustDDS calls each datagram that it cannot use an error.
const LOG_FILTER: &str = "rustdds=off,ros2_client=error,ros2_client::distributions=off,wgpu_core=warn,wgpu_hal=error,naga=warn,iceoryx2=warn,\
    ort=warn,cubecl=warn,burn=warn";

/// Where `--log-level` of `--ros-args` reaches the processes of a graph.
const LEVEL_VARIABLE: &str = "PSEUDOFLOW_LOG_LEVEL";

fn main() -> ExitCode {
    #[cfg(feature = "embed")]
    pseudoflow_cli::carried::carry();
    let (ours, ros) = ros_args::split(std::env::args());
    let ros = match RosArgs::parse(&ros) {
        Ok(ros) => ros,
        Err(error) => {
            eprintln!("error: {}", commands::chain(&error));
            return ExitCode::from(2);
        }
    };
    if let Some(level) = &ros.log_level {
        // SAFETY: no other thread has been started.
        unsafe { std::env::set_var(LEVEL_VARIABLE, level) };
    }
    let level = std::env::var(LEVEL_VARIABLE).unwrap_or_else(|_| "info".to_owned());
    let filter = format!("{level},{LOG_FILTER}");
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or(filter)).init();
    match dispatch(Cli::parse_from(ours).command, &ros) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {}", commands::chain(&error));
            ExitCode::FAILURE
        }
    }
}

fn dispatch(command: Command, ros: &RosArgs) -> Result<ExitCode> {
    match command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Run(args) => commands::run::run(&args, ros),
        Command::Check(args) => commands::run::check(&args),
        Command::Graph(args) => commands::run::draw(&args),
        Command::Schema => commands::run::schema(),
        Command::Interface => commands::interface::run(),
        Command::Node(args) => commands::run::node(&args),
        #[cfg(feature = "training")]
        Command::Training(command) => commands::trainings::run(&command),
        Command::Export(args) => commands::export::run(&args),
        Command::Bench(args) => commands::bench::run(&args),
        Command::Eval(args) => commands::eval::run(&args),
        Command::Compare(args) => commands::eval::compare(&args),
        Command::Bag(command) => commands::bag::run(&command),
    }
}
