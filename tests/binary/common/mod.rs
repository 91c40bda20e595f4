//! Runs the binary in the repository's root.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the workspace is there")
}

pub(crate) fn pseudoflow() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pseudoflow"));
    // Discovery on the loopback is enough, and runs beside each other must not meet.
    command.current_dir(root()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF");
    command
}

pub(crate) fn run(args: &[&str]) -> Output {
    pseudoflow().args(args).output().expect("the binary starts")
}

/// Overrides that send everything a run of the demo graph writes into `out`.
pub(crate) fn into(out: &Path) -> Vec<String> {
    let out = out.display();
    [
        format!("recorder.path={out}/recording"),
        format!("recorder.overlay.pictures={out}/overlays"),
        format!("evaluator.out={out}"),
    ]
    .into_iter()
    .flat_map(|text| ["--set".to_owned(), text])
    .collect()
}

/// The lines of `poses.jsonl` by frame.
pub(crate) fn poses(out: &Path) -> BTreeMap<u64, String> {
    let text = std::fs::read_to_string(out.join("poses.jsonl")).unwrap_or_default();
    let index = |line: &str| line.split("\"index\":").nth(1)?.split(',').next()?.parse().ok();
    text.lines().filter(|line| line.ends_with('}')).filter_map(|line| Some((index(line)?, line.to_owned()))).collect()
}

/// The process that runs a node of this run.
pub(crate) fn process_of(node: &str, out: &Path) -> Option<u32> {
    let marker = out.display().to_string();
    std::fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let line = std::fs::read(entry.path().join("cmdline")).ok()?;
        let words: Vec<&str> = line.split(|b| *b == 0).filter_map(|w| std::str::from_utf8(w).ok()).collect();
        let is_node = words.get(1) == Some(&"node") && words.get(2) == Some(&node);
        (is_node && words.iter().any(|w| w.starts_with(&marker))).then_some(pid)
    })
}
