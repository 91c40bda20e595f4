//! Processes and one process are two ways to run the same graph: what is recorded and scored is the same, byte for byte.

mod common;

use common::{into, poses, pseudoflow};
use std::path::Path;

fn run(graph: &str, out: &Path, more: &[&str]) {
    let mut command = pseudoflow();
    command.args(["run", graph, "--out"]).arg(out.join("run")).args(into(out)).args(more);
    let output = command.output().expect("the binary starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn bags(out: &Path) -> Vec<Vec<u8>> {
    let files = std::fs::read_dir(out.join("recording")).expect("a recording").flatten().map(|entry| entry.path());
    let mut bags: Vec<_> = files.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
    bags.sort();
    bags.iter().map(|path| std::fs::read(path).expect("readable")).collect()
}

#[test]
fn processes_and_one_process_make_the_same_bytes() {
    let folder = tempfile::tempdir().expect("a folder");
    let (processes, one) = (folder.path().join("processes"), folder.path().join("one"));
    for graph in ["config/graphs/region.yaml", "config/graphs/refine.yaml"] {
        for out in [&processes, &one] {
            let _ = std::fs::remove_dir_all(out);
        }
        run(graph, &processes, &[]);
        run(graph, &one, &["--in-process"]);
        assert!(poses(&one).len() >= 10 && poses(&one) == poses(&processes), "{graph}: poses differ");
        let [ours, theirs] = [&one, &processes].map(|out| std::fs::read(out.join("report.json")).expect("a report"));
        assert!(ours == theirs, "{graph}: scores differ");
        assert!(!bags(&one).is_empty() && bags(&one) == bags(&processes), "{graph}: recordings differ");
    }
}
