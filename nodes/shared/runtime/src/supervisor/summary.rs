use super::SupervisorError;
use crate::BadFrames;
use crate::bad::bad_frames_of;
use crate::board::{Board, OBJECTS, Word};
use crate::plan::{Plan, PlannedNode};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;
use std::io::Write;
use std::path::Path;

/// What a run did, by node.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The nodes in the graph's order.
    pub nodes: Vec<NodeSummary>,
    /// From the start to the source's first frame, seconds.
    pub startup_s: Option<f64>,
    /// Whether the run was asked to stop before its end.
    pub asked_to_stop: bool,
    /// Nodes that had to be killed when the run was asked to stop: their last frames may be missing.
    pub killed: Vec<String>,
    /// Deaths, stalls and errors of nodes, the last [`Incident::KEPT`] of them.
    pub incidents: Vec<Incident>,
    /// Why the run failed; `None` when it did not.
    pub failure: Option<String>,
}

/// Something that happened to a node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Incident {
    /// The node.
    pub node: String,
    /// When, seconds since the run began.
    pub at_s: f64,
    /// What, and what was done about it.
    pub what: String,
}

impl Incident {
    /// So many are kept: a live graph may run for weeks.
    pub const KEPT: usize = 200;
}

/// What one node did.
#[derive(Debug, Clone, Serialize)]
pub struct NodeSummary {
    /// Its name.
    pub name: String,
    /// Frames handled, each counted once.
    pub frames: u64,
    /// Frames per second between the first and the last.
    pub rate_hz: Option<f64>,
    /// Share of the run, from the first frame of any node to the last, that it spent in frames, 0..1.
    pub busy: Option<f64>,
    /// Milliseconds of work in a frame: median and 99th percentile, good to 6 %.
    pub work_ms: Option<[f64; 2]>,
    /// Milliseconds from the source to this node's end of the frame: median and 99th percentile.
    pub age_ms: Option<[f64; 2]>,
    /// CPU milliseconds of all threads of the process: before it was ready, and since.
    pub cpu_ms: [f64; 2],
    /// Work by the number of objects in a frame, where the node's work depends on it.
    pub by_objects: Vec<ObjectsWork>,
    /// Frames given up for newer ones (live only).
    pub drops: u64,
    /// Frames handled again after a death.
    pub repeats: u64,
    /// How often it was started again.
    pub restarts: u64,
    /// Frames, and of a source messages from outside, that were dropped because they could not be used (live only).
    pub bad: u64,
    /// The same by where they came from.
    pub bad_from: Vec<BadFrames>,
    /// Why the last of them was dropped.
    pub last_bad: Option<String>,
}

/// Work in frames with so many objects.
#[derive(Debug, Clone, Serialize)]
pub struct ObjectsWork {
    /// How many objects; 23 stands for all above, too.
    pub objects: usize,
    /// Frames with so many.
    pub frames: u64,
    /// Mean milliseconds of work in one of them.
    pub work_ms: f64,
}

impl Summary {
    pub(super) fn of(plan: &Plan, board: &Board) -> Self {
        let nodes = plan.nodes.iter().enumerate();
        let times = |word| (0..plan.nodes.len()).map(move |node| board.get(node, word)).filter(|ns| *ns > 0);
        let first_ns = times(Word::FirstNs).min().unwrap_or(0);
        let span_ns = times(Word::LastNs).max().unwrap_or(0).saturating_sub(first_ns);
        let of = |(i, node): (usize, &PlannedNode)| {
            NodeSummary::of(&node.name, board, i, span_ns, bad_frames_of(plan, board, i))
        };
        let nodes = nodes.map(of).collect();
        let (killed, incidents) = (Vec::new(), Vec::new());
        Self { nodes, startup_s: None, asked_to_stop: false, killed, incidents, failure: None }
    }

    /// Adds how long it took from `begin_ns` to the first frame.
    pub(super) fn since(self, begin_ns: u64, source: usize, board: &Board) -> Self {
        let first_ns = Some(board.get(source, Word::FirstNs)).filter(|ns| *ns > 0);
        Self { startup_s: first_ns.map(|ns| ns.saturating_sub(begin_ns) as f64 * 1e-9), ..self }
    }

    pub(super) fn write(&self, path: &Path) -> Result<(), SupervisorError> {
        let text = serde_json::to_vec_pretty(self).map_err(std::io::Error::from);
        text.and_then(|text| pseudoflow_files::write_private(path, &text))
            .map_err(|source| SupervisorError::File { path: path.to_owned(), source })
    }
}

impl NodeSummary {
    fn of(name: &str, board: &Board, node: usize, span_ns: u64, bad_from: Vec<BadFrames>) -> Self {
        let frames = board.get(node, Word::Frames);
        let seconds = board.get(node, Word::LastNs).saturating_sub(board.get(node, Word::FirstNs)) as f64 * 1e-9;
        let both = |read: &dyn Fn(f64) -> Option<f64>| Some([read(0.5)?, read(0.99)?]);
        Self {
            name: name.to_owned(),
            frames,
            rate_hz: (frames > 1 && seconds > 0.0).then(|| (frames - 1) as f64 / seconds),
            busy: (span_ns > 0).then(|| board.get(node, Word::WorkNs) as f64 / span_ns as f64),
            work_ms: both(&|share| board.work_ms(node, share)),
            age_ms: both(&|share| board.age_ms(node, share)),
            cpu_ms: [Word::StartCpuNs, Word::CpuNs].map(|word| board.get(node, word) as f64 * 1e-6),
            by_objects: by_objects(board, node),
            drops: board.get(node, Word::Drops),
            repeats: board.get(node, Word::Repeats),
            restarts: board.get(node, Word::Restarts),
            bad: board.get(node, Word::Bad),
            bad_from,
            last_bad: board.last_bad(node),
        }
    }
}

fn by_objects(board: &Board, node: usize) -> Vec<ObjectsWork> {
    let of = |objects| board.objects(node, objects).map(|(frames, work_ms)| ObjectsWork { objects, frames, work_ms });
    (0..OBJECTS).filter_map(of).collect()
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.nodes.iter().map(|node| node.name.len()).chain([4]).max().unwrap_or(4);
        writeln!(
            f,
            "{:width$} {:>8} {:>8} {:>6} {:>9} {:>9} {:>9} {:>9} {:>7} {:>6} {:>8}",
            "node", "frames", "rate/s", "busy %", "work p50", "p99 ms", "age p50", "p99 ms", "drops", "bad", "restarts"
        )?;
        for node in &self.nodes {
            let ms = |pair: Option<[f64; 2]>, i: usize| pair.map_or("-".to_owned(), |pair| format!("{:.2}", pair[i]));
            writeln!(
                f,
                "{:width$} {:>8} {:>8} {:>6} {:>9} {:>9} {:>9} {:>9} {:>7} {:>6} {:>8}",
                node.name,
                node.frames,
                node.rate_hz.map_or("-".to_owned(), |rate| format!("{rate:.1}")),
                node.busy.map_or("-".to_owned(), |busy| format!("{:.0}", 100.0 * busy)),
                ms(node.work_ms, 0),
                ms(node.work_ms, 1),
                ms(node.age_ms, 0),
                ms(node.age_ms, 1),
                node.drops,
                node.bad,
                node.restarts
            )?;
        }
        self.write_by_objects(f)?;
        self.write_incidents(f)
    }
}

impl Summary {
    /// What the table cannot say.
    fn write_incidents(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const SHOWN: usize = 20;
        for node in &self.nodes {
            if let Some(cause) = &node.last_bad {
                writeln!(f, "{}: {} bad frames dropped, the last one: {cause}", node.name, node.bad)?;
            }
        }
        let passed = self.incidents.len().saturating_sub(SHOWN);
        for Incident { node, at_s, what } in &self.incidents[passed..] {
            writeln!(f, "{at_s:.1} s: {node}: {what}")?;
        }
        if !self.killed.is_empty() {
            writeln!(f, "killed when the run was asked to stop: {}", self.killed.join(", "))?;
        }
        Ok(())
    }

    /// A column for each number of objects that frames had.
    fn write_by_objects(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let measured: Vec<&NodeSummary> = self.nodes.iter().filter(|node| !node.by_objects.is_empty()).collect();
        let numbers: BTreeSet<usize> = measured.iter().flat_map(|n| n.by_objects.iter().map(|o| o.objects)).collect();
        if numbers.is_empty() {
            return Ok(());
        }
        write!(f, "work, mean ms, by objects")?;
        numbers.iter().try_for_each(|objects| write!(f, " {objects:>8}"))?;
        writeln!(f)?;
        for node in measured {
            write!(f, "{:25}", node.name)?;
            for objects in &numbers {
                let work = node.by_objects.iter().find(|of| of.objects == *objects);
                write!(f, " {:>8}", work.map_or("-".to_owned(), |of| format!("{:.1}", of.work_ms)))?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Prints the table of a run that has ended.
pub(super) fn print(summary: &Summary) {
    // Nobody can be told when standard error is closed.
    let _ = write!(std::io::stderr().lock(), "{summary}");
}
