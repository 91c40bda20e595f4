//! A node of your own: it lets through only what is within reach, and runs in a graph.
//!
//!     cargo run --release --example write_a_node
//!
//! A node is one type that implements `Node`. It knows no process and no middleware. To give it to everybody, make it a crate in
//! `nodes/` and add `.with::<Reach>()` to `registry()` in `nodes/cli/src/main.rs`.

#![allow(clippy::print_stdout, reason = "an example talks to people")]

use pseudoflow_evaluator::results::ResultsNode;
use pseudoflow_msgs::{ObjectPose, ObjectPoses};
use pseudoflow_player::PlayerNode;
use pseudoflow_runtime::{Context, Graph, Inputs, Node, NodeError, Outputs, Port, PortSpec, Registry, Role, local};
use std::path::Path;

// A port is one constant: its name, its message, and whether a graph must connect it.
const FOUND: Port<ObjectPoses<'static>> = Port::required("found");
const WITHIN_REACH: Port<ObjectPoses<'static>> = Port::required("within_reach");

/// Its block in a graph. Unknown keys are refused, and `pseudoflow schema` describes it to editors.
#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReachConfig {
    /// How far the robot reaches from its camera, metres.
    reach_m: f64,
}
pub(crate) struct Reach(ReachConfig);

impl Node for Reach {
    const KIND: &'static str = "reach";
    const ROLE: Role = Role::Transform;
    type Config = ReachConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FOUND.spec()]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![WITHIN_REACH.spec()]
    }
    /// What types cannot say; `pseudoflow check` asks before anything starts.
    fn check(config: &ReachConfig) -> Result<(), NodeError> {
        (config.reach_m > 0.0).then_some(()).ok_or_else(|| "`reach_m`: give metres above 0".into())
    }
    fn create(config: ReachConfig, _: &Context) -> Result<Self, NodeError> {
        Ok(Self(config))
    }
    /// One message goes out for each frame, also when nothing is within reach.
    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let found = FOUND.read(inputs)?;
        let distance_m = |pose: &ObjectPose| pose.translation_m.iter().map(|t| t * t).sum::<f64>().sqrt();
        let near: Vec<_> = found.poses.iter().filter(|pose| distance_m(pose) <= self.0.reach_m).copied().collect();
        let (scene, image) = (found.header.scene_id, found.header.image_id);
        let fill = &mut |bytes: &mut [u8]| ObjectPoses::write(bytes, scene, image, &near);
        WITHIN_REACH.send(outputs, inputs.key(), ObjectPoses::byte_len(near.len()), fill)
    }
}

const GRAPH: &str = "
mode: replay
params: {source: bags/tabletop_demo, csv: out/reach.csv}
nodes:
  player:  {kind: player, config: {source: $source, initial_poses: {topic: /initial_poses}}}
  reach:   {kind: reach, inputs: {found: player/initial_poses}, config: {reach_m: 0.8}}
  results: {kind: results, inputs: {poses: reach/within_reach}, config: {csv: $csv}}
";

/// Plays a recording through the node; what it let through stands in `csv`. Returns how many frames there were.
pub(crate) fn run(source: &Path, csv: &Path) -> Result<u64, NodeError> {
    let registry = Registry::new().with::<PlayerNode>().with::<Reach>().with::<ResultsNode>();
    let mut graph = Graph::parse(GRAPH, Path::new("write_a_node.rs"))?;
    graph.set_params(&serde_json::json!({"source": source, "csv": csv}))?;
    Ok(local::run(&graph, &registry, Path::new("out"), &mut |_| {})?.frames)
}

fn main() -> Result<(), NodeError> {
    let frames = run(Path::new("bags/tabletop_demo"), Path::new("out/reach.csv"))?;
    println!("{frames} frames; poses within reach: out/reach.csv");
    Ok(())
}
