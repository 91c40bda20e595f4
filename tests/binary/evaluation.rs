//! An evaluation is a graph: it goes on where it was interrupted, and its graph gives the same poses again.

mod common;

use common::{pseudoflow, run};
use std::path::{Path, PathBuf};

/// A dataset with truth and rough poses; `None` where it is not there.
fn dataset() -> Option<PathBuf> {
    let shared = std::env::var_os("PSEUDOFLOW_SHARED").map(PathBuf::from)?;
    Some(shared.join("data/tabletop")).filter(|folder| folder.is_dir())
}

/// The rows without their times.
fn rows(csv: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(csv).unwrap_or_else(|error| panic!("{}: {error}", csv.display()));
    text.lines().map(|line| line.rsplit_once(',').expect("columns").0.to_owned()).collect()
}

fn evaluate(dataset: &Path, csv: &Path, more: &[&str]) {
    let every = ["--every", "20", "--stages", "region", "--passes", "2"];
    let mut command = pseudoflow();
    command.arg("eval").arg("--dataset").arg(dataset).arg("--csv").arg(csv).args(every).args(more);
    let output = command.output().expect("the binary starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn an_evaluation_goes_on_and_its_graph_repeats_it() {
    let Some(dataset) = dataset() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("contour_tabletop-test.csv");
    evaluate(&dataset, &csv, &[]);
    let whole = std::fs::read_to_string(&csv).expect("results");
    let expected = rows(&csv);
    assert!(expected.len() > 6, "{whole}");

    // Cut off within the second image.
    let cut = whole.lines().take(8).collect::<Vec<_>>().join("\n");
    std::fs::rename(&csv, folder.path().join("before.csv")).expect("renamed");
    std::fs::write(csv.with_extension("csv.part"), &cut[..cut.len() - 20]).expect("written");
    evaluate(&dataset, &csv, &["--resume"]);
    assert_eq!(rows(&csv), expected);
    let again = std::fs::read_to_string(&csv).expect("results");
    assert_eq!(again.lines().nth(2), whole.lines().nth(2), "the first image was not done again");

    // The graph of a whole run, as processes.
    evaluate(&dataset, &csv, &[]);
    std::fs::remove_file(&csv).expect("removed");
    let graph = csv.with_extension("eval").join("graph.yaml").display().to_string();
    run(&["check", &graph]);
    run(&["run", &graph, "--out", &folder.path().join("run").display().to_string()]);
    assert_eq!(rows(&csv), expected);
}
