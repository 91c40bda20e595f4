//! What both programs say of a graph.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command talks to people")]

use anyhow::{Result, anyhow};
use pseudoflow_flow::Network;
use pseudoflow_runtime::{Graph, Registry, graph};
use serde_json::json;
use std::path::Path;

/// Says whether a graph can run, or each of its problems; how many there are.
#[must_use]
pub fn check(graph: &Graph, path: &Path, registry: &Registry) -> usize {
    let problems = graph::check(graph, registry).err().unwrap_or_default();
    problems.iter().for_each(|problem| eprintln!("{problem}"));
    if problems.is_empty() {
        println!("{}: {} nodes, no problems", path.display(), graph.nodes.len());
    }
    problems.len()
}

/// The network of a name.
///
/// # Errors
/// Says which names there are.
pub fn network(name: &str) -> Result<Network> {
    serde_json::from_value(json!(name))
        .map_err(|_| anyhow!("`--network {name}`: write auto, refiner, nano, small or paper"))
}
