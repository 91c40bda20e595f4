//! What bridge and recorder say about objects follows from what the graph's other nodes work with: one folder of objects,
//! and weights. Stated nowhere twice, it cannot differ.

use pseudoflow_runtime::Graph;
use serde_yaml::Value;
use std::collections::BTreeSet;

/// Fills in `objects` (bridge, recorder without overlay) where all other nodes name one folder, and the bridge's `weights`.
pub(crate) fn fill_in(graph: &mut Graph) {
    let mut folders = BTreeSet::new();
    let mut weights = BTreeSet::new();
    for node in graph.nodes.values() {
        folders.extend(node.config.get("objects").and_then(Value::as_str).map(str::to_owned));
        gather_weights(&node.config, &mut weights);
    }
    for node in graph.nodes.values_mut() {
        let Value::Mapping(config) = &mut node.config else { continue };
        let names_objects = match node.kind.as_str() {
            "bridge" => true,
            "recorder" => config.get("overlay").is_none_or(Value::is_null),
            _ => false,
        };
        if let (true, 1, Some(folder)) = (names_objects, folders.len(), folders.first()) {
            config.entry("objects".into()).or_insert_with(|| folder.clone().into());
        }
        if node.kind == "bridge" && !weights.is_empty() {
            let listed = || weights.iter().map(|path| Value::from(path.as_str())).collect();
            config.entry("weights".into()).or_insert_with(|| Value::Sequence(listed()));
        }
    }
}

/// All `model` keys, nested ones too.
fn gather_weights(config: &Value, weights: &mut BTreeSet<String>) {
    for (key, value) in config.as_mapping().into_iter().flatten() {
        match value {
            Value::String(path) if key.as_str() == Some("model") => {
                weights.insert(path.clone());
            }
            nested => gather_weights(nested, weights),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn filled(text: &str) -> Graph {
        let mut graph = Graph::parse(text, Path::new("test.yaml")).unwrap();
        fill_in(&mut graph);
        graph
    }

    #[test]
    fn the_bridge_speaks_of_the_objects_of_the_others() {
        let text = "mode: live\nnodes:\n  renderer: {kind: renderer, config: {objects: a}}\n  \
                    flow: {kind: flow, config: {model: w, compare: {model: v}}}\n  bridge: {kind: bridge}\n  \
                    recorder: {kind: recorder, config: {overlay: {objects: b}}}\n  plain: {kind: recorder, config: {overlay: null}}\n";
        let graph = filled(text);
        let bridge = &graph.nodes["bridge"].config;
        assert_eq!(bridge["objects"].as_str(), Some("a"));
        assert_eq!(bridge["weights"].as_sequence().unwrap().len(), 2);
        assert!(graph.nodes["recorder"].config.get("objects").is_none());
        assert_eq!(graph.nodes["plain"].config["objects"].as_str(), Some("a"));
    }

    #[test]
    fn what_is_stated_or_ambiguous_is_left() {
        let graph = filled(
            "mode: live\nnodes:\n  renderer: {kind: renderer, config: {objects: a}}\n  bridge: {kind: bridge, config: {objects: c}}\n  recorder: {kind: recorder, config: {}}\n",
        );
        assert_eq!(graph.nodes["bridge"].config["objects"].as_str(), Some("c"));
        assert!(graph.nodes["recorder"].config.get("objects").is_none());
    }
}
