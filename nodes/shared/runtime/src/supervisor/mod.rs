//! Starts every node of a graph as a process of its own, watches over them, and leaves nothing behind.

mod child;
mod control;
mod run_resources;
mod summary;
mod table;
mod warnings;
mod watchdog;

pub use summary::{Incident, NodeSummary, ObjectsWork, Summary};
pub use warnings::{Severity, Warning, Warnings};

use crate::Registry;
use crate::graph::{Graph, GraphError};
use crate::ipc::IpcError;
use crate::plan::Plan;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// How to run a graph.
#[derive(Debug, Clone)]
pub struct Options {
    /// Folder of the run: made if need be; holds the graph as it ran, the summary, and what nodes leave there.
    pub run_dir: PathBuf,
    /// What starts a node; its name, `--graph FILE --run-dir DIR` are appended. The default is this very program
    /// with `node`.
    pub command: Option<Vec<OsString>>,
    /// How long a run may take to end in order once it is asked to stop. Then its nodes are told to close what they keep,
    /// 300 ms later they are killed; only one that keeps what would be lost (a recorder) may
    /// finish that.
    pub stop_timeout: Duration,
    /// Asks the run to stop, as SIGINT and SIGTERM do.
    pub stop: Arc<AtomicBool>,
    /// Whether to print logs, the table while running (on a terminal only) and the one at the end.
    pub print: bool,
    /// What stands below the table while the run goes on.
    pub below: Below,
}

/// A text that is asked for whenever the table is shown; none by default.
#[derive(Clone, Default)]
pub struct Below(pub Option<Arc<dyn Fn() -> String + Send + Sync>>);

impl std::fmt::Debug for Below {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.is_some() { "Below(..)" } else { "Below(None)" })
    }
}

impl Options {
    /// Runs in this folder with the defaults: own program, half a second to stop, printing.
    #[must_use]
    pub fn new(run_dir: &Path) -> Self {
        Self {
            run_dir: run_dir.to_owned(),
            command: None,
            stop_timeout: Duration::from_millis(500),
            stop: Arc::default(),
            print: true,
            below: Below::default(),
        }
    }
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum SupervisorError {
    /// The graph would not run.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// A file or folder of the run.
    #[error("{}: {source}: check the run folder", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The folder belongs to a run that goes on.
    #[error("{}: process {pid} runs a graph there: take another folder or stop it", run_dir.display())]
    Busy {
        /// The folder.
        run_dir: PathBuf,
        /// Its supervisor.
        pid: u32,
    },
    /// Shared memory.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// A process could not be started.
    #[error("node `{node}` could not be started: {source}")]
    Start {
        /// The node.
        node: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// A node of a replay ended with an error, or one of any graph before it was ready: no restart would heal it.
    #[error("node `{node}` failed ({how}):\n{words}")]
    Failed {
        /// The node.
        node: String,
        /// How its process ended.
        how: String,
        /// The last lines that it wrote.
        words: String,
    },
    /// A node died too often.
    #[error("node `{node}` died ({how}); gave up after {restarts} restarts. Its last words:\n{words}")]
    GaveUp {
        /// The node.
        node: String,
        /// How its process ended.
        how: String,
        /// How often it was started again.
        restarts: u64,
        /// The last lines that it wrote.
        words: String,
    },
    /// Asked to stop, some nodes of a replay did not.
    #[error("asked to stop, {0} did not end in time and had to be killed: their last frames may be missing")]
    Killed(String),
}

/// Runs a graph to its end, or until it is asked to stop.
///
/// # Errors
/// When the graph has problems, or a node fails or dies too often. Nothing of the run is left in shared memory or
/// temporary folders either way.
pub fn run(graph: &Graph, registry: &Registry, options: &Options) -> Result<Summary, SupervisorError> {
    crate::graph::check(graph, registry).map_err(GraphError::Problems)?;
    let plan = Plan::new(graph, registry)?;
    let begin_ns = crate::clock::monotonic_ns();
    // From here on there is something to give back: no signal may end this process before that.
    let events = std::sync::mpsc::channel();
    let signals = control::forward_signals(events.0.clone());
    let resources = run_resources::RunResources::claim(&options.run_dir, plan.nodes.len())?;
    let file = options.run_dir.join("graph.yaml");
    let as_it_runs = graph.resolved().map_err(GraphError::Problems)?.to_yaml()?;
    pseudoflow_files::write_private(&file, as_it_runs.as_bytes())
        .map_err(|source| SupervisorError::File { path: file.clone(), source })?;
    let mut control = control::Control::new(&plan, &resources, options, &file, events)?;
    let result = control.run();
    let mut summary = Summary::of(&plan, resources.board()).since(begin_ns, plan.source, resources.board());
    control.tell(&mut summary);
    drop(control);
    drop(resources);
    drop(signals);
    if options.print {
        summary::print(&summary);
    }
    summary.asked_to_stop = *result.as_ref().unwrap_or(&false);
    summary.failure = result.as_ref().err().map(ToString::to_string);
    let written = summary.write(&options.run_dir.join("summary.json"));
    result.and(written).map(|()| summary)
}
