//! Runs a graph and looks at what it left.

use crate::{this_program, toys};
use pseudoflow_runtime::supervisor::{Options, Summary, SupervisorError};
use pseudoflow_runtime::{Graph, supervisor};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A graph with a folder of its own.
pub(crate) struct Scene {
    pub(crate) dir: TempDir,
    pub(crate) graph: Graph,
}

impl Scene {
    pub(crate) fn new(yaml: &str) -> Self {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let graph = Graph::parse(yaml, Path::new("scene.yaml")).unwrap_or_else(|error| panic!("{error}"));
        Self { dir, graph }
    }

    pub(crate) fn set(mut self, key: &str, value: &str) -> Self {
        self.graph.set(key, value).unwrap_or_else(|error| panic!("{error}"));
        self
    }

    pub(crate) fn options(&self) -> Options {
        let command = Some(vec![this_program().into(), "node".into()]);
        // Patient, so that a busy machine ends in order, too.
        let stop_timeout = Duration::from_secs(30);
        Options { command, print: false, stop_timeout, ..Options::new(self.dir.path()) }
    }

    pub(crate) fn try_run(&self) -> Result<Summary, SupervisorError> {
        let result = supervisor::run(&self.graph, &toys::registry(), &self.options());
        assert_nothing_left(self.dir.path());
        result
    }

    pub(crate) fn run(&self) -> Summary {
        self.try_run().unwrap_or_else(|error| panic!("{error}"))
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_default()
    }

    pub(crate) fn lines(&self, name: &str) -> usize {
        self.text(name).lines().count()
    }

    pub(crate) fn pid(&self, node: &str) -> Option<i32> {
        self.text(&format!("{node}.pid")).parse().ok()
    }
}

/// No segment, socket or state file of the run is there any more.
pub(crate) fn assert_nothing_left(run_dir: &Path) {
    let seen = std::fs::read(run_dir.join("ipc_seen.json")).expect("a node has signed in");
    let seen: serde_json::Value = serde_json::from_slice(&seen).expect("the run's description");
    let prefix = seen["prefix"].as_str().expect("a prefix");
    assert_eq!(segments(prefix), Vec::<String>::new());
    assert!(!Path::new(seen["root"].as_str().expect("a root")).exists(), "the temporary folder is left");
    assert!(!run_dir.join(".run").exists(), "the state folder is left");
}

pub(crate) fn segments(prefix: &str) -> Vec<String> {
    let names = std::fs::read_dir("/dev/shm").expect("/dev/shm").flatten();
    names.map(|entry| entry.file_name().to_string_lossy().into_owned()).filter(|n| n.starts_with(prefix)).collect()
}

/// Waits for something that other processes bring about.
pub(crate) fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !done() {
        assert!(begin.elapsed() < Duration::from_secs(60), "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

pub(crate) fn kill(pid: i32, signal: rustix::process::Signal) {
    if let Some(pid) = rustix::process::Pid::from_raw(pid) {
        let _ = rustix::process::kill_process(pid, signal);
    }
}

pub(crate) fn is_alive(pid: i32) -> bool {
    // A zombie is no longer alive, though its id is still taken.
    let state = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    state.rsplit(')').next().is_some_and(|rest| !rest.trim().is_empty() && !rest.trim().starts_with('Z'))
}
