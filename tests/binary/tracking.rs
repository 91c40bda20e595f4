//! Tracking as processes, with what search and looks have found fed back: whatever dies in between, the run ends and its recording is whole.

mod common;

use common::{process_of, pseudoflow};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const NODES: [&str; 7] = ["player", "tracker", "initializer", "renderer", "flow", "pnp", "recorder"];
const NETWORK: &str = "name: tiny\ninput_px: [96, 64]\nwidths: [16, 24]\npyramid: 16\n";
const FRAMES: &str = "15";

/// A small network after one step of training: it finds anything anywhere, which is all that this test needs.
fn weights(folder: &Path) -> [PathBuf; 2] {
    let (network, weights) = (folder.join("tiny.yaml"), folder.join("tiny.safetensors"));
    std::fs::write(&network, NETWORK).expect("a file");
    let trained = pseudoflow()
        .args(["pretrain", "--stage", "initializer", "--objects", "config/objects/tabletop", "--warm-start", "random"])
        .args(["--steps", "1", "--batch", "2", "--block", "2", "--network"])
        .arg(&network)
        .arg("--out")
        .arg(&weights)
        .output()
        .expect("the binary starts");
    assert!(trained.status.success(), "{}", String::from_utf8_lossy(&trained.stderr));
    [network, weights]
}

fn start(out: &Path, [network, weights]: &[PathBuf; 2]) -> Child {
    std::fs::create_dir_all(out).expect("a folder");
    let errors = std::fs::File::create(out.join("stderr.txt")).expect("a file");
    let settings = [
        format!("initializer.model={}", weights.display()),
        format!("initializer.network={}", network.display()),
        "initializer.detect={min_vote: 0.02, min_score: 0, min_votes: 1, threshold_sides: 0.3}".into(),
        "initializer.compare=null".into(),
        "renderer.size_px=64".into(),
        "flow.size_px=64".into(),
        "flow.iterations=4".into(),
        format!("recorder.path={}/recording", out.display()),
        format!("recorder.overlay.pictures={}/overlays", out.display()),
    ];
    let settings = settings.into_iter().flat_map(|setting| ["--set".to_owned(), setting]);
    pseudoflow()
        .args(["run", "config/graphs/track.yaml", "--out", &format!("{}/run", out.display())])
        .args(settings)
        .stdout(Stdio::null())
        .stderr(errors)
        .spawn()
        .expect("the binary starts")
}

fn pictures(out: &Path) -> usize {
    std::fs::read_dir(out.join("overlays")).map_or(0, Iterator::count)
}

#[test]
fn whatever_dies_the_recording_is_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let weights = weights(folder.path());
    for node in NODES {
        let out = folder.path().join(node);
        let mut run = start(&out, &weights);
        let deadline = Instant::now() + Duration::from_secs(120);
        while pictures(&out) < 3 {
            assert!(Instant::now() < deadline, "no three frames within two minutes");
            std::thread::sleep(Duration::from_millis(10));
        }
        let pid = process_of(node, &out).unwrap_or_else(|| panic!("{node} runs"));
        let kill = std::process::Command::new("kill").args(["-9", &pid.to_string()]).status();
        assert!(kill.expect("kill is there").success());
        let status = run.wait().expect("it ends");
        let said = std::fs::read_to_string(out.join("stderr.txt")).unwrap_or_default();
        assert!(status.success(), "the run in which {node} was killed: {status}\n{said}");
        let info = common::run(&["bag", "info", &out.join("recording").display().to_string()]);
        let text = String::from_utf8_lossy(&info.stdout).into_owned();
        assert!(info.status.success() && text.contains("/object_status"), "{text}");
        let line = text.lines().find(|line| line.contains("/object_status")).unwrap_or_default();
        assert!(line.split_whitespace().any(|word| word == FRAMES), "after {node} was killed: {line}");
    }
}
