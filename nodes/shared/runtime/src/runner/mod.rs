//! Runs one node in its process: joins what comes in by frame, calls the node, sends what it makes.
//!
//! # How nothing is lost in replay
//! The source sends frame `i` only while `i < a + window`, where all sinks have acknowledged every frame below
//! `a`. When a node dies, its successor counts itself ready on the [board](crate::board) and wakes the source,
//! which sends all frames from `a` on again. Nodes recompute what comes twice; sinks skip what they have already
//! acknowledged, and take frames strictly in order.
//!
//! No buffer has to block for this. After the last copy of frame `f` has been sent by a port, only frames
//! between `f` and `f + window` can follow it before `f` is acknowledged, because every node sends in order of
//! frames and a later copy of an earlier frame comes with a later copy of `f`. So a buffer of one window that
//! gives up its oldest message never gives up the last copy of a frame that somebody still needs.
//!
//! # How live mode stays live
//! The source keeps at most a window of frames in the graph; what comes meanwhile waits in one place where the
//! newest replaces the older. A node with several whole frames before it takes the newest. Both are counted as
//! drops. Frames that died with a node are forgotten when its successor is ready. A frame that a node cannot use
//! ([`BadInput`](crate::BadInput)) is counted there; an empty message marked as void tells those who join it, and theirs.
//! So does an output that a node leaves out: there is no work for that frame.

mod complaints;
mod consumer;
mod intake;
mod join;
mod links;
mod live_source;
mod orphan;
mod outputs;
mod replay_source;

use crate::board::{Board, State, Word};
use crate::graph::{Graph, GraphError};
use crate::ipc::{IpcError, RunIpc};
use crate::plan::{Plan, PlannedNode};
use crate::registry::{Registry, read_config};
use crate::{Context, Node, NodeError, Role};
use complaints::Complaints;
use intake::Intake;
pub(crate) use intake::topic;
use links::Links;
use outputs::IpcOutputs;
pub(crate) use outputs::OutputError;
use std::path::{Path, PathBuf};

/// Folder within the run's folder for what only the running processes need.
pub(crate) const STATE_DIR: &str = ".run";
pub(crate) const BOARD_FILE: &str = "board";
pub(crate) const IPC_FILE: &str = "ipc.json";

/// Why a node ended.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The graph.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// Not a node of the graph.
    #[error("the graph has no node `{name}`: its nodes are {known}")]
    UnknownNode {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// No run to take part in.
    #[error("{}: {source}: nodes take part in a run: start it with `pseudoflow run GRAPH`", path.display())]
    NoRun {
        /// The missing or foreign file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The run's supervisor is gone.
    #[error("the supervisor of this run (process {0}) is gone: start the run again")]
    Orphan(u32),
    /// Shared memory.
    #[error("node `{node}`: {source}")]
    Ipc {
        /// The node.
        node: String,
        /// What failed.
        source: IpcError,
    },
    /// A live graph where nodes run one after the other.
    #[error("a live graph needs a process for each node: write `mode: replay`, or `pseudoflow run`")]
    LiveInProcess,
    /// Nobody can go on.
    #[error("nothing moves any more: {causes}; at most {window} frames are in flight: is `window` large enough?")]
    Stalled {
        /// Which nodes wait for what.
        causes: String,
        /// Frames in flight.
        window: u64,
    },
    /// The node itself.
    #[error("node `{node}`: {place}: {cause}")]
    Node {
        /// The node.
        node: String,
        /// What it was doing: `configuration`, `frame 7`, ...
        place: String,
        /// The node's own error with its causes.
        cause: String,
    },
}

/// What a node's process was started with.
pub(crate) struct Launch {
    plan: Plan,
    /// This node's position in the plan.
    me: usize,
    board: Board,
    ipc: RunIpc,
    run_dir: PathBuf,
}

impl Launch {
    fn node(&self) -> &PlannedNode {
        &self.plan.nodes[self.me]
    }

    fn ipc_error(&self, source: IpcError) -> RunError {
        RunError::Ipc { node: self.node().name.clone(), source }
    }

    fn node_error(&self, place: impl Into<String>, error: &NodeError) -> RunError {
        self.error(place, crate::error::chain(&**error))
    }

    fn error(&self, place: impl Into<String>, cause: impl Into<String>) -> RunError {
        RunError::Node { node: self.node().name.clone(), place: place.into(), cause: cause.into() }
    }

    /// A sign of life, and the frame that is begun: the supervisor ends what gives none for too long.
    fn beat(&self, frame: Option<u64>) {
        self.board.beat(self.me, crate::clock::monotonic_ns(), frame);
    }

    fn count_frame(&self, objects: Option<usize>, begin_ns: u64, origin_ns: u64) {
        let end_ns = crate::clock::monotonic_ns();
        self.board.count_frame(self.me, begin_ns, end_ns, origin_ns);
        if let Some(objects) = objects {
            self.board.count_objects(self.me, objects, end_ns - begin_ns);
        }
    }

    /// Name of the node that feeds an input.
    fn producer_of(&self, port: &str) -> Option<&str> {
        let input = self.node().inputs.iter().find(|input| input.port == port)?;
        Some(&self.plan.nodes[input.producer].name)
    }

    /// First frame that not all sinks have acknowledged.
    fn acknowledged_by_all(&self) -> u64 {
        let by_each = self.plan.acknowledgers().map(|node| self.board.get(node, Word::Acknowledged));
        by_each.min().unwrap_or(0)
    }
}

/// Loads graph and run state, and starts the kind.
pub(crate) fn run_node(registry: &Registry, name: &str, graph: &Path, run_dir: &Path) -> Result<(), RunError> {
    let plan = Plan::new(&Graph::read(graph)?, registry)?;
    let me = plan.position(name).ok_or_else(|| RunError::UnknownNode {
        name: name.to_owned(),
        known: plan.nodes.iter().map(|node| node.name.as_str()).collect::<Vec<_>>().join(", "),
    })?;
    let (board, ipc) = open_run(run_dir)?;
    orphan::die_with(ipc.supervisor)?;
    stand_back(plan.nodes[me].nice);
    let run = plan.nodes[me].kind.run;
    run(&Launch { plan, me, board, ipc, run_dir: run_dir.to_owned() })
}

/// Lowers the priority of this process, the threads to come included.
fn stand_back(nice: u8) {
    if nice > 0
        && let Err(error) = rustix::process::nice(i32::from(nice))
    {
        log::warn!("`nice: {nice}` could not be had ({error}): this node competes with all others");
    }
}

fn open_run(run_dir: &Path) -> Result<(Board, RunIpc), RunError> {
    let path = run_dir.join(STATE_DIR).join(BOARD_FILE);
    let board = Board::open(&path).map_err(|source| RunError::NoRun { path, source })?;
    let path = run_dir.join(STATE_DIR).join(IPC_FILE);
    let text = std::fs::read(&path).map_err(|source| RunError::NoRun { path: path.clone(), source })?;
    let ipc = serde_json::from_slice(&text).map_err(|e| RunError::NoRun { path, source: e.into() })?;
    Ok((board, ipc))
}

/// How a node's loop came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The run is over, every frame was seen.
    InOrder,
    /// A signal to this process.
    Terminated,
}

/// A node with all that connects it.
struct Runner<'a, N> {
    launch: &'a Launch,
    context: Context,
    /// CPU time of this process that is on the board.
    counted_cpu_ns: u64,
    node: N,
    intake: Intake,
    outputs: IpcOutputs,
    links: Links,
    complaints: Complaints,
}

/// The whole life of a node of kind `N`.
pub(crate) fn run<N: Node>(launch: &Launch) -> Result<(), RunError> {
    let planned = launch.node();
    let context = Context {
        name: planned.name.clone(),
        seed: launch.plan.seed,
        out_dir: launch.run_dir.clone(),
        restarts: launch.board.get(launch.me, Word::Restarts) as u32,
        replay: launch.plan.replay(),
    };
    launch.board.set(launch.me, Word::Pid, u64::from(std::process::id()));
    let config = read_config::<N>(&planned.config).map_err(|error| launch.error(error.field, error.what))?;
    let node = N::create(config, &context).map_err(|error| launch.node_error("start", &error))?;
    let mut runner = connect(launch, context, node)?;
    runner.begin()?;
    runner.announce();
    let ending = runner.turn()?;
    runner.close(ending)
}

fn connect<N: Node>(launch: &Launch, context: Context, node: N) -> Result<Runner<'_, N>, RunError> {
    let error = |e| launch.ipc_error(e);
    let ipc_node = launch.ipc.node(&launch.node().name).map_err(error)?;
    let intake = Intake::new(&ipc_node, &launch.plan, launch.me).map_err(error)?;
    let outputs = IpcOutputs::new(&ipc_node, &launch.plan, launch.me).map_err(error)?;
    let links = Links::new(ipc_node, &launch.plan, launch.me).map_err(error)?;
    Ok(Runner { launch, context, counted_cpu_ns: 0, node, intake, outputs, links, complaints: Complaints::default() })
}

impl<N: Node> Runner<'_, N> {
    /// What the node sends before its first frame.
    fn begin(&mut self) -> Result<(), RunError> {
        self.outputs.begin(None, crate::clock::monotonic_ns());
        let begun = self.node.begin(&mut self.outputs, &self.context);
        begun.map_err(|error| self.launch.node_error("start", &error))?;
        self.links.ring_consumers();
        Ok(())
    }

    /// From here on the node gets its frames.
    fn announce(&mut self) {
        let Launch { board, me, .. } = self.launch;
        self.count_cpu(Word::StartCpuNs);
        board.set_state(*me, State::Ready);
        board.add(*me, Word::Generation, 1);
        log::info!("{} is ready (start {})", self.context.name, self.context.restarts + 1);
        self.links.ring_source();
        self.links.ring_producers();
    }

    fn turn(&mut self) -> Result<Ending, RunError> {
        match (self.launch.me == self.launch.plan.source, self.launch.plan.replay()) {
            (true, true) => self.replay_frames(),
            (true, false) => self.pass_live_frames(N::ROLE == Role::ReplaySource),
            (false, _) => self.consume(),
        }
    }

    fn close(mut self, ending: Ending) -> Result<(), RunError> {
        self.launch.beat(None);
        if N::KEEPS {
            self.launch.board.set_state(self.launch.me, State::Closing);
        }
        self.node.finish(&self.context).map_err(|error| self.launch.node_error("end", &error))?;
        self.count_cpu(Word::CpuNs);
        if ending == Ending::InOrder {
            self.launch.board.set_state(self.launch.me, State::Finished);
            self.links.ring_consumers();
            self.links.ring_producers();
            self.linger()?;
        }
        Ok(())
    }

    /// Keeps the last messages of a live run alive until their consumers have taken them.
    fn linger(&mut self) -> Result<(), RunError> {
        let consumers = self.launch.plan.consumers(self.launch.me);
        let waits = |board: &Board| consumers.iter().any(|node| board.state(*node) == State::Ready);
        for _ in 0..20 {
            if self.launch.plan.replay() || !waits(&self.launch.board) || self.sleep(links::TICK)? {
                break;
            }
        }
        Ok(())
    }

    /// Puts the CPU time since the last call on the board.
    fn count_cpu(&mut self, word: Word) {
        let now_ns = crate::clock::process_cpu_ns();
        self.launch.board.add(self.launch.me, word, now_ns.saturating_sub(self.counted_cpu_ns));
        self.counted_cpu_ns = now_ns;
    }

    /// Tells the node what the run has dropped, where that has changed.
    fn pass_bad_on(&mut self) -> Result<(), RunError> {
        let Some(bad) = self.complaints.news(self.launch) else { return Ok(()) };
        let heard = self.node.hear_of_bad(bad, &self.context);
        heard.map_err(|error| self.launch.node_error("account of bad frames", &error))
    }

    /// `true` when the process is asked to end.
    fn sleep(&mut self, at_most: std::time::Duration) -> Result<bool, RunError> {
        self.launch.beat(None);
        self.count_cpu(Word::CpuNs);
        self.outputs.update();
        self.pass_bad_on()?;
        self.links.sleep(at_most).map_err(|e| self.launch.ipc_error(e))
    }
}
