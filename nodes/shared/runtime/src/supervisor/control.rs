use super::child::{self, Event, LastWords};
use super::run_resources::RunResources;
use super::table::LiveTable;
use super::warnings::{Severity, WarningsFile};
use super::watchdog::{Deadlines, Watchdog};
use super::{Incident, Options, Summary, SupervisorError};
use crate::board::{Board, State, Word};
use crate::clock::monotonic_ns;
use crate::ipc::{Bell, Topic};
use crate::plan::Plan;
use iceoryx2::prelude::{Node, ipc};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::VecDeque;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

const TICK: Duration = Duration::from_millis(50);
/// From SIGTERM to SIGKILL.
const LAST_GRACE: Duration = Duration::from_millis(300);
/// The same when the run has failed: nobody waits for the prompt.
const FAILURE_GRACE: Duration = Duration::from_secs(3);
/// For a node that is writing its files when all others are killed.
const CLOSING_GRACE: Duration = Duration::from_secs(10);
/// For taking back what a dead process left.
const CLEANUP: Duration = Duration::from_secs(2);
/// A live node that has lived so long is well: its earlier deaths no longer count against it.
const WELL_AFTER: Duration = Duration::from_secs(30);

/// One node's process, as the supervisor sees it.
struct Charge {
    pid: Option<u32>,
    /// When to start it again.
    start_at: Option<Instant>,
    finished: bool,
    words: LastWords,
    /// Restarts that count against it, and when its present life began.
    attempts: u32,
    began: Instant,
    /// Why its process was killed by the watchdog.
    stalled: Option<String>,
}

/// How far the end has come.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Running,
    /// The source was asked to end; the others follow.
    Stopping,
    /// SIGTERM was sent to all.
    Terminating,
    /// SIGKILL was sent to all but those that are writing their files.
    Killing,
    /// SIGKILL was sent to all.
    KillingAll,
}

/// What the supervisor is told, and where to tell it.
pub(super) type Events = (Sender<Event>, Receiver<Event>);

pub(super) struct Control<'a> {
    plan: &'a Plan,
    board: &'a Board,
    options: &'a Options,
    graph: &'a Path,
    run_dir: PathBuf,
    command: Vec<OsString>,
    charges: Vec<Charge>,
    events: Events,
    phase: Phase,
    next_phase_at: Option<Instant>,
    failure: Option<SupervisorError>,
    killed: Vec<String>,
    /// Whether all nodes were there when the run was asked to stop.
    had_begun: bool,
    incidents: VecDeque<Incident>,
    warnings: WarningsFile,
    watchdog: Watchdog,
    begin: Instant,
    table: LiveTable,
    source_bell: Bell,
    /// Keeps every channel alive between the lives of its ends.
    _topics: Vec<Topic>,
    node: Node<ipc::Service>,
}

impl<'a> Control<'a> {
    pub(super) fn new(
        plan: &'a Plan,
        resources: &'a RunResources,
        options: &'a Options,
        graph: &'a Path,
        events: Events,
    ) -> Result<Self, SupervisorError> {
        let node = resources.ipc().node("supervisor")?;
        let mut topics = Vec::new();
        for (producer, planned) in plan.nodes.iter().enumerate() {
            for output in planned.outputs.iter().filter(|output| output.is_connected()) {
                topics.push(crate::runner::topic(&node, plan, producer, output.port)?);
            }
        }
        let source_bell = Bell::of(&node, &plan.nodes[plan.source].name, plan.nodes.len())?;
        let charge = || Charge {
            pid: None,
            start_at: None,
            finished: false,
            words: LastWords::default(),
            attempts: 0,
            began: Instant::now(),
            stalled: None,
        };
        let [frame, start] = plan.deadlines_s.map(|seconds| Duration::from_secs(seconds.into()));
        Ok(Self {
            plan,
            board: resources.board(),
            options,
            graph,
            run_dir: options.run_dir.clone(),
            command: command(options)?,
            charges: plan.nodes.iter().map(|_| charge()).collect(),
            events,
            phase: Phase::Running,
            next_phase_at: None,
            failure: None,
            killed: Vec::new(),
            had_begun: false,
            incidents: VecDeque::new(),
            warnings: WarningsFile::create(&options.run_dir),
            watchdog: Watchdog::new(Deadlines { frame, start }, plan.nodes.len()),
            begin: Instant::now(),
            table: LiveTable::new(options.print),
            source_bell,
            _topics: topics,
            node,
        })
    }

    /// Runs to the end; `true` when the run was asked to stop.
    pub(super) fn run(&mut self) -> Result<bool, SupervisorError> {
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
        match self.failure.take() {
            Some(failure) => Err(failure),
            // A live run loses frames anyway, and one that had not begun has none.
            None if self.plan.replay() && !self.killed.is_empty() => {
                Err(SupervisorError::Killed(self.killed.join(", ")))
            }
            None => Ok(self.phase != Phase::Running),
        }
    }

    /// What the run's summary must say beside the board.
    pub(super) fn tell(&mut self, summary: &mut Summary) {
        summary.killed = std::mem::take(&mut self.killed);
        summary.incidents = std::mem::take(&mut self.incidents).into();
    }

    fn note(&mut self, node: usize, what: String) {
        let name = self.plan.nodes[node].name.clone();
        self.table.say(&format!("node `{name}` {what}"));
        self.warnings.write(Severity::Warning, &name, &what);
        if self.incidents.len() == Incident::KEPT {
            self.incidents.pop_front();
        }
        self.incidents.push_back(Incident { node: name, at_s: self.begin.elapsed().as_secs_f64(), what });
    }

    fn start(&mut self, node: usize) {
        self.board.beat(node, monotonic_ns(), None);
        self.charges[node].began = Instant::now();
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
        self.warnings.hear(&self.plan.nodes[node].name, text);
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
        if self.is_ending() {
            return;
        }
        let charge = &mut self.charges[node];
        let how = charge.stalled.take().unwrap_or_else(|| child::how(status));
        let (name, words) = (self.plan.nodes[node].name.clone(), charge.words.text());
        let lives = !self.plan.replay();
        if lives && charge.began.elapsed() >= WELL_AFTER {
            charge.attempts = 0;
        }
        // An error of a node that never was ready is one of its configuration.
        let heals = child::died(status) || (lives && self.board.get(node, Word::Generation) > 0);
        if !heals {
            return self.fail(SupervisorError::Failed { node: name, how, words });
        }
        let restarts = charge.attempts;
        if restarts >= self.plan.restarts {
            return self.fail(SupervisorError::GaveUp { node: name, how, restarts: restarts.into(), words });
        }
        charge.attempts += 1;
        charge.start_at = Some(Instant::now() + Duration::from_millis(50) * 2u32.pow(restarts.min(5)));
        self.board.add(node, Word::Restarts, 1);
        self.note(node, format!("died ({how}): starting it again"));
    }

    fn is_ending(&self) -> bool {
        matches!(self.phase, Phase::Terminating | Phase::Killing | Phase::KillingAll)
    }

    /// Kills what lives but does not move; it is buried, and started again, as any other that dies.
    fn kill_stalled(&mut self) {
        if !self.watchdog.is_due() || self.phase != Phase::Running {
            return;
        }
        for node in 0..self.charges.len() {
            let charge = &mut self.charges[node];
            let Some(pid) = charge.pid.filter(|_| charge.stalled.is_none()) else { continue };
            charge.stalled = self.watchdog.complaint(self.board, node, pid);
            if charge.stalled.is_some() {
                signal(pid, Signal::KILL);
            }
        }
    }

    fn look_around(&mut self) {
        if self.options.stop.load(Ordering::Acquire) && self.phase == Phase::Running {
            self.escalate();
        }
        if self.next_phase_at.is_some_and(|at| Instant::now() >= at) {
            self.escalate();
        }
        self.kill_stalled();
        for node in 0..self.charges.len() {
            if self.charges[node].start_at.is_some_and(|at| Instant::now() >= at) {
                self.charges[node].start_at = None;
                self.reclaim();
                self.start(node);
            }
        }
        if self.table.is_due() {
            let below = self.options.below.0.as_ref().map_or_else(String::new, |below| below());
            self.table.show(&format!("{}{below}", Summary::of(self.plan, self.board)));
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
        if !self.is_ending() {
            self.phase = Phase::Stopping;
            self.escalate();
        }
    }

    /// The next step towards the end: in order, then SIGTERM, then SIGKILL. In its start (or a node's new one) a graph
    /// cannot end in order: it goes to SIGTERM at once.
    fn escalate(&mut self) {
        let pause = match self.phase {
            Phase::Running if self.living().all(|node| self.board.state(node) != State::Away) => {
                self.phase = Phase::Stopping;
                self.board.request_stop();
                self.source_bell.ring();
                self.options.stop_timeout
            }
            Phase::Running | Phase::Stopping => {
                self.had_begun = self.phase == Phase::Stopping;
                self.phase = Phase::Terminating;
                self.board.request_stop();
                self.charges.iter_mut().for_each(|charge| charge.start_at = None);
                self.signal_all(Signal::TERM, |_| true);
                if self.failure.is_some() { FAILURE_GRACE } else { LAST_GRACE }
            }
            Phase::Terminating => {
                self.phase = Phase::Killing;
                self.kill_all(|state| state != State::Closing);
                CLOSING_GRACE
            }
            Phase::Killing | Phase::KillingAll => {
                self.phase = Phase::KillingAll;
                self.kill_all(|_| true);
                CLOSING_GRACE
            }
        };
        self.next_phase_at = Some(Instant::now() + pause);
    }

    /// Kills all in such states; who had begun and is no failure's victim is named.
    fn kill_all(&mut self, which: impl Fn(State) -> bool) {
        let named = self.had_begun && self.failure.is_none();
        let killed: Vec<usize> = self.living().filter(|node| named && which(self.board.state(*node))).collect();
        self.killed.extend(killed.into_iter().map(|node| self.plan.nodes[node].name.clone()));
        self.signal_all(Signal::KILL, which);
    }

    /// Nodes that have a process, or will have one again.
    fn living(&self) -> impl Iterator<Item = usize> + '_ {
        let lives = |node: &usize| self.charges[*node].pid.is_some() || self.charges[*node].start_at.is_some();
        (0..self.charges.len()).filter(lives)
    }

    fn signal_all(&self, sent: Signal, to: impl Fn(State) -> bool) {
        for (node, charge) in self.charges.iter().enumerate().filter(|(node, _)| to(self.board.state(*node))) {
            log::debug!("{sent:?} to {}", self.plan.nodes[node].name);
            charge.pid.into_iter().for_each(|pid| signal(pid, sent));
        }
    }
}

fn signal(pid: u32, signal: Signal) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, signal);
    }
}

impl Drop for Control<'_> {
    fn drop(&mut self) {
        // After a panic of the supervisor itself.
        self.signal_all(Signal::KILL, |_| true);
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
pub(super) fn forward_signals(events: Sender<Event>) -> Option<SignalGuard> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGHUP, SIGINT, SIGTERM])
        .inspect_err(|error| log::warn!("signals cannot be handled: {error}"))
        .ok()?;
    let handle = signals.handle();
    std::thread::spawn(move || signals.forever().all(|_| events.send(Event::Stop).is_ok()));
    Some(SignalGuard(handle))
}

pub(super) struct SignalGuard(signal_hook::iterator::Handle);

impl Drop for SignalGuard {
    fn drop(&mut self) {
        self.0.close();
    }
}
