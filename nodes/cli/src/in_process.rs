//! Graphs that a command writes and runs by itself, node after node.

use crate::progress::progress_bar;
use anyhow::{Context as _, Result};
use pseudoflow_runtime::graph::PortRef;
use pseudoflow_runtime::{Graph, GraphError, Registry, local, shipped};
use std::path::Path;

/// A graph that a command runs.
#[derive(Debug, Clone, Copy)]
pub struct Written<'a> {
    /// The graph with the command's arguments put in.
    pub graph: &'a Graph,
    /// Where it is kept: `run --in-process` repeats the run. Nodes leave their files in its folder.
    pub file: &'a Path,
}

impl Written<'_> {
    /// Writes the graph and runs it over `frames` frames, of which an earlier run has done `done`; `what` stands before the
    /// progress.
    ///
    /// # Errors
    /// The file cannot be written, the graph has problems, or a node fails.
    pub fn run(&self, registry: &Registry, what: &str, frames: u64, done: u64) -> Result<()> {
        let mut stated = self.graph.resolved().map_err(GraphError::Problems)?;
        shipped::fill_in(&mut stated)?;
        std::fs::write(self.file, stated.to_yaml()?)
            .with_context(|| format!("{}: cannot be written", self.file.display()))?;
        let folder = self.file.parent().unwrap_or(Path::new("."));
        let bar = progress_bar(frames, what);
        local::run(&stated, registry, folder, &mut |handled| bar.set_position(done + handled))?;
        bar.finish_and_clear();
        Ok(())
    }
}

/// Takes nodes out of a graph, with the inputs that they fed and the ways back that lead from or to them.
pub fn take_out(graph: &mut Graph, names: &[&str]) {
    graph.nodes.retain(|name, _| !names.contains(&name.as_str()));
    for spec in graph.nodes.values_mut() {
        spec.inputs.retain(|_, from| !names.contains(&from.node.as_str()));
    }
    let nodes = &graph.nodes;
    let is_taken = |output: &PortRef| nodes.values().any(|spec| spec.inputs.values().any(|from| from == output));
    graph.feedback.retain(is_taken);
}

/// Leaves the flow network out of a refinement: pnp solves from contours alone, from the rough poses of `source`.
///
/// # Errors
/// The graph has no node `pnp`.
pub fn from_contours_alone(graph: &mut Graph, source: &str) -> Result<()> {
    take_out(graph, &["renderer", "flow"]);
    let pnp = graph.nodes.get_mut("pnp").context("the graph has no node `pnp`")?;
    let rough = PortRef { node: source.into(), port: "initial_poses".into() };
    pnp.inputs.insert("initial_poses".into(), rough);
    Ok(())
}
