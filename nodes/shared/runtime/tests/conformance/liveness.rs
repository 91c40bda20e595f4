use crate::scene::{Scene, kill, wait_until};
use crate::test;
use libtest_mimic::Trial;
use pseudoflow_runtime::supervisor::{Summary, SupervisorError};
use rustix::process::Signal;

/// A deadline that a busy machine may miss: what it kills by mistake is started again and changes nothing.
const GRAPH: &str = "
mode: replay
window: 3
restarts: 50
frame_deadline_s: 2
nodes:
  source: {kind: counter, config: {frames: 40, numbers: 500, vary: true}}
  mixer:  {kind: mixer, inputs: {a: source/numbers, b: source/extra}, config: {delay_ms: 1}}
  sink:   {kind: keeper, inputs: {numbers: mixer/mixed}}
";

pub(crate) fn tests() -> Vec<Trial> {
    let mut tests = vec![
        test("liveness::a_start_that_never_ends_is_given_up", endless_start),
        test("liveness::what_is_stopped_from_outside_comes_back_live", stopped_live),
    ];
    for node in ["source", "mixer", "sink"] {
        for (place, cause) in [("stop", "SIGSTOP"), ("spin", "in frame 17")] {
            let name = format!("liveness::replay_{node}_{place}");
            tests.push(test(&name, move || stalls(node, place, cause)));
        }
    }
    tests
}

fn says(summary: &Summary, node: &str, cause: &str) -> bool {
    summary.incidents.iter().any(|i| i.node == node && i.what.contains("stalled") && i.what.contains(cause))
}

/// A replay whose node stops moving ends as one that was not disturbed, and says what happened.
fn stalls(node: &str, place: &str, cause: &str) {
    let calm = Scene::new(GRAPH).set("frame_deadline_s", "600");
    calm.run();
    let death = format!("[{{life: 0, frame: 17, place: {place}}}]");
    let scene = Scene::new(GRAPH).set(&format!("{node}.deaths"), &death);
    let summary = scene.run();
    assert!(says(&summary, node, cause), "{summary}");
    assert_eq!(scene.text("sink.txt"), calm.text("sink.txt"));
}

fn endless_start() {
    let scene = Scene::new(GRAPH).set("mixer.start_ms", "600000").set("start_deadline_s", "1").set("restarts", "1");
    let error = scene.try_run().expect_err("an error");
    let text = error.to_string();
    assert!(matches!(error, SupervisorError::GaveUp { .. }) && text.contains("in its start"), "{text}");
    assert!(text.contains("`mixer`") && text.contains("start_deadline_s"), "{text}");
}

fn stopped_live() {
    let camera = "{kind: ticker, config: {frames: 3000, period_ms: 2}}";
    let scene = Scene::new(&format!(
        "
mode: live
nodes:
  camera: {camera}
  mixer:  {{kind: mixer, inputs: {{a: camera/numbers}}}}
  sink:   {{kind: keeper, inputs: {{numbers: mixer/mixed}}}}
"
    ));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            wait_until("progress", || scene.lines("sink.txt") > 10);
            kill(scene.pid("mixer").expect("a pid"), Signal::STOP);
        });
        let summary = scene.run();
        assert!(says(&summary, "mixer", "SIGSTOP") && summary.nodes[1].restarts == 1, "{summary}");
    });
    assert!(scene.text("sink.txt").lines().any(|line| line.starts_with("2999 ")), "it goes on to the last frame");
}
