use crate::scene::{Scene, kill, wait_until};
use crate::test;
use libtest_mimic::Trial;
use pseudoflow_runtime::supervisor::{Summary, SupervisorError};
use rustix::process::Signal;

const FRAMES: usize = 40;

/// A source with two outputs, two transforms (one joins across a skipped stage), two sinks.
pub(crate) const GRAPH: &str = "
mode: replay
window: 3
restarts: 3
nodes:
  source: {kind: counter, config: {frames: 40, numbers: 500, vary: true}}
  first:  {kind: mixer, inputs: {a: source/numbers}, config: {delay_ms: 1}}
  second: {kind: mixer, inputs: {a: first/mixed, b: source/extra}, config: {delay_ms: 1}}
  left:   {kind: keeper, inputs: {numbers: second/mixed, more: source/numbers}}
  right:  {kind: keeper, inputs: {numbers: first/mixed}}
";

pub(crate) fn tests() -> Vec<Trial> {
    let mut tests = vec![
        test("replay::every_frame_arrives_once_in_order", every_frame_arrives),
        test("replay::an_empty_recording_ends_in_order", || assert_eq!(frames(&empty(), "left"), 0)),
        test("replay::the_window_is_kept_and_used", the_window_is_kept),
        test("replay::window_of_one", || same_as_undisturbed(Scene::new(GRAPH).set("window", "1"))),
        test("replay::several_deaths_in_one_run", several_deaths),
        test("replay::kills_from_outside_at_any_moment", kills_from_outside),
        test("replay::feedback_reaches_back", feedback_reaches_back),
        test("replay::an_error_ends_the_run_with_its_cause", an_error_ends_the_run),
        test("replay::a_bad_frame_ends_the_run_with_its_cause", a_bad_frame_ends_the_run),
        test("replay::too_many_deaths_end_the_run", too_many_deaths),
        test("replay::a_forgotten_output_is_named", a_forgotten_output),
        test("replay::one_run_per_folder", one_run_per_folder),
    ];
    for node in ["source", "first", "second", "left", "right"] {
        for (place, frame) in [("before", 0), ("before", 17), ("after", 17), ("panic", 20), ("after", 39)] {
            let death = format!("[{{life: 0, frame: {frame}, place: {place}}}]");
            let name = format!("replay::death::{node}_{place}_{frame}");
            let key = format!("{node}.deaths");
            tests.push(test(&name, move || same_as_undisturbed(Scene::new(GRAPH).set(&key, &death))));
        }
    }
    for node in ["source", "left"] {
        let key = format!("{node}.deaths");
        let scene = move || Scene::new(GRAPH).set(&key, "[{life: 0, frame: 0, place: finish}]");
        tests.push(test(&format!("replay::death::{node}_finish"), move || same_as_undisturbed(scene())));
    }
    tests
}

fn frames(summary: &Summary, node: &str) -> u64 {
    summary.nodes.iter().find(|n| n.name == node).expect("the node").frames
}

fn empty() -> Summary {
    Scene::new(GRAPH).set("source.frames", "0").run()
}

fn indices(text: &str) -> Vec<usize> {
    text.lines().map(|line| line.split(' ').next().and_then(|n| n.parse().ok()).expect("an index")).collect()
}

fn every_frame_arrives() {
    let scene = Scene::new(GRAPH);
    let summary = scene.run();
    for sink in ["left", "right"] {
        assert_eq!(indices(&scene.text(&format!("{sink}.txt"))), (0..FRAMES).collect::<Vec<_>>());
        assert_eq!(scene.text(&format!("{sink}.finished")), FRAMES.to_string());
    }
    for node in &summary.nodes {
        assert_eq!((node.frames, node.drops, node.repeats, node.restarts), (FRAMES as u64, 0, 0, 0), "{}", node.name);
        assert!(node.work_ms.is_some() && node.age_ms.is_some() && node.rate_hz.is_some());
    }
    assert!(!summary.asked_to_stop && scene.path("summary.json").exists() && scene.path("graph.yaml").exists());
}

/// Runs a scene and one like it without deaths: all outputs must be equal.
fn same_as_undisturbed(scene: Scene) {
    let calm = Scene::new(GRAPH);
    calm.run();
    let summary = scene.run();
    for sink in ["left", "right"] {
        let file = format!("{sink}.txt");
        assert_eq!(scene.text(&file), calm.text(&file), "{sink} differs");
        assert_eq!(scene.text(&format!("{sink}.finished")), FRAMES.to_string());
    }
    let told_to_die = scene.graph.to_yaml().expect("yaml").matches("life:").count() as u64;
    let restarts: u64 = summary.nodes.iter().map(|node| node.restarts).sum();
    assert_eq!(restarts, told_to_die, "each death is one restart");
}

fn several_deaths() {
    let twice = "[{life: 0, frame: 9, place: before}, {life: 1, frame: 9, place: after}]";
    let scene = Scene::new(GRAPH)
        .set("first.deaths", twice)
        .set("left.deaths", twice)
        .set("source.deaths", "[{life: 0, frame: 10, place: after}, {life: 1, frame: 12, place: before}]")
        .set("second.deaths", "[{life: 0, frame: 9, place: after}, {life: 1, frame: 38, place: panic}]");
    same_as_undisturbed(scene);
}

fn kills_from_outside() {
    let calm = Scene::new(GRAPH);
    calm.run();
    for node in ["source", "first", "second", "left", "right"] {
        // Slow, so that both deaths come within the run on a machine that stalls.
        let scene = Scene::new(GRAPH).set("first.delay_ms", "20");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for at in [5, 20] {
                    wait_until("progress", || scene.lines("right.txt") >= at);
                    kill(scene.pid(node).expect("a pid"), Signal::KILL);
                }
            });
            scene.run();
        });
        assert_eq!(scene.text("left.txt"), calm.text("left.txt"), "{node} was killed");
        assert_eq!(scene.text("right.txt"), calm.text("right.txt"), "{node} was killed");
    }
}

fn the_window_is_kept() {
    for window in [1, 2, 5] {
        let scene = Scene::new(GRAPH)
            .set("window", &window.to_string())
            .set("source.window", &window.to_string())
            .set("source.watch", "left.txt")
            .set("left.delay_ms", "4");
        scene.run();
        let most: u64 = scene.text("most_in_flight").parse().expect("a number");
        // The sink's file may be one frame ahead of its acknowledgement.
        assert!(most + 2 >= window && most < window, "at most {most} in flight for a window of {window}");
    }
}

fn feedback_reaches_back() {
    let scene = Scene::new(
        "
mode: replay
window: 2
feedback: [learner/weights]
nodes:
  source:  {kind: counter, config: {frames: 30}}
  mixer:   {kind: mixer, inputs: {a: source/numbers, weights: learner/weights}, config: {delay_ms: 2}}
  learner: {kind: learner, inputs: {numbers: mixer/mixed}}
",
    );
    scene.run();
    let versions: Vec<u64> = scene.text("weights.txt").lines().map(|line| line.parse().expect("a version")).collect();
    assert!(versions.is_sorted() && versions.first() == Some(&0) && versions.last() == Some(&25), "{versions:?}");
}

fn an_error_ends_the_run() {
    let error = Scene::new(GRAPH).set("second.fail_at", "7").try_run().expect_err("an error");
    let text = error.to_string();
    assert!(matches!(error, SupervisorError::Failed { ref node, .. } if node == "second"), "{text}");
    assert!(text.contains("frame 7") && text.contains("told to fail"), "{text}");
}

fn a_bad_frame_ends_the_run() {
    let text = Scene::new(GRAPH).set("second.bad_every", "7").try_run().expect_err("an error").to_string();
    assert!(
        text.contains("`second`") && text.contains("frame 0") && text.contains("told that frame 0 is bad"),
        "{text}"
    );
}

fn too_many_deaths() {
    let always = "[{life: 0, frame: 5, place: panic}, {life: 1, frame: 5, place: panic}]";
    let scene = Scene::new(GRAPH).set("restarts", "1").set("left.deaths", always);
    let error = scene.try_run().expect_err("an error");
    let text = error.to_string();
    assert!(matches!(error, SupervisorError::GaveUp { restarts: 1, .. }), "{text}");
    assert!(text.contains("`left`") && text.contains("a toy that was told to panic"), "{text}");
}

fn a_forgotten_output() {
    // A learner sends only every fifth frame, which no joined input can live with.
    let scene = Scene::new(
        "
mode: replay
nodes:
  source:  {kind: counter, config: {frames: 30}}
  learner: {kind: learner, inputs: {numbers: source/numbers}}
  keeper:  {kind: keeper, inputs: {numbers: learner/weights}}
",
    );
    let text = scene.try_run().expect_err("an error").to_string();
    assert!(text.contains("frame 1") && text.contains("`weights` was not sent"), "{text}");
}

fn one_run_per_folder() {
    let scene = Scene::new(GRAPH).set("first.delay_ms", "20");
    std::thread::scope(|scope| {
        let run = scope.spawn(|| scene.run());
        wait_until("the run", || scene.lines("left.txt") > 2);
        let options = scene.options();
        let second = pseudoflow_runtime::supervisor::run(&scene.graph, &crate::toys::registry(), &options);
        assert!(matches!(second, Err(SupervisorError::Busy { .. })), "{second:?}");
        assert_eq!(frames(&run.join().expect("the first run"), "left"), FRAMES as u64);
    });
}
