use super::{Graph, GraphError};
use crate::plan::Plan;
use crate::{Registry, Role};
use std::fmt::Write as _;

/// A graph as mermaid text: sources and sinks rounded, what is joined by frame drawn through, what only the newest counts of
/// (weights, feedback) dotted. Edges between two nodes share a line.
///
/// # Errors
/// When the graph would not run.
pub fn mermaid(graph: &Graph, registry: &Registry) -> Result<String, GraphError> {
    let plan = Plan::new(graph, registry)?;
    let mut text = "flowchart LR\n".to_owned();
    for node in &plan.nodes {
        let label =
            if node.name == node.kind.name { node.name.clone() } else { format!("{}: {}", node.name, node.kind.name) };
        let (open, close) = if node.kind.role == Role::Transform { ("[", "]") } else { ("([", "])") };
        let _ = writeln!(text, "    {}{open}\"{label}\"{close}", node.name);
    }
    for (from, node) in plan.nodes.iter().enumerate() {
        for (to, latest, ports) in edges(&plan, from) {
            let line = if latest { "-.->" } else { "-->" };
            let _ = writeln!(text, "    {} {line}|{}| {}", node.name, ports.join(", "), plan.nodes[to].name);
        }
    }
    Ok(text)
}

/// Consumers of a node, whether they take the newest only, and the outputs that they take.
fn edges(plan: &Plan, from: usize) -> Vec<(usize, bool, Vec<&str>)> {
    let mut edges: Vec<(usize, bool, Vec<&str>)> = Vec::new();
    for (to, node) in plan.nodes.iter().enumerate() {
        for input in node.inputs.iter().filter(|input| input.producer == from) {
            match edges.iter_mut().find(|(other, latest, _)| (*other, *latest) == (to, input.latest)) {
                Some((.., ports)) => ports.push(&input.output),
                None => edges.push((to, input.latest, vec![&input.output])),
            }
        }
    }
    edges
}
