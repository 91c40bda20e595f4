//! What needs true poses is a graph, too; only this program knows its nodes.

mod common;

use std::path::PathBuf;
use std::process::{Command, Output};

fn with_truth(args: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_pseudoflow-with-truth");
    Command::new(program).args(args).current_dir(common::root()).output().expect("the program starts")
}

/// Training scenes with their truth; `None` where they are not there.
fn scenes() -> Option<[String; 3]> {
    let set = std::env::var_os("PSEUDOFLOW_SHARED").map(|shared| PathBuf::from(shared).join("data/tabletop"))?;
    let inside = |path: &str| set.join(path).display().to_string();
    set.is_dir().then(|| [inside("train/000001"), inside("train_truth"), inside("models")])
}

const WEIGHTS: &str = "config/weights/nano_tabletop.safetensors";

#[test]
fn audit_and_train_leave_graphs_that_only_this_program_accepts() {
    let Some([bag, truth, objects]) = scenes() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let inside = |name: &str| folder.path().join(name).display().to_string();
    let source = ["--bag", &bag, "--truth", &truth, "--objects", &objects, "--weights", WEIGHTS, "--size", "64"];
    let (audit, weights) = (inside("audit"), inside("t.safetensors"));
    let said = |args: &[&str]| {
        let output = with_truth(&[args, &source].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let table = said(&["audit", "--every", "120", "--refine-first", "--out", &audit]);
    assert!(table.contains("tau at 256") && table.lines().count() == 8, "{table}");
    said(&["train", "--steps", "2", "--batch", "1", "--repeats", "1", "--label-size", "64", "--out", &weights]);
    let log = std::fs::read_to_string(inside("t.csv")).expect("a log");
    assert!(log.starts_with("step,loss_flow,epe_px,grad_norm\n1,") && log.lines().count() == 3, "{log}");
    for graph in [format!("{audit}/audit.yaml"), inside("t.adapt/train.yaml")] {
        assert!(with_truth(&["check", &graph]).status.success(), "{graph}");
        assert!(String::from_utf8_lossy(&with_truth(&["graph", &graph]).stdout).starts_with("flowchart"));
        let refused = common::run(&["check", &graph]);
        assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("no kind of node"));
    }
}

#[test]
fn a_missing_truth_is_said_before_anything_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("audit").display().to_string();
    let source = ["audit", "--bag", "bags/tabletop_demo", "--truth", "nowhere", "--objects", "config/objects/tabletop"];
    let output = with_truth(&[&source[..], &["--weights", WEIGHTS, "--out", &out]].concat());
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere"));
}
