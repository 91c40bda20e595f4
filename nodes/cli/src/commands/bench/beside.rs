//! Makes a graph that stands beside a recording out of one that stands beside a camera.

use super::text;
use anyhow::{Result, bail};
use pseudoflow_runtime::graph::PortRef;
use pseudoflow_runtime::{Graph, Mode, NodeSpec};
use serde_yaml::{Mapping, Value};
use std::path::Path;

/// Kinds that end a graph: one stopwatch takes their place.
const SINKS: [&str; 4] = ["bridge", "recorder", "evaluator", "stopwatch"];
const PLAYER: &str = "player";
const STOPWATCH: &str = "stopwatch";

/// What a graph is put beside.
pub(crate) struct Beside<'a> {
    /// Recording.
    pub(crate) source: &'a Path,
    /// Object set of all nodes.
    pub(crate) objects: &'a Path,
    /// Frames per second.
    pub(crate) hz: f64,
    /// How often it is played, every second time backwards.
    pub(crate) passes: u32,
    pub(crate) max_frames: Option<u64>,
    /// The stopwatch's file.
    pub(crate) arrivals: &'a Path,
}

impl Beside<'_> {
    /// The same graph, live, with the recording for its camera and a stopwatch for all that publishes or records.
    pub(crate) fn graph(&self, mut graph: Graph) -> Result<Graph> {
        let Some(source) = source(&graph) else {
            bail!(
                "{}: no player or camera gives `frame` to another node: take another `--graph`",
                graph.file.display()
            );
        };
        let Some(poses) = taken_by_sinks(&graph, "poses") else {
            bail!("{}: no bridge, recorder or evaluator takes `poses`: take another `--graph`", graph.file.display());
        };
        let status = taken_by_sinks(&graph, "status");
        let player = self.player(&graph.nodes[&source]);
        let mut nodes = indexmap(PLAYER, player);
        let kept = |(name, spec): &(String, NodeSpec)| *name != source && !SINKS.contains(&spec.kind.as_str());
        nodes.extend(std::mem::take(&mut graph.nodes).into_iter().filter(kept));
        nodes.insert(STOPWATCH.into(), self.stopwatch(poses, status));
        for spec in nodes.values_mut() {
            spec.inputs.values_mut().filter(|port| port.node == source).for_each(from_player);
            if let Some(objects) = spec.config.as_mapping_mut().and_then(|config| config.get_mut("objects")) {
                *objects = text(self.objects);
            }
        }
        let feeds = |port: &PortRef| nodes.values().any(|spec| spec.inputs.values().any(|input| input == port));
        graph.feedback.retain(feeds);
        Ok(Graph { mode: Mode::Live, nodes, ..graph })
    }

    /// A player in the source's place; what another player was told about initial poses holds on, and a detector's topic of a
    /// bridge is where the recording has them.
    fn player(&self, source: &NodeSpec) -> NodeSpec {
        let kept = (source.kind == PLAYER).then(|| source.config.as_mapping().cloned()).flatten();
        let mut config = kept.unwrap_or_default();
        ["also", "sampling", "max_frames"].iter().for_each(|key| drop(config.remove(*key)));
        if let Some(topic) = source.config.get("camera").and_then(|camera| camera.get("detections")) {
            config
                .insert("initial_poses".into(), Value::Mapping(Mapping::from_iter([("topic".into(), topic.clone())])));
        }
        if self.source.join("scene_camera.json").is_file() {
            config.remove("initial_poses"); // a BOP scene has no topics, and brings its own
        }
        config.insert("source".into(), text(self.source));
        config.insert("hz".into(), self.hz.into());
        config.insert("passes".into(), self.passes.into());
        if let Some(most) = self.max_frames {
            config.insert("max_frames".into(), most.into());
        }
        node(PLAYER, config)
    }

    fn stopwatch(&self, poses: PortRef, status: Option<PortRef>) -> NodeSpec {
        let mut spec = node(STOPWATCH, Mapping::from_iter([("out".into(), text(self.arrivals))]));
        spec.inputs.insert("frame".into(), PortRef { node: PLAYER.into(), port: "frame".into() });
        spec.inputs.insert("poses".into(), poses);
        spec.inputs.extend(status.map(|port| ("status".into(), port)));
        spec
    }
}

/// What came from the camera comes from the player. A detector's poses, `found` of a bridge, are a recording's initial poses.
fn from_player(port: &mut PortRef) {
    port.node = PLAYER.into();
    if port.port == "found" {
        port.port = "initial_poses".into();
    }
}

fn indexmap(name: &str, spec: NodeSpec) -> indexmap::IndexMap<String, NodeSpec> {
    indexmap::IndexMap::from([(name.to_owned(), spec)])
}

fn node(kind: &str, config: Mapping) -> NodeSpec {
    NodeSpec {
        kind: kind.into(),
        inputs: indexmap::IndexMap::new(),
        nice: 0,
        threads: None,
        config: Value::Mapping(config),
    }
}

/// The player or bridge whose `frame` goes to others.
fn source(graph: &Graph) -> Option<String> {
    let mut inputs = graph.nodes.values().flat_map(|spec| spec.inputs.values());
    let is_source = |name: &str| graph.nodes.get(name).is_some_and(|s| [PLAYER, "bridge"].contains(&s.kind.as_str()));
    inputs.find(|port| port.port == "frame" && is_source(&port.node)).map(|port| port.node.clone())
}

/// The output that the graph's first sink takes by an input of this name.
fn taken_by_sinks(graph: &Graph, input: &str) -> Option<PortRef> {
    let sinks = graph.nodes.values().filter(|spec| SINKS.contains(&spec.kind.as_str()));
    sinks.filter_map(|spec| spec.inputs.get(input)).next().cloned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_runtime::graph::check;

    fn beside(file: &str) -> Graph {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        std::env::set_current_dir(&root).unwrap();
        let [source, objects] = ["bags/tabletop_demo", "config/objects/tabletop"].map(Path::new);
        let arrivals = Path::new("out/a.jsonl");
        let beside = Beside { source, objects, hz: 15.0, passes: 1, max_frames: Some(4), arrivals };
        beside.graph(Graph::read(&root.join("config/graphs").join(file)).unwrap()).unwrap()
    }

    #[test]
    fn a_camera_becomes_a_recording_and_what_publishes_a_stopwatch() {
        let graph = beside("live_track.yaml");
        check(&graph, &crate::registry()).unwrap();
        assert_eq!(graph.mode, Mode::Live);
        assert!(graph.nodes.keys().all(|name| name != "bridge"));
        assert_eq!(graph.nodes["initializer"].inputs["frame"].to_string(), "player/frame");
        assert_eq!(graph.nodes["stopwatch"].inputs["poses"].to_string(), "tracker/poses");
        assert_eq!(graph.nodes["player"].config["hz"], Value::from(15.0));
        let feedback: Vec<String> = graph.feedback.iter().map(ToString::to_string).collect();
        assert_eq!(feedback, ["initializer/initial_poses", "initializer/status", "pnp/poses"]);
    }

    #[test]
    fn a_detectors_poses_come_from_its_recorded_topic() {
        let graph = beside("live.yaml");
        check(&graph, &crate::registry()).unwrap();
        assert_eq!(graph.nodes["tracker"].inputs["found"].to_string(), "player/initial_poses");
        assert_eq!(graph.nodes["player"].config["initial_poses"]["topic"], Value::from("/detections"));
    }

    #[test]
    fn a_replay_becomes_live_and_keeps_its_initial_poses() {
        let graph = beside("refine.yaml");
        check(&graph, &crate::registry()).unwrap();
        assert_eq!(graph.nodes["player"].config["source"], Value::from("bags/tabletop_demo"));
        assert!(graph.nodes.keys().all(|name| name != "recorder"));
    }
}
