//! Training as processes: the same bytes of weights whatever dies in between, and whenever it is interrupted.

mod common;

use common::{process_of, pseudoflow};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const NODES: [&str; 8] = ["player", "look", "look_flow", "pnp", "renderer", "flow", "consistency", "trainer"];
const STEPS: u64 = 6;

/// A short training on the demo's recording, small enough for a test; labels of any quality will do.
fn start(out: &Path) -> Child {
    std::fs::create_dir_all(out).expect("a folder");
    let errors = std::fs::File::create(out.join("stderr.txt")).expect("a file");
    let out = out.display();
    let settings = [
        format!("out={out}/training"),
        format!("steps={STEPS}"),
        format!("samples={}", 2 * STEPS),
        "frames_per_step=2".into(),
        "publish_every=1".into(),
        "size_px=64".into(),
        "look_flow.iterations=4".into(),
        "flow.iterations=4".into(),
        "tau=16".into(),
        "window=6".into(),
        "stages=joint".into(),
    ];
    let settings = settings.into_iter().flat_map(|setting| ["--set".to_owned(), setting]);
    pseudoflow()
        .args(["run", "config/graphs/adapt.yaml", "--out", &format!("{out}/run")])
        .args(settings)
        .stdout(Stdio::null())
        .stderr(errors)
        .spawn()
        .expect("the binary starts")
}

/// Waits for the end; what the processes said goes into the report of a failure.
fn ends_well(mut run: Child, out: &Path, killed: &str) {
    let status = run.wait().expect("it ends");
    let said = std::fs::read_to_string(out.join("stderr.txt")).unwrap_or_default();
    assert!(status.success(), "the training in which {killed} was killed: {status}\n{said}");
}

fn steps(out: &Path) -> usize {
    let log = std::fs::read_to_string(out.join("training/adapt.csv")).unwrap_or_default();
    log.lines().count().saturating_sub(1)
}

fn teacher(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("training/teacher.safetensors")).expect("the training wrote its teacher")
}

#[test]
fn killing_any_node_leaves_the_same_weights() {
    let folder = tempfile::tempdir().expect("a folder");
    let calm = folder.path().join("calm");
    ends_well(start(&calm), &calm, "nothing");
    assert_eq!(steps(&calm), STEPS as usize);
    let log = std::fs::read_to_string(calm.join("training/adapt.csv")).expect("the log");
    assert!(log.lines().skip(1).any(|line| !line.contains(",NaN,NaN")), "some step trained: {log}");
    let start_weights = std::fs::read(common::root().join("config/weights/nano_tabletop.safetensors"));
    assert_ne!(teacher(&calm), start_weights.expect("the shipped weights"));
    for node in NODES {
        let out = folder.path().join(node);
        let run = start(&out);
        let deadline = Instant::now() + Duration::from_secs(120);
        while steps(&out) < 2 {
            assert!(Instant::now() < deadline, "no two steps within two minutes");
            std::thread::sleep(Duration::from_millis(10));
        }
        let pid = process_of(node, &out).unwrap_or_else(|| panic!("{node} runs"));
        let kill = std::process::Command::new("kill").args(["-9", &pid.to_string()]).status();
        assert!(kill.expect("kill is there").success());
        ends_well(run, &out, node);
        assert!(teacher(&out) == teacher(&calm), "other weights after {node} was killed");
        assert_eq!(steps(&out), STEPS as usize);
    }
}

/// `pseudoflow adapt`, as small as it gets.
fn adapt(out: &Path, more: &[&str]) -> std::process::Command {
    let mut command = pseudoflow();
    command
        .args(["adapt", "--bag", "bags/tabletop_demo", "--init", "/initial_poses", "--unjudged"])
        .args(["--objects", "config/objects/tabletop", "--weights", "config/weights/nano_tabletop.safetensors"])
        .args(["--steps", "8", "--batch", "1", "--partners", "1", "--size", "64", "--label-size", "64", "--tau", "16"])
        .arg("--out")
        .arg(out)
        .args(more)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

#[test]
fn an_interrupted_adaptation_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().expect("a folder");
    let (whole, broken) = (folder.path().join("whole.safetensors"), folder.path().join("broken.safetensors"));
    assert!(adapt(&whole, &[]).status().expect("it starts").success());
    let mut run = adapt(&broken, &[]).spawn().expect("it starts");
    let log = folder.path().join("broken.adapt/adapt.csv");
    let deadline = Instant::now() + Duration::from_secs(120);
    while std::fs::read_to_string(&log).unwrap_or_default().lines().count() < 3 {
        assert!(Instant::now() < deadline, "no two steps within two minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    let kill = std::process::Command::new("kill").args(["-INT", &run.id().to_string()]).status();
    assert!(kill.expect("kill is there").success());
    assert!(!run.wait().expect("it ends").success(), "an interrupted training says so");
    assert!(!broken.exists(), "and leaves no weights");
    assert!(adapt(&broken, &["--resume"]).status().expect("it starts").success());
    let bytes = |path: &Path| std::fs::read(path).expect("weights");
    assert!(bytes(&whole) == bytes(&broken), "the interruption changed the weights");
}

#[test]
fn adapt_refuses_what_it_cannot_use() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out.safetensors");
    let refused = |more: &[&str]| {
        let base = ["adapt", "--objects", "config/objects/tabletop", "--out", out.to_str().expect("utf-8")];
        let output = common::run(&[&base[..], more].concat());
        assert!(!output.status.success(), "{more:?}");
        assert!(!out.exists(), "nothing is written");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let weights = "config/weights/nano_tabletop.safetensors";
    let said = refused(&["--bag", "bags/tabletop_demo", "--weights", "nowhere.safetensors"]);
    assert!(said.contains("nowhere.safetensors"), "{said}");
    let said = refused(&["--bag", "nowhere", "--weights", weights]);
    assert!(said.contains("nowhere"), "{said}");
    // Without the topic of its initial poses the bag has nothing to train on.
    let said = refused(&["--bag", "bags/tabletop_demo", "--weights", weights]);
    assert!(said.contains("initial pose"), "{said}");
    let said = refused(&["--bag", "bags/tabletop_demo", "--weights", weights, "--resume"]);
    assert!(said.contains("--resume"), "{said}");
    let said = refused(&["--bag", "bags/tabletop_demo", "--weights", weights, "--held-out-every", "1"]);
    assert!(said.contains("--held-out-every"), "{said}");
}

#[test]
fn a_verdict_is_that_of_its_graph_in_processes_or_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let judge = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let set = ["--set", "size_px=64", "--set", "frames={start: 2, step: 3}", "--set"];
        let mut command = pseudoflow();
        command.args(["run", "config/graphs/judge.yaml", "--out"]).arg(out.join("run")).args(more);
        let output = command.args(set).arg(format!("out={}", out.display())).output().expect("the binary starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        ["verdict.json", "judged.jsonl"].map(|file| std::fs::read_to_string(out.join(file)).expect("written"))
    };
    let [verdict, lines] = judge("one", &["--in-process"]);
    assert_eq!(judge("processes", &[]), [verdict.clone(), lines.clone()]);
    assert_eq!(lines.lines().count(), 5, "{lines}");
    assert!(verdict.contains("\"frames\": 5") && verdict.contains("\"interval\""), "{verdict}");
}

#[test]
fn adapt_leaves_the_graph_of_its_verdict() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("a.safetensors");
    let base =
        ["adapt", "--bag", "bags/tabletop_demo", "--init", "/initial_poses", "--objects", "config/objects/tabletop"];
    let rest =
        ["--weights", "config/weights/nano_tabletop.safetensors", "--steps", "1", "--batch", "1", "--size", "64"];
    let more = ["--label-size", "64", "--held-out-every", "3", "--out", out.to_str().expect("utf-8")];
    let output = common::run(&[&base[..], &rest, &more].concat());
    // 3: one step makes nothing better.
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let folder = out.with_extension("adapt");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).expect("written");
    assert!(read("report.html").contains("Held-out instances"));
    let (graph, verdict) = (folder.join("judge.yaml").display().to_string(), read("verdict.json"));
    assert!(common::run(&["check", &graph]).status.success());
    std::fs::remove_file(folder.join("verdict.json")).expect("removed");
    let run = folder.join("again").display().to_string();
    assert!(common::run(&["run", &graph, "--in-process", "--out", &run]).status.success());
    assert_eq!(read("verdict.json"), verdict);
}
