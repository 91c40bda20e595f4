use crate::scene::{Scene, kill, wait_until};
use crate::test;
use libtest_mimic::Trial;
use pseudoflow_runtime::supervisor::{NodeSummary, Summary, SupervisorError};
use rustix::process::Signal;

/// A camera that is faster than what follows.
const GRAPH: &str = "
mode: live
window: 2
nodes:
  camera: {kind: ticker, config: {frames: 300, period_ms: 2, numbers: 100}}
  slow:   {kind: mixer, inputs: {a: camera/numbers}, config: {delay_ms: 15}}
  sink:   {kind: keeper, inputs: {numbers: slow/mixed, more: camera/numbers}}
";

pub(crate) fn tests() -> Vec<Trial> {
    vec![
        test("live::what_asks_for_no_work_need_not_be_sent", outputs_may_be_left_out),
        test("live::what_a_slow_node_works_on_waits_for_it", work_waits),
        test("live::the_newest_wins_and_drops_are_counted", newest_wins),
        test("live::a_graph_that_keeps_up_keeps_its_frames", keeps_up),
        test("live::deaths_cost_frames_but_not_the_run", deaths_cost_frames),
        test("live::bad_frames_are_dropped_counted_and_named", bad_frames_are_dropped),
        test("live::a_graph_of_bad_frames_goes_on", only_bad_frames),
        test("live::a_source_may_meet_bad_messages", bad_messages),
        test("live::the_source_hears_what_all_have_dropped_and_from_whom", source_hears_of_bad),
        test("live::an_error_is_a_death", an_error_is_a_death),
        test("live::an_error_in_the_first_start_ends_the_run", an_error_in_the_start),
        test("live::what_always_fails_is_given_up_with_its_cause", what_always_fails),
        test("live::a_camera_can_take_the_results", camera_takes_results),
        test("live::a_recording_plays_at_its_own_pace", recording_is_paced),
    ]
}

fn node<'a>(summary: &'a Summary, name: &str) -> &'a NodeSummary {
    summary.nodes.iter().find(|node| node.name == name).expect("the node")
}

fn indices(scene: &Scene) -> Vec<u64> {
    let text = scene.text("sink.txt");
    text.lines().map(|line| line.split(' ').next().and_then(|n| n.parse().ok()).expect("an index")).collect()
}

/// Runs the graph and returns its summary and how many of the camera's `frames` were lost on the way, after seeing
/// that those kept came in order, that the newest arrived and that every other is counted by whoever passed it over.
fn run_and_count_lost(scene: &Scene, frames: u64) -> (Summary, u64) {
    let summary = scene.run();
    let kept = indices(scene);
    assert!(kept.windows(2).all(|pair| pair[0] < pair[1]), "out of order: {kept:?}");
    assert_eq!(kept.last(), Some(&(frames - 1)), "the newest frame arrives");
    let lost: u64 = summary.nodes.iter().map(|node| node.drops).sum();
    assert_eq!(kept.len() as u64 + lost, frames, "every frame is either kept or counted: {summary}");
    (summary, lost)
}

/// A learner sends every fifth frame alone: the others are given up for those who join it, and the camera goes on.
fn outputs_may_be_left_out() {
    let scene = Scene::new(
        "
mode: live
window: 2
nodes:
  camera:  {kind: ticker, config: {frames: 60, period_ms: 10}}
  learner: {kind: learner, inputs: {numbers: camera/numbers}}
  sink:    {kind: keeper, inputs: {numbers: learner/weights, more: camera/numbers}}
",
    );
    let summary = scene.run();
    let kept = indices(&scene);
    assert!(!kept.is_empty() && kept.iter().all(|index| index.is_multiple_of(5)), "{kept:?}");
    assert!(node(&summary, "camera").frames > 20, "{summary}");
}

/// While a node is busy with a frame, many come by that were left out: they take nobody's place who waits for it.
fn work_waits() {
    let scene = Scene::new(
        "
mode: live
window: 2
nodes:
  camera:  {kind: ticker, config: {frames: 60, period_ms: 30}}
  learner: {kind: learner, inputs: {numbers: camera/numbers}}
  slow:    {kind: mixer, inputs: {a: learner/weights}, config: {delay_ms: 100}}
  pair:    {kind: mixer, inputs: {a: learner/weights, b: slow/mixed}}
  sink:    {kind: keeper, inputs: {numbers: pair/mixed}}
",
    );
    let summary = scene.run();
    let (worked, kept) = (node(&summary, "slow").frames, indices(&scene).len() as u64);
    assert!(worked >= 3 && kept + 2 >= worked, "{kept} of {worked} came through: {summary}");
}

fn newest_wins() {
    let (summary, _) = run_and_count_lost(&Scene::new(GRAPH), 300);
    let camera = node(&summary, "camera");
    assert!(camera.drops > 0 && camera.frames + camera.drops == 300, "{camera:?}");
}

/// Any node may be kept from running for longer than a period on a loaded machine and then rightly takes the newest
/// of what waits, so a few frames may go; a graph that drops for another reason loses most.
fn keeps_up() {
    let slow_camera = Scene::new(GRAPH).set("camera.period_ms", "60").set("camera.frames", "20");
    let (summary, lost) = run_and_count_lost(&slow_camera.set("slow.delay_ms", "0").set("window", "8"), 20);
    assert!(lost <= 5, "{lost} of 20 lost: {summary}");
}

fn deaths_cost_frames() {
    for victim in ["slow", "sink", "camera"] {
        // Long enough for the death to come within the run on a machine that stalls.
        let scene = Scene::new(GRAPH).set("camera.frames", "1000");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                wait_until("progress", || scene.lines("sink.txt") >= 5);
                kill(scene.pid(victim).expect("a pid"), Signal::KILL);
            });
            let summary = scene.run();
            assert_eq!(node(&summary, victim).restarts, 1, "{victim}: {summary}");
        });
        assert!(indices(&scene).contains(&999), "{victim}: the run goes on to the last frame");
    }
}

/// Bad frames are counted where they were found, and known by nobody behind.
fn bad_frames_are_dropped() {
    let scene = Scene::new(GRAPH).set("slow.bad_every", "3").set("slow.delay_ms", "3").set("camera.period_ms", "5");
    let summary = scene.run();
    let kept = indices(&scene);
    assert!(kept.iter().all(|index| index % 3 != 0) && kept.last() == Some(&299), "{kept:?}");
    let slow = node(&summary, "slow");
    let lost: u64 = summary.nodes.iter().map(|node| node.drops + node.bad).sum();
    assert!(slow.bad > 0 && kept.len() as u64 + lost == 300, "{summary}");
    let cause = slow.last_bad.clone().unwrap_or_default();
    assert!(cause.contains("input `a` from `camera`: told that frame") && cause.contains("dropped"), "{cause}");
    assert!(summary.to_string().contains(&cause) && scene.text("summary.json").contains("told that frame"));
}

fn only_bad_frames() {
    let scene = Scene::new(GRAPH).set("slow.bad_every", "1").set("slow.delay_ms", "0");
    let summary = scene.run();
    let (camera, slow) = (node(&summary, "camera"), node(&summary, "slow"));
    assert!(camera.frames > 10 && slow.bad + slow.drops == camera.frames && slow.frames == 0, "{summary}");
    assert_eq!(indices(&scene), Vec::<u64>::new());
}

fn bad_messages() {
    let scene = Scene::new(GRAPH).set("camera.bad_every", "2").set("slow.delay_ms", "0");
    let summary = scene.run();
    assert_eq!(node(&summary, "camera").bad, 150, "{summary}");
    assert!(indices(&scene).iter().all(|index| index % 2 == 1) && indices(&scene).contains(&299), "{summary}");
}

/// For a source that tells the world: the account goes to it while the run lives.
fn source_hears_of_bad() {
    let scene = Scene::new(GRAPH).set("camera.refuse_every", "3").set("camera.until_heard", "2");
    let scene = scene.set("slow.bad_every", "3").set("slow.delay_ms", "0");
    let summary = scene.run();
    let heard = scene.text("heard.txt");
    let lines: Vec<_> = heard.lines().collect();
    assert_eq!(lines, ["camera None None true", "slow Some(\"a\") Some(\"camera\") true"]);
    let camera = node(&summary, "camera");
    assert_eq!((camera.bad, camera.last_bad.as_deref()), (100, Some("told to refuse")), "{summary}");
    let slow = &node(&summary, "slow").bad_from[0];
    assert!(slow.input == Some("a") && slow.producer.as_deref() == Some("camera"), "{slow:?}");
}

fn an_error_is_a_death() {
    for victim in ["slow", "sink", "camera"] {
        let scene = Scene::new(GRAPH).set("camera.frames", "1000").set(&format!("{victim}.fail_once"), "true");
        let summary = scene.run();
        assert_eq!(node(&summary, victim).restarts, 1, "{victim}: {summary}");
        assert!(indices(&scene).contains(&999), "{victim}: the run goes on to the last frame");
        let incident = &summary.incidents[0];
        assert!(incident.node == victim && incident.what.contains("exit code 1"), "{incident:?}");
    }
}

fn an_error_in_the_start() {
    let error = Scene::new(GRAPH).set("slow.fail_at_start", "true").try_run().expect_err("an error");
    assert!(matches!(error, SupervisorError::Failed { .. }), "{error}");
    assert!(error.to_string().contains("told to fail in its start"), "{error}");
}

fn what_always_fails() {
    let scene = Scene::new(GRAPH).set("camera.frames", "100000").set("slow.fail_always", "true").set("restarts", "2");
    let error = scene.try_run().expect_err("an error");
    assert!(matches!(error, SupervisorError::GaveUp { restarts: 2, .. }), "{error}");
    assert!(error.to_string().contains("told to fail at frame"), "{error}");
    assert!(scene.text("summary.json").contains("gave up after 2 restarts"), "the summary says why");
}

fn camera_takes_results() {
    let scene = Scene::new(
        "
mode: live
window: 2
nodes:
  bridge: {kind: ticker, inputs: {results: mixer/mixed}, config: {frames: 400, period_ms: 3}}
  mixer:  {kind: mixer, inputs: {a: bridge/numbers}}
",
    );
    scene.run();
    let results: Vec<u64> = scene.text("results.txt").lines().map(|line| line.parse().expect("an index")).collect();
    assert!(results.len() > 10 && results.is_sorted(), "{results:?}");
}

fn recording_is_paced() {
    let scene = Scene::new(
        "
mode: live
nodes:
  player: {kind: counter, config: {frames: 20, period_ms: 20}}
  sink:   {kind: keeper, inputs: {numbers: player/numbers}}
",
    );
    let summary = scene.run();
    let player = node(&summary, "player");
    let rate = player.rate_hz.expect("a rate");
    // 50 Hz; a stall before the first frame makes the rest come faster, but without the pace it would be thousands.
    assert!(player.frames + player.drops == 20 && rate < 150.0, "{summary}");
}
