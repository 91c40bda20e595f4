use crate::scene::{Scene, assert_nothing_left, is_alive, kill, segments, wait_until};
use crate::{test, this_program};
use libtest_mimic::Trial;
use pseudoflow_runtime::supervisor::{Summary, SupervisorError};
use rustix::process::Signal;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

const GRAPH: &str = "
mode: replay
window: 3
nodes:
  source: {kind: counter, config: {frames: 100000}}
  mixer:  {kind: mixer, inputs: {a: source/numbers}, config: {delay_ms: 2}}
  sink:   {kind: keeper, inputs: {numbers: mixer/mixed}}
";
const NODES: [&str; 3] = ["source", "mixer", "sink"];

pub(crate) fn tests() -> Vec<Trial> {
    vec![
        test("stop::a_signal_ends_the_run_in_order", || a_signal_ends_the_run(Signal::INT)),
        test("stop::sigterm_as_well", || a_signal_ends_the_run(Signal::TERM)),
        test("stop::live_as_well", stop_live),
        test("stop::in_the_warm_up_as_well", stop_in_the_warm_up),
        test("stop::a_live_node_that_hangs_is_killed_and_named", a_hanging_live_node),
        test("stop::a_node_that_hangs_is_killed_and_named", a_hanging_node),
        test("stop::nodes_die_with_the_supervisor_and_the_next_run_cleans_up", orphans),
        test("stop::a_polite_signal_to_a_node_is_a_death", a_polite_signal),
        test("stop::a_node_alone_says_how_to_start_it", a_node_alone),
    ]
}

fn supervise(scene: &Scene) -> Child {
    let graph = scene.path("given.yaml");
    std::fs::write(&graph, scene.graph.to_yaml().expect("yaml")).expect("the graph");
    let mut command = Command::new(this_program());
    command.arg("supervise").arg(graph).arg(scene.dir.path());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("a supervisor")
}

fn a_signal_ends_the_run(signal: Signal) {
    let scene = Scene::new(GRAPH);
    let supervisor = supervise(&scene);
    wait_until("progress", || scene.lines("sink.txt") > 10);
    kill(supervisor.id() as i32, signal);
    let output = supervisor.wait_with_output().expect("an end");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    let lines = scene.text("sink.txt");
    assert!(lines.lines().enumerate().all(|(i, line)| line.starts_with(&format!("{i} "))), "a frame is missing");
    assert_eq!(scene.text("sink.finished"), lines.lines().count().to_string());
    assert!(scene.text("summary.json").contains("\"asked_to_stop\": true"));
    assert!(text.contains("age p50") && text.contains("mixer"), "the table is printed: {text}");
    assert_nothing_left(scene.dir.path());
}

fn stop_live() {
    let scene = Scene::new(
        "
mode: live
nodes:
  camera: {kind: ticker, config: {frames: 100000, period_ms: 2}}
  sink:   {kind: keeper, inputs: {numbers: camera/numbers}}
",
    );
    let options = scene.options();
    let (stop, file) = (options.stop.clone(), scene.path("sink.txt"));
    let stopper = std::thread::spawn(move || {
        wait_until("progress", || std::fs::read_to_string(&file).unwrap_or_default().lines().count() > 10);
        stop.store(true, Ordering::Release);
    });
    let run = pseudoflow_runtime::supervisor::run(&scene.graph, &crate::toys::registry(), &options);
    stopper.join().expect("the stopper");
    assert!(run.unwrap_or_else(|error| panic!("{error}")).asked_to_stop);
    assert_eq!(scene.text("sink.finished"), scene.lines("sink.txt").to_string());
    assert_nothing_left(scene.dir.path());
}

/// Runs a scene and asks it to stop, with little patience, as soon as its mixer works.
fn stopped_at_work(scene: &Scene) -> Result<Summary, SupervisorError> {
    let mut options = scene.options();
    options.stop_timeout = Duration::from_millis(300);
    let (stop, file) = (options.stop.clone(), scene.path("mixer.busy"));
    let stopper = std::thread::spawn(move || {
        wait_until("the work", || file.exists());
        stop.store(true, Ordering::Release);
    });
    let run = pseudoflow_runtime::supervisor::run(&scene.graph, &crate::toys::registry(), &options);
    stopper.join().expect("the stopper");
    run
}

fn a_hanging_node() {
    let scene = Scene::new(GRAPH).set("mixer.delay_ms", "60000");
    let run = stopped_at_work(&scene);
    let text = run.expect_err("an error").to_string();
    assert!(text.contains("mixer") && text.contains("killed"), "{text}");
    assert!(!is_alive(scene.pid("mixer").expect("a pid")));
    assert_nothing_left(scene.dir.path());
}

/// A node that loads for ten minutes: nothing waits for it.
fn stop_in_the_warm_up() {
    for mode in ["replay", "live"] {
        let scene = Scene::new(GRAPH).set("mode", mode).set("mixer.start_ms", "600000");
        let supervisor = supervise(&scene);
        wait_until("all nodes", || NODES.iter().all(|node| scene.pid(node).is_some()));
        kill(supervisor.id() as i32, Signal::INT);
        let output = supervisor.wait_with_output().expect("an end");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{mode}: {text}");
        assert!(scene.text("summary.json").contains("\"asked_to_stop\": true"));
        assert_nothing_left(scene.dir.path());
    }
}

fn a_hanging_live_node() {
    let scene = Scene::new(GRAPH).set("mode", "live").set("mixer.delay_ms", "600000");
    let run = stopped_at_work(&scene);
    let summary = run.unwrap_or_else(|error| panic!("{error}"));
    assert!(summary.asked_to_stop && summary.killed.contains(&"mixer".to_owned()), "{summary}");
    assert!(!is_alive(scene.pid("mixer").expect("a pid")));
    assert_nothing_left(scene.dir.path());
}

fn orphans() {
    let scene = Scene::new(GRAPH);
    let mut supervisor = supervise(&scene);
    wait_until("progress", || scene.lines("sink.txt") > 10);
    let pids: Vec<i32> = NODES.iter().map(|node| scene.pid(node).expect("a pid")).collect();
    assert!(pids.iter().all(|pid| is_alive(*pid)));
    kill(supervisor.id() as i32, Signal::KILL);
    supervisor.wait().expect("an end");
    wait_until("the nodes' end", || !pids.iter().any(|pid| is_alive(*pid)));
    assert!(scene.path("sink.finished").exists(), "the sink could close its file");
    let seen: serde_json::Value = serde_json::from_str(&scene.text("ipc_seen.json")).expect("the run's description");
    let prefix = seen["prefix"].as_str().expect("a prefix");
    // The next run takes the folder over, and gives back what the first one left.
    let next = Scene { graph: scene.graph.clone(), dir: scene.dir }.set("source.frames", "5");
    next.run();
    assert_eq!(segments(prefix), Vec::<String>::new());
}

fn a_polite_signal() {
    // Slow, so that the death comes within the run on a machine that stalls.
    let scene = Scene::new(GRAPH).set("source.frames", "60").set("mixer.delay_ms", "20");
    std::thread::scope(|scope| {
        scope.spawn(|| {
            wait_until("progress", || scene.lines("sink.txt") > 10);
            kill(scene.pid("sink").expect("a pid"), Signal::TERM);
        });
        assert_eq!(scene.run().nodes[2].restarts, 1);
    });
    assert_eq!((scene.lines("sink.txt"), scene.text("sink.finished").as_str()), (60, "60"));
}

fn a_node_alone() {
    let scene = Scene::new(GRAPH);
    std::fs::write(scene.path("given.yaml"), scene.graph.to_yaml().expect("yaml")).expect("the graph");
    let mut command = Command::new(this_program());
    command.args(["node", "mixer", "--graph"]).arg(scene.path("given.yaml")).arg("--run-dir").arg(scene.dir.path());
    let output = command.output().expect("a process");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && text.contains("start it with `pseudoflow run"), "{text}");
}
