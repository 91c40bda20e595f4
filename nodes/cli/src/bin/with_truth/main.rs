//! `pseudoflow-with-truth`: what can only be measured with true poses of training images. It is a program of its own so that
//! nothing that `pseudoflow` runs can reach them: the self-supervised path has no word for truth.
//!
//! - `train`: the same student, samples, losses and schedule as `pseudoflow adapt`, with the true flow for labels: how far
//!   the images could take the network (paper, table "supervised").
//! - `audit`: how many pseudo-labels are right.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a measurement for people")]

mod audit;
mod audit_node;
mod train;
mod truth;
mod truth_node;

use anyhow::{Result, bail};
use audit_node::AuditNode;
use clap::Parser;
use pseudoflow_runtime::{Graph, Registry, graph, local};
use std::path::{Path, PathBuf};
use truth_node::TruthNode;

#[derive(Parser)]
#[command(name = "pseudoflow-with-truth", version, about = "Measurements that need true poses of training images")]
enum Command {
    /// Trains on true flow instead of pseudo-labels: the upper bound.
    Train(train::Args),
    /// Compares pseudo-labels with the true flow.
    Audit(audit::Args),
    /// Checks a graph that one of these wrote.
    Check { graph: PathBuf },
    /// Draws a graph that one of these wrote, as mermaid text.
    Graph { graph: PathBuf },
    /// Runs a graph that one of these wrote.
    Run { graph: PathBuf },
}

/// The nodes of a training, and those that know the truth.
fn registry() -> Registry {
    Registry::new()
        .with::<pseudoflow_player::PlayerNode>()
        .with::<pseudoflow_renderer::RendererNode>()
        .with::<pseudoflow_flow::FlowNode>()
        .with::<pseudoflow_pnp::PnpNode>()
        .with::<pseudoflow_consistency::ConsistencyNode>()
        .with::<pseudoflow_trainer::TrainerNode>()
        .with::<TruthNode>()
        .with::<AuditNode>()
}

fn main() -> Result<()> {
    #[cfg(feature = "embed")]
    pseudoflow_cli::carried::carry();
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match Command::parse() {
        Command::Train(args) => train::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Check { graph } => check(&graph),
        Command::Graph { graph } => {
            print!("{}", graph::mermaid(&Graph::read(&graph)?, &registry())?);
            Ok(())
        }
        Command::Run { graph } => {
            let folder = graph.parent().unwrap_or(Path::new("."));
            local::run(&Graph::read(&graph)?, &registry(), folder, &mut |_| ())?;
            Ok(())
        }
    }
}

fn check(path: &Path) -> Result<()> {
    match pseudoflow_cli::graphs::check(&Graph::read(path)?, path, &registry()) {
        0 => Ok(()),
        problems => bail!("{}: {problems} problems", path.display()),
    }
}
