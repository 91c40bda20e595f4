use super::child::{self, Event, LastWords};
use super::table::LiveTable;
use super::territory::Territory;
use super::{Options, Summary, SupervisorError};
use crate::board::{Board, State, Word};
use crate::ipc::{Bell, Topic};
use crate::plan::Plan;
use iceoryx2::prelude::{Node, ipc};
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

const TICK: Duration = Duration::from_millis(100);
/// From SIGTERM to SIGKILL.
const LAST_GRACE: Duration = Duration::from_secs(3);
/// For taking back what a dead process left.
const CLEANUP: Duration = Duration::from_secs(2);

/// One node's process, as the supervisor sees it.
struct Charge {
    pid: Option<u32>,
    /// When to start it again.
    start_at: Option<Instant>,
    finished: bool,
    words: LastWords,
}

/// How far the end has come.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Running,
    /// The source was asked to end; the others follow.
    Stopping,
    /// SIGTERM was sent to all.
    Terminating,
    /// SIGKILL was sent to all.
    Killing,
}

pub(super) struct Control<'a> {
    plan: &'a Plan,
    board: &'a Board,
    options: &'a Options,
    graph: &'a Path,
    run_dir: PathBuf,
    command: Vec<OsString>,
    charges: Vec<Charge>,
    events: (Sender<Event>, Receiver<Event>),
    phase: Phase,
    next_phase_at: Option<Instant>,
    failure: Option<SupervisorError>,
    killed: Vec<String>,
    table: LiveTable,
    source_bell: Bell,
    /// Keeps every channel alive between the lives of its ends.
    _topics: Vec<Topic>,
    node: Node<ipc::Service>,
}

impl<'a> Control<'a> {
    pub(super) fn new(
        plan: &'a Plan,
        territory: &'a Territory,
        options: &'a Options,
        graph: &'a Path,
    ) -> Result<Self, SupervisorError> {
        let node = territory.ipc().node("supervisor")?;
        let mut topics = Vec::new();
        for (producer, planned) in plan.nodes.iter().enumerate() {
            for output in planned.outputs.iter().filter(|output| output.is_connected()) {
                topics.push(crate::runner::topic(&node, plan, producer, output.port)?);
            }
        }
        let source_bell = Bell::of(&node, &plan.nodes[plan.source].name, plan.nodes.len())?;
        let charge = || Charge { pid: None, start_at: None, finished: false, words: LastWords::default() };
        Ok(Self {
            plan,
            board: territory.board(),
            options,
            graph,
            run_dir: options.run_dir.clone(),
            command: command(options)?,
            charges: plan.nodes.iter().map(|_| charge()).collect(),
            events: channel(),
            phase: Phase::Running,
            next_phase_at: None,
            failure: None,
            killed: Vec::new(),
            table: LiveTable::new(options.print),
            source_bell,
            _topics: topics,
            node,
        })
    }

    /// Runs to the end; `true` when the run was asked to stop.
    pub(super) fn run(mut self) -> Result<bool, SupervisorError> {
        let signals = forward_signals(self.events.0.clone());
        for node in 0..self.charges.len() {
            self.start(node);
        }
        while self.charges.iter().any(|charge| charge.pid.is_some() || charge.start_at.is_some()) {
            match self.events.1.recv_timeout(TICK) {
                Ok(Event::Line { node, text }) => self.hear(node, &text),
                Ok(Event::Exit { node, status }) => self.bury(node, status),
                Ok(Event::Stop) => self.escalate(),
                Err(_) => {}
            }
            self.look_around();
        }
        self.table.clear();
        drop(signals);
        match self.failure.take() {
            Some(failure) => Err(failure),
            None if !self.killed.is_empty() => Err(SupervisorError::Killed(self.killed.join(", "))),
            None => Ok(self.phase != Phase::Running),
        }
    }

    fn start(&mut self, node: usize) {
        let (name, threads) = (&self.plan.nodes[node].name, self.plan.nodes[node].threads);
        match child::start(&self.command, name, threads, self.graph, &self.run_dir) {
            Ok(child) => {
                self.charges[node].pid = Some(child.id());
                child::watch(child, node, &self.events.0);
            }
            Err(source) => self.fail(SupervisorError::Start { node: name.clone(), source }),
        }
    }

    fn hear(&mut self, node: usize, text: &str) {
        self.charges[node].words.hear(text);
        let width = self.plan.nodes.iter().map(|node| node.name.len()).max().unwrap_or(0);
        self.table.say(&format!("{:width$} | {text}", self.plan.nodes[node].name));
    }

    /// A process is gone: done, to be started again, or the end of the run.
    fn bury(&mut self, node: usize, status: Option<ExitStatus>) {
        self.charges[node].pid = None;
        let finished = self.board.state(node) == State::Finished;
        self.charges[node].finished = finished;
        if finished {
            return;
        }
        self.board.set_state(node, State::Away);
        if matches!(self.phase, Phase::Terminating | Phase::Killing) {
            return;
        }
        let (name, how, words) =
            (self.plan.nodes[node].name.clone(), child::how(status), self.charges[node].words.text());
        let restarts = self.board.get(node, Word::Restarts);
        if !child::died(status) {
            return self.fail(SupervisorError::Failed { node: name, how, words });
        }
        if restarts >= u64::from(self.plan.restarts) {
            return self.fail(SupervisorError::GaveUp { node: name, how, restarts, words });
        }
        let pause = Duration::from_millis(50) * 2u32.pow(restarts.min(5) as u32);
        self.table.say(&format!("node `{name}` died ({how}): starting it again"));
        self.board.set(node, Word::Restarts, restarts + 1);
        self.charges[node].start_at = Some(Instant::now() + pause);
    }

    fn look_around(&mut self) {
        if self.options.stop.load(Ordering::Acquire) && self.phase == Phase::Running {
            self.escalate();
        }
        if self.next_phase_at.is_some_and(|at| Instant::now() >= at) {
            self.escalate();
        }
        for node in 0..self.charges.len() {
            if self.charges[node].start_at.is_some_and(|at| Instant::now() >= at) {
                self.charges[node].start_at = None;
                self.reclaim();
                self.start(node);
            }
        }
        if self.table.is_due() {
            self.table.show(&Summary::of(self.plan, self.board).to_string());
        }
    }

    /// Takes back the ports and memory of processes that died.
    fn reclaim(&self) {
        // It may have to wait: iceoryx2 lets one thread of a process clean at a time.
        let state = self.node.blocking_cleanup_dead_nodes(CLEANUP);
        if state.failed_cleanups > 0 {
            log::warn!("{} dead nodes could not be cleaned away yet", state.failed_cleanups);
        }
    }

    fn fail(&mut self, error: SupervisorError) {
        if self.failure.is_none() {
            self.failure = Some(error);
        }
        if !matches!(self.phase, Phase::Terminating | Phase::Killing) {
            self.phase = Phase::Stopping;
            self.escalate();
        }
    }

    /// The next step towards the end: in order, then SIGTERM, then SIGKILL.
    fn escalate(&mut self) {
        let pause = match self.phase {
            Phase::Running => {
                self.phase = Phase::Stopping;
                self.board.request_stop();
                self.source_bell.ring();
                Some(self.options.stop_timeout)
            }
            Phase::Stopping => {
                self.phase = Phase::Terminating;
                self.charges.iter_mut().for_each(|charge| charge.start_at = None);
                if self.failure.is_none() {
                    self.killed = self.names_of_the_living();
                }
                self.signal_all(Signal::TERM);
                Some(LAST_GRACE)
            }
            Phase::Terminating | Phase::Killing => {
                self.phase = Phase::Killing;
                self.signal_all(Signal::KILL);
                None
            }
        };
        self.next_phase_at = pause.map(|pause| Instant::now() + pause);
    }

    fn names_of_the_living(&self) -> Vec<String> {
        let living = self.charges.iter().zip(&self.plan.nodes).filter(|(charge, _)| charge.pid.is_some());
        living.map(|(_, node)| node.name.clone()).collect()
    }

    fn signal_all(&self, signal: Signal) {
        for pid in self.charges.iter().filter_map(|charge| charge.pid) {
            if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
                let _ = kill_process(pid, signal);
            }
        }
    }
}

impl Drop for Control<'_> {
    fn drop(&mut self) {
        // After a panic of the supervisor itself.
        self.signal_all(Signal::KILL);
    }
}

fn command(options: &Options) -> Result<Vec<OsString>, SupervisorError> {
    if let Some(command) = &options.command {
        return Ok(command.clone());
    }
    let program = std::env::current_exe()
        .map_err(|source| SupervisorError::File { path: PathBuf::from("/proc/self/exe"), source })?;
    Ok(vec![program.into(), "node".into()])
}

/// Sends SIGINT, SIGTERM and SIGHUP (the terminal is gone) on as events for as long as the guard lives.
fn forward_signals(events: Sender<Event>) -> Option<SignalGuard> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGHUP, SIGINT, SIGTERM])
        .inspect_err(|error| log::warn!("signals cannot be handled: {error}"))
        .ok()?;
    let handle = signals.handle();
    std::thread::spawn(move || signals.forever().all(|_| events.send(Event::Stop).is_ok()));
    Some(SignalGuard(handle))
}

struct SignalGuard(signal_hook::iterator::Handle);

impl Drop for SignalGuard {
    fn drop(&mut self) {
        self.0.close();
    }
}
