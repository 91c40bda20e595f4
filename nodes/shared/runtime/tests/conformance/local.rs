//! The same graphs within one process: what the nodes see and leave must be what processes would.

use crate::replay::GRAPH;
use crate::scene::Scene;
use crate::{test, toys};
use libtest_mimic::Trial;
use pseudoflow_runtime::RunError;
use pseudoflow_runtime::local::{self, LocalSummary};

pub(crate) fn tests() -> Vec<Trial> {
    vec![
        test("local::processes_and_one_process_leave_the_same_bytes", the_same_bytes),
        test("local::windows_of_one_and_of_many_make_no_difference", windows_make_no_difference),
        test("local::feedback_reaches_back_in_the_same_frame_order", feedback_reaches_back),
        test("local::an_error_names_node_frame_and_cause", errors_are_named),
        test("local::a_forgotten_output_is_named", a_forgotten_output),
        test("local::who_waits_in_vain_is_named", who_waits_in_vain),
        test("local::live_graphs_are_refused", live_graphs_are_refused),
    ]
}

fn run(scene: &Scene) -> Result<LocalSummary, RunError> {
    local::run(&scene.graph, &toys::registry(), scene.dir.path(), &mut |_| {})
}

fn kept(scene: &Scene) -> [String; 4] {
    ["left.txt", "right.txt", "left.finished", "right.finished"].map(|name| scene.text(name))
}

fn the_same_bytes() {
    let (processes, one) = (Scene::new(GRAPH), Scene::new(GRAPH));
    processes.run();
    let summary = run(&one).unwrap();
    assert!(kept(&one) == kept(&processes), "the files differ");
    assert!(one.lines("left.txt") == 40 && summary.frames == 40);
    for node in &summary.nodes {
        assert_eq!(node.frames, 40, "{}", node.name);
    }
}

fn windows_make_no_difference() {
    let scenes = ["1", "64"].map(|window| Scene::new(GRAPH).set("window", window));
    for scene in &scenes {
        run(scene).unwrap();
    }
    assert!(kept(&scenes[0]) == kept(&scenes[1]) && !scenes[0].text("left.txt").is_empty());
}

fn feedback_reaches_back() {
    let scene = Scene::new(
        "
mode: replay
window: 1
feedback: [learner/weights]
nodes:
  source:  {kind: counter, config: {frames: 30}}
  mixer:   {kind: mixer, inputs: {a: source/numbers, weights: learner/weights}}
  learner: {kind: learner, inputs: {numbers: mixer/mixed}}
",
    );
    run(&scene).unwrap();
    let versions: Vec<u64> = scene.text("weights.txt").lines().map(|line| line.parse().unwrap()).collect();
    // A window of one frame: what the learner says about a frame is there with the next.
    assert_eq!(versions, (1..30).map(|frame| (frame - 1) / 5 * 5).collect::<Vec<u64>>());
}

fn errors_are_named() {
    let scene = Scene::new(GRAPH).set("second.fail_at", "7");
    let text = run(&scene).unwrap_err().to_string();
    assert!(text.contains("`second`") && text.contains("frame 7") && text.contains("told to fail"), "{text}");
}

fn a_forgotten_output() {
    let graph = "
mode: replay
nodes:
  source:  {kind: counter, config: {frames: 10}}
  learner: {kind: learner, inputs: {numbers: source/numbers}}
  keeper:  {kind: keeper, inputs: {numbers: learner/weights}}
";
    let text = run(&Scene::new(graph)).unwrap_err().to_string();
    assert!(text.contains("`learner`") && text.contains("`weights` was not sent"), "{text}");
}

fn who_waits_in_vain() {
    let graph = "
mode: replay
window: 2
nodes:
  source: {kind: counter, config: {frames: 10}}
  keeper: {kind: keeper, inputs: {numbers: source/numbers}, config: {keep_back: 5}}
";
    let text = run(&Scene::new(graph)).unwrap_err().to_string();
    assert!(text.contains("`keeper` holds frame 0 back") && text.contains("2 frames"), "{text}");
}

fn live_graphs_are_refused() {
    let scene = Scene::new(
        "
mode: live
nodes:
  source: {kind: ticker, config: {frames: 1}}
  keeper: {kind: keeper, inputs: {numbers: source/numbers}}
",
    );
    assert!(matches!(run(&scene), Err(RunError::LiveInProcess)));
}
