//! `kill -9` of any node in the middle of a replay: the run ends with every frame's poses, equal to an undisturbed run.

mod common;

use common::{into, poses, process_of, pseudoflow};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const NODES: [&str; 7] = ["player", "renderer", "flow", "pnp", "bridge", "recorder", "evaluator"];

fn start(out: &Path) -> Child {
    pseudoflow()
        .args(["run", "config/graphs/refine.yaml", "--out"])
        .arg(out.join("run"))
        .args(into(out))
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts")
}

fn wait_for_frames(count: usize, out: &Path) {
    let deadline = Instant::now() + Duration::from_secs(120);
    while poses(out).len() < count {
        assert!(Instant::now() < deadline, "no {count} frames within two minutes");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn killing_any_node_changes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let calm = folder.path().join("calm");
    assert!(start(&calm).wait().expect("it ends").success());
    let expected = poses(&calm);
    assert!(expected.len() >= 10, "{} frames", expected.len());
    for node in NODES {
        let out = folder.path().join(node);
        let mut run = start(&out);
        wait_for_frames(3, &out);
        let pid = process_of(node, &out).unwrap_or_else(|| panic!("{node} runs"));
        let kill = std::process::Command::new("kill").args(["-9", &pid.to_string()]).status();
        assert!(kill.expect("kill is there").success());
        assert!(run.wait().expect("it ends").success(), "the run without {node} ends well");
        assert_eq!(poses(&out), expected, "poses after {node} was killed");
        let info = common::run(&["bag", "info", &out.join("recording").display().to_string()]);
        assert!(info.status.success(), "{}", String::from_utf8_lossy(&info.stderr));
    }
}
