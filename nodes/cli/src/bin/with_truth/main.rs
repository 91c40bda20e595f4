//! `pseudoflow-with-truth`: what can only be measured with true poses of training images. It is a program of its own so that
//! nothing that `pseudoflow` runs can reach them: the self-supervised path has no word for truth.
//!
//! - `train`: the same student, samples, losses and schedule as `pseudoflow adapt`, with the true flow for labels: how far
//!   the images could take the network (paper, table "supervised").
//! - `audit`: how many pseudo-labels are right.

#![allow(clippy::print_stdout, reason = "a measurement for people")]

mod audit;
mod train;
mod truth;

use clap::Parser;
use pseudoflow_player::PlayerConfig;
use pseudoflow_runtime::{Context, InMemory, Node, NodeError};
use std::path::PathBuf;
use truth::Truth;

type Failure = Box<dyn std::error::Error + Send + Sync>;

#[derive(Parser)]
#[command(name = "pseudoflow-with-truth", version, about = "Measurements that need true poses of training images")]
enum Command {
    /// Trains on true flow instead of pseudo-labels: the upper bound.
    Train(train::Args),
    /// Compares pseudo-labels with the true flow.
    Audit(audit::Args),
}

/// The recordings, and what is true in them.
#[derive(clap::Args)]
struct Source {
    /// Recordings: BOP scenes, whose names are those of `--truth`.
    #[arg(long = "bag", required = true, num_args = 1..)]
    bags: Vec<PathBuf>,
    /// Folder of `SCENE/scene_gt.json`.
    #[arg(long)]
    truth: PathBuf,
    /// The object set: a BOP `models/` folder.
    #[arg(long)]
    objects: PathBuf,
}

impl Source {
    fn player(&self) -> PlayerConfig {
        PlayerConfig {
            also: self.bags[1..].to_vec(),
            objects: Some(self.objects.clone()),
            ..PlayerConfig::new(self.bags[0].clone())
        }
    }

    fn truth(&self) -> Result<Truth, Failure> {
        Truth::read(&self.truth, &self.objects)
    }
}

fn main() -> Result<(), Failure> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match Command::parse() {
        Command::Train(args) => train::run(&args),
        Command::Audit(args) => audit::run(&args),
    }
}

/// A context for nodes that run in this process.
fn context(seed: u64) -> Context {
    Context { name: "with-truth".into(), seed, out_dir: std::env::temp_dir(), restarts: 0, replay: true }
}

/// Feeds a node with what the nodes before it made and adds what it makes.
fn step<N: Node>(node: &mut N, messages: &mut InMemory, context: &Context) -> Result<(), NodeError> {
    let mut out = InMemory { key: messages.key, ..InMemory::default() };
    node.process(messages, &mut out, context)?;
    messages.messages.append(&mut out.messages);
    Ok(())
}

fn bytes<'a>(messages: &'a InMemory, port: &str) -> Result<&'a [u8], Failure> {
    let found = messages.messages.iter().find(|(name, _)| name == port);
    Ok(found.map(|(_, bytes)| &**bytes).ok_or_else(|| format!("no message `{port}`"))?)
}

/// The weights' network by its name.
fn network(name: &str) -> Result<pseudoflow_flow::Network, Failure> {
    serde_json::from_value(serde_json::Value::from(name))
        .map_err(|_| format!("`--network {name}`: write nano, small or paper").into())
}
