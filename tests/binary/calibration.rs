//! A calibration is a graph over synthetic scenes: run again it says the same, and what it learnt comes from its samples alone.

mod common;

use common::run;
use std::path::Path;

fn calibrate(out: &Path, more: &[&str]) -> std::process::Output {
    let out = out.display().to_string();
    let args =
        ["calibrate", "--objects", "config/objects/tabletop", "--stages", "region", "--seed", "5", "--out", &out];
    run(&args.into_iter().chain(more.iter().copied()).collect::<Vec<_>>())
}

/// A model without the command that made it.
fn learnt(model: &Path) -> String {
    let text = std::fs::read_to_string(model).unwrap_or_else(|error| panic!("{}: {error}", model.display()));
    text.split_once("\nstages:").expect("a model").1.to_owned()
}

/// Lines of a file, in an order that does not depend on processes.
fn lines(file: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    lines.sort();
    lines
}

#[test]
fn a_calibration_and_its_graph_say_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = folder.path().join("gate.yaml");
    let output = calibrate(&model, &["--scenes", "10"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    // The contour brings most of them nearer to the truth: truth and refinements were put together rightly.
    let samples = folder.path().join("gate.region.samples.jsonl");
    let errors: Vec<[f64; 2]> = lines(&samples)
        .iter()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .map(|sample: serde_json::Value| ["before", "after"].map(|key| sample[key].as_f64().expect("a number")))
        .collect();
    let better = errors.iter().filter(|[before, after]| after < before).count();
    assert!(errors.len() > 20 && 2 * better > errors.len(), "{better} of {} are better", errors.len());

    // The same from the samples alone.
    let again = folder.path().join("again.yaml");
    let output = calibrate(&again, &["--scenes", "0", "--samples", &samples.display().to_string()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(learnt(&again), learnt(&model));

    // The graph that was kept, as processes.
    let kept = folder.path().join("gate.calibrate/0");
    let (truth, details) = (lines(&kept.join("truth.jsonl")), lines(&kept.join("details.jsonl")));
    assert_eq!((truth.len(), details.len()), (10, 10));
    for name in ["truth.jsonl", "details.jsonl"] {
        std::fs::remove_file(kept.join(name)).expect("removed");
    }
    let graph = kept.join("graph.yaml").display().to_string();
    run(&["run", &graph, "--out", &folder.path().join("run").display().to_string()]);
    assert_eq!((lines(&kept.join("truth.jsonl")), lines(&kept.join("details.jsonl"))), (truth, details));
}

#[test]
fn the_old_word_names_the_new_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = calibrate(&folder.path().join("gate.yaml"), &["--pairs", "800"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("--scenes 200"), "{said}");
}
