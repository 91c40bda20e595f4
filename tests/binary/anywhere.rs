//! The binary runs from any folder, with nothing beside it: what it needs it carries (feature `embed`).

use std::path::Path;
use std::process::{Command, Output};

/// The binary in an empty folder and an empty home.
fn pseudoflow(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pseudoflow"));
    for variable in ["XDG_CACHE_HOME", "XDG_DATA_HOME", "PSEUDOFLOW_SHARE"] {
        command.env_remove(variable);
    }
    // No folder of this machine may help.
    command.env("HOME", folder).env("XDG_DATA_DIRS", folder);
    command.current_dir(folder).args(arguments).output().expect("the binary starts")
}

#[test]
fn shipped_graphs_run_in_an_empty_folder() {
    let tmp = tempfile::tempdir().unwrap();
    let arguments =
        ["run", "config/graphs/refine.yaml", "--in-process", "--out", "out", "--set", "player.max_frames=1"];
    let output = pseudoflow(tmp.path(), &arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(tmp.path().join("out").is_dir());
    let unpacked = std::fs::read_dir(tmp.path().join(".cache/pseudoflow")).unwrap().count();
    assert_eq!(unpacked, 1, "unpacked once, nothing half");
}

#[test]
fn a_file_of_the_user_comes_first_and_a_missing_one_is_named_as_it_was_written() {
    let tmp = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(tmp.path().join("config/graphs")).unwrap();
    std::fs::write(tmp.path().join("config/graphs/track.yaml"), "mode: replay\nnodes: {}\n").unwrap();
    let own = pseudoflow(tmp.path(), &["check", "config/graphs/track.yaml"]);
    let said = [own.stdout, own.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert!(!said.contains("12 nodes"), "{said}");
    let missing = pseudoflow(tmp.path(), &["check", "config/graphs/none.yaml"]);
    let said = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(!missing.status.success() && said.contains("config/graphs/none.yaml"), "{said}");
}
