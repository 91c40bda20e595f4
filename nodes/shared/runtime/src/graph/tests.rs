use super::*;
use crate::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Registry, Role};
use pseudoflow_msgs::{CameraFrame, ObjectPoses};
use serde::Deserialize;

/// A kind of node that only has ports and a configuration.
macro_rules! kind {
    ($type:ident, $name:literal, $role:ident, [$($input:expr),*], [$($output:expr),*]) => {
        struct $type;
        impl Node for $type {
            const KIND: &'static str = $name;
            const ROLE: Role = Role::$role;
            type Config = Config;
            fn inputs() -> Vec<PortSpec> {
                vec![$($input),*]
            }
            fn outputs() -> Vec<PortSpec> {
                vec![$($output),*]
            }
            fn check(config: &Config) -> Result<(), NodeError> {
                if config.side.size_px % 8 == 0 { Ok(()) } else { Err("`size_px` is no multiple of 8".into()) }
            }
            fn create(_: Config, _: &Context) -> Result<Self, NodeError> {
                Ok(Self)
            }
            fn process(&mut self, _: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
                Ok(())
            }
        }
    };
}

#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Config {
    /// A part with a type of its own.
    side: Side,
    bag: Option<PathBuf>,
}

#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Side {
    size_px: u32,
}

type Frame = CameraFrame<'static>;
type Poses = ObjectPoses<'static>;
kind!(Player, "player", ReplaySource, [], [PortSpec::required::<Frame>("frame"), PortSpec::required::<Poses>("poses")]);
kind!(Camera, "camera", LiveSource, [PortSpec::optional::<Poses>("poses")], [PortSpec::required::<Frame>("frame")]);
kind!(
    Refiner,
    "refiner",
    Transform,
    [PortSpec::required::<Frame>("frame"), PortSpec::optional::<Poses>("poses"), PortSpec::latest::<Poses>("hint")],
    [PortSpec::required::<Poses>("poses")]
);
kind!(
    Follower,
    "follower",
    Transform,
    [PortSpec::required::<Frame>("frame"), PortSpec::late::<Poses>("looks")],
    [PortSpec::required::<Poses>("poses")]
);
kind!(
    Recaller,
    "recaller",
    Transform,
    [PortSpec::required::<Poses>("poses"), PortSpec::optional::<Poses>("more")],
    [PortSpec::required::<Poses>("poses")]
);
kind!(Recorder, "recorder", Sink, [PortSpec::optional::<Frame>("frame"), PortSpec::optional::<Poses>("poses")], []);

fn registry() -> Registry {
    Registry::new().with::<Player>().with::<Camera>().with::<Refiner>().with::<Recorder>()
}

const GOOD: &str = "
mode: replay
nodes:
  player:   {kind: player, config: {side: {size_px: 16}}}
  refiner:  {kind: refiner, inputs: {frame: player/frame, poses: player/poses}}
  recorder: {kind: recorder, inputs: {poses: refiner/poses}}
";

fn parse(yaml: &str) -> Graph {
    Graph::parse(yaml, Path::new("g.yaml")).unwrap()
}

/// The only problem of a graph, as people read it.
fn problem(yaml: &str) -> String {
    let problems = check(&parse(yaml), &registry()).unwrap_err();
    assert_eq!(problems.len(), 1, "{problems:#?}");
    problems[0].to_string()
}

fn changed(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    GOOD.replace(from, to)
}

#[test]
fn a_good_graph_has_no_problems_and_survives_a_round_trip() {
    let graph = parse(GOOD);
    assert_eq!((graph.seed, graph.window, graph.restarts), (1, 4, 3));
    check(&graph, &registry()).unwrap();
    let again = parse(&graph.to_yaml().unwrap());
    assert_eq!(again.to_yaml().unwrap(), graph.to_yaml().unwrap());
    check(&again, &registry()).unwrap();
}

#[test]
fn a_kind_that_the_binary_was_built_without_is_not_called_a_slip() {
    let graph = parse(&GOOD.replace("kind: refiner", "kind: trainer"));
    let registry = registry().without("trainer", "build it with `training`");
    let problems = check(&graph, &registry).unwrap_err();
    assert!(
        problems[0].to_string().ends_with("no kind of node is called `trainer`: build it with `training`"),
        "{}",
        problems[0]
    );
}

#[test]
fn every_problem_names_file_node_field_and_remedy() {
    let cases = [
        (
            "mode: replay",
            "mode: replay\nwindow: 0",
            "g.yaml: `window`: 0 is out of range: take 1 to 64 frames in flight",
        ),
        (
            "kind: refiner",
            "kind: refinr",
            "g.yaml: node `refiner`: `kind`: no kind of node is called `refinr`: take one of: player, camera, refiner, recorder",
        ),
        (
            "poses: refiner/poses",
            "pose: refiner/poses, frame: player/frame",
            "g.yaml: node `recorder`: `inputs.pose`: `recorder` has no such input: take one of: frame, poses",
        ),
        (
            "frame: player/frame, ",
            "",
            "g.yaml: node `refiner`: `inputs.frame`: required input (CameraFrame@1) without a producer: connect it: `frame: node/port`, such as player/frame",
        ),
        (
            "frame: player/frame",
            "frame: playr/frame",
            "g.yaml: node `refiner`: `inputs.frame`: producer `playr/frame`: there is no node `playr`: take one of: player, refiner, recorder",
        ),
        (
            "frame: player/frame",
            "frame: player/image",
            "g.yaml: node `refiner`: `inputs.frame`: producer `player/image`: `player` has no output `image`: take one of: frame, poses",
        ),
        (
            "poses: player/poses",
            "poses: player/frame",
            "g.yaml: node `refiner`: `inputs.poses`: takes ObjectPoses@1, but `player/frame` sends CameraFrame@1: connect an output of ObjectPoses@1, such as player/poses or refiner/poses",
        ),
        (
            "poses: player/poses",
            "poses: refiner/poses",
            "g.yaml: node `refiner`: `inputs`: waits for itself: refiner -> refiner: break it, or declare the way back: `feedback: [node/port]` to a `latest` input",
        ),
        ("size_px: 16", "size_px: 12", "g.yaml: node `player`: `config`: `size_px` is no multiple of 8"),
        (
            "size_px: 16",
            "size_px: wide",
            "g.yaml: node `player`: `config.side.size_px`: invalid type: string \"wide\", expected u32",
        ),
        (
            "size_px: 16",
            "size: 16",
            "g.yaml: node `player`: `config.side.size`: unknown field `size`, expected `size_px`",
        ),
        (
            "inputs: {poses: refiner/poses}",
            "inputs: {poses: player/poses}",
            "g.yaml: node `refiner`: `outputs`: nothing takes what it makes: connect one of its outputs (poses) or remove the node",
        ),
        (
            "mode: replay",
            "mode: replay\nfeedback: [player/poses]",
            "g.yaml: `feedback`: `player/poses` goes only to inputs that wait for its frame: feedback can only go to an input that takes the latest message",
        ),
        (
            "  recorder:",
            "  a.b: {kind: recorder, inputs: {poses: refiner/poses}}\n  recorder:",
            "g.yaml: node `a.b`: `name`: not a name that services and folders can carry: take 1 to 40 letters, digits, `_` or `-`",
        ),
    ];
    for (from, to, message) in cases {
        let problems = check(&parse(&changed(from, to)), &registry()).unwrap_err();
        let messages: Vec<String> = problems.iter().map(Problem::to_string).collect();
        assert!(messages.contains(&message.to_owned()), "wanted: {message}\nfound: {messages:#?}");
    }
}

#[test]
fn sources_and_sinks_must_be_there() {
    assert_eq!(
        problem(
            "{mode: replay, nodes: {player: {kind: player}, other: {kind: player}, r: {kind: recorder, inputs: {frame: player/frame, poses: other/poses}}}}"
        ),
        "g.yaml: node `other`: `kind`: a second source beside `player`: keep one: frames are counted by one source"
    );
    assert_eq!(
        problem(
            "{mode: replay, nodes: {camera: {kind: camera}, recorder: {kind: recorder, inputs: {frame: camera/frame}}}}"
        ),
        "g.yaml: node `camera`: `kind`: a live source cannot repeat a frame, which replay needs: set `mode: live`, or take frames from a player"
    );
    let messages = |yaml: &str| {
        let problems = check(&parse(yaml), &registry()).unwrap_err();
        problems.iter().map(|p| p.what.clone()).collect::<Vec<_>>()
    };
    assert!(messages("{mode: replay, nodes: {}}").contains(&"no node is a source".to_owned()));
    assert!(messages("{mode: replay, nodes: {}}").contains(&"no node is a sink".to_owned()));
    let idle = messages("{mode: replay, nodes: {player: {kind: player}, recorder: {kind: recorder}}}");
    assert!(idle.contains(&"no input gives it frames".to_owned()), "{idle:?}");
}

#[test]
fn feedback_must_be_declared_and_must_be_feedback() {
    let way_back = "
mode: replay
nodes:
  player:   {kind: player}
  first:    {kind: refiner, inputs: {frame: player/frame, hint: second/poses}}
  second:   {kind: refiner, inputs: {frame: player/frame, poses: first/poses}}
  recorder: {kind: recorder, inputs: {poses: second/poses}}
";
    let text = problem(way_back);
    assert!(text.contains("waits for itself: second -> first -> second"), "{text}");
    let declared = way_back.replace("mode: replay", "mode: replay\nfeedback: [second/poses]");
    check(&parse(&declared), &registry()).unwrap();
    let text = problem(&declared.replace("hint: second/poses", "hint: player/poses"));
    assert!(text.contains("`second/poses` goes only to inputs that wait"), "{text}");
    let forward =
        GOOD.replace("poses: player/poses}", "hint: player/poses}").replace("mode:", "feedback: [player/poses]\nmode:");
    let text = problem(&forward);
    assert!(text.contains("`player/poses` closes no cycle"), "{text}");
    let text = problem(&changed("mode: replay", "mode: replay\nfeedback: [recorder/none]"));
    assert!(text.contains("`recorder/none` feeds no input"), "{text}");
}

#[test]
fn a_bridge_may_take_what_its_camera_began() {
    let live = "
mode: live
nodes:
  bridge:  {kind: camera, inputs: {poses: refiner/poses}}
  refiner: {kind: refiner, inputs: {frame: bridge/frame}}
";
    check(&parse(live), &registry()).unwrap();
    let sink_only = changed("kind: recorder", "kind: camera");
    check(&parse(&sink_only), &registry()).unwrap();
}

#[test]
fn files_that_are_no_graphs_are_refused_with_the_place() {
    let error = |yaml: &str| Graph::parse(yaml, Path::new("g.yaml")).unwrap_err().to_string();
    let unknown = error(&changed("kind: refiner,", "kind: refiner, input: {},"));
    assert!(unknown.contains("g.yaml: field `nodes.refiner") && unknown.contains("unknown field `input`"), "{unknown}");
    assert!(error("mode: replay\nnodez: {}").contains("unknown field `nodez`"));
    assert!(error("mode: fast\nnodes: {}").contains("expected `replay` or `live`"));
    assert!(error("mode: [").contains("no valid YAML"));
    assert!(error("{mode: live, nodes: {a: {kind: b, inputs: {c: d}}}}").contains("write `node/port`"));
    assert!(error(&changed("  refiner: ", "  player: ")).contains("duplicate"), "a node given twice");
    let missing = Graph::read(Path::new("/nowhere/g.yaml")).unwrap_err().to_string();
    assert!(missing.contains("/nowhere/g.yaml") && missing.contains("check the path"), "{missing}");
}

#[test]
fn overrides_reach_every_value() {
    let mut graph = parse(GOOD);
    graph.set("player.bag", "some/path").unwrap();
    graph.set("player.side.size_px", "24").unwrap();
    graph.set("recorder.a.b", "[1, x]").unwrap();
    graph.set("mode", "live").unwrap();
    graph.set("window", "9").unwrap();
    let config = &graph.nodes["player"].config;
    assert_eq!((config["bag"].as_str(), config["side"]["size_px"].as_u64()), (Some("some/path"), Some(24)));
    assert_eq!(graph.nodes["recorder"].config["a"]["b"][0].as_u64(), Some(1));
    assert_eq!((graph.mode, graph.window), (Mode::Live, 9));
    for (key, value, cause) in [
        ("nobody.bag", "x", "the graph has no node `nobody`: its nodes are player, refiner, recorder"),
        ("player.bag.deeper", "x", "`deeper` lies within a value that is no mapping"),
        (
            "windows",
            "3",
            "no such key: write mode, seed, window, restarts, frame_deadline_s, start_deadline_s or `node.key`",
        ),
        ("window", "many", "expected u64"),
    ] {
        let error = graph.set(key, value).unwrap_err().to_string();
        assert!(error.contains(cause), "{error}");
    }
}

#[test]
fn the_schema_is_the_one_that_was_reviewed() {
    let schema = serde_json::to_string_pretty(&schema(&registry())).unwrap() + "\n";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/graph_schema.json");
    if std::env::var_os("PSEUDOFLOW_BLESS").is_some() {
        std::fs::write(&path, &schema).unwrap();
    }
    let reviewed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(schema == reviewed, "the schema changed: look at it, then run with PSEUDOFLOW_BLESS=1\n{schema}");
}

#[test]
fn a_graph_is_drawn_with_what_flows_between_its_nodes() {
    let drawn = mermaid(&parse(GOOD), &registry()).unwrap();
    for line in [
        "player([\"player\"])",
        "refiner[\"refiner\"]",
        "player -->|frame, poses| refiner",
        "refiner -->|poses| recorder",
    ] {
        assert!(drawn.lines().any(|l| l.trim() == line), "{line} is not in\n{drawn}");
    }
    let fed_back = changed("poses: player/poses", "poses: player/poses, hint: player/poses");
    assert!(mermaid(&parse(&fed_back), &registry()).unwrap().contains("player -.->|poses| refiner"));
    assert!(mermaid(&parse(&changed("kind: refiner", "kind: refinr")), &registry()).is_err());
}

#[test]
fn news_of_frames_given_up_go_where_somebody_waits_for_them() {
    // The tracker leaves most frames out; `looks` joins what it sends with the camera's frames, `looked` only joins what looks sent.
    let graph = "
mode: live
nodes:
  camera:   {kind: camera}
  tracker:  {kind: follower, inputs: {frame: camera/frame, looks: looked/poses}}
  looks:    {kind: refiner, inputs: {frame: camera/frame, poses: tracker/poses}}
  network:  {kind: recaller, inputs: {poses: looks/poses}}
  looked:   {kind: recaller, inputs: {poses: looks/poses, more: network/poses}}
  keeper:   {kind: recorder, inputs: {frame: camera/frame}}
feedback: [looked/poses]
";
    let told = |graph: &str, name: &str| {
        let plan = crate::plan::Plan::new(&parse(graph), &registry().with::<Follower>().with::<Recaller>()).unwrap();
        plan.must_tell_voids(plan.position(name).unwrap())
    };
    assert!(told(graph, "tracker"), "`looks` has the frame");
    assert!(!told(graph, "looks"), "nobody else has heard of the frame");
    assert!(told(graph, "network"), "`looked` has what looks sent");
    let kept = graph.replace("feedback", "  recorder: {kind: recorder, inputs: {poses: looked/poses}}\nfeedback");
    assert!(told(&kept, "looks"), "the recorder acknowledges every frame");
}
