//! Runs a replay graph within this process, node after node, for commands that look at a whole dataset: the same nodes with the
//! same names, joins and windows as [`crate::supervisor::run`] gives them, hence the same bytes, but no process, no shared
//! memory and no restart.

mod delivery;
mod held;

pub(crate) use held::{HeldNode, hold};

use crate::graph::{Graph, GraphError, Mode};
use crate::plan::Plan;
use crate::{Context, NodeError, Produced, Registry, RunError};
use delivery::{Delivery, LocalOutputs};
use std::path::Path;
use std::time::{Duration, Instant};

/// What a run in this process did.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalSummary {
    /// Frames that came from the source.
    pub frames: u64,
    /// The nodes in the order of the graph.
    pub nodes: Vec<LocalNode>,
}

/// What one node did.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalNode {
    /// Its name in the graph.
    pub name: String,
    /// Frames that it handled.
    pub frames: u64,
    /// Time within the node.
    pub work: Duration,
}

/// Runs a graph to its end. `progress` hears how many frames all sinks are done with. Sinks leave their files in `out_dir`.
///
/// # Errors
/// When the graph has problems or is live (only processes can keep up with a camera), a node fails, or nodes wait for
/// messages that nobody will send.
pub fn run(
    graph: &Graph,
    registry: &Registry,
    out_dir: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<LocalSummary, RunError> {
    crate::graph::check(graph, registry).map_err(GraphError::Problems)?;
    let plan = Plan::new(graph, registry)?;
    if plan.mode == Mode::Live {
        return Err(RunError::LiveInProcess);
    }
    let mut run = Run::open(plan, out_dir)?;
    run.begin()?;
    run.turn(progress)?;
    run.close()
}

struct Run {
    plan: Plan,
    nodes: Vec<Seat>,
    delivery: Delivery,
    /// Next frame of the source, and whether there is one.
    next: u64,
    ended: bool,
}

/// A node in its place.
struct Seat {
    node: Box<dyn HeldNode>,
    context: Context,
    summary: LocalNode,
    /// First frame that a sink may still need.
    acknowledged: u64,
}

impl Run {
    fn open(plan: Plan, out_dir: &Path) -> Result<Self, RunError> {
        let seat = |planned: &crate::plan::PlannedNode| {
            let context = Context {
                name: planned.name.clone(),
                seed: plan.seed,
                out_dir: out_dir.to_owned(),
                restarts: 0,
                replay: true,
            };
            let error = |place: String, cause| RunError::Node { node: planned.name.clone(), place, cause };
            let made = (planned.kind.hold)(&planned.config, &context);
            let node = made.map_err(|(place, cause)| error(place, cause))?;
            let summary = LocalNode { name: planned.name.clone(), frames: 0, work: Duration::ZERO };
            Ok(Seat { node, context, summary, acknowledged: 0 })
        };
        let nodes = plan.nodes.iter().map(seat).collect::<Result<_, RunError>>()?;
        let delivery = Delivery::new(&plan);
        Ok(Self { plan, nodes, delivery, next: 0, ended: false })
    }

    fn begin(&mut self) -> Result<(), RunError> {
        for me in 0..self.nodes.len() {
            let seat = &mut self.nodes[me];
            let mut outputs = LocalOutputs::new(&self.plan.nodes[me], None);
            let begun = seat.node.begin(&mut outputs, &seat.context);
            begun.map_err(|error| node_error(&self.plan, me, "start", &error))?;
            self.delivery.pass_on(&self.plan, me, outputs.messages);
        }
        Ok(())
    }

    /// Frame after frame, every node as soon as it can, until the source has ended and nothing waits any more.
    fn turn(&mut self, progress: &mut dyn FnMut(u64)) -> Result<(), RunError> {
        let source = self.plan.source;
        loop {
            let mut moved = self.produce()?;
            for me in (0..self.nodes.len()).filter(|me| *me != source) {
                while self.handle(me)? {
                    moved = true;
                }
            }
            progress(self.acknowledged_by_all());
            if !moved {
                return if self.ended && self.delivery.is_empty() { Ok(()) } else { Err(self.stalled()) };
            }
        }
    }

    /// Lets the source make a frame where the window has room for it.
    fn produce(&mut self) -> Result<bool, RunError> {
        if self.ended || self.next >= self.acknowledged_by_all() + self.plan.window {
            return Ok(false);
        }
        let me = self.plan.source;
        let seat = &mut self.nodes[me];
        let mut outputs = LocalOutputs::new(&self.plan.nodes[me], None);
        let begin = Instant::now();
        let produced = seat.node.produce(self.next, &mut outputs, &seat.context);
        seat.summary.work += begin.elapsed();
        let place = format!("frame {}", self.next);
        match produced.map_err(|error| node_error(&self.plan, me, &place, &error))? {
            Produced::Frame(_) => {
                outputs.end().map_err(|error| node_error(&self.plan, me, &place, &error.into()))?;
                seat.summary.frames += 1;
                let needed_from = self.acknowledged_by_all();
                self.delivery.made(self.next, needed_from);
                self.next += 1;
                self.delivery.pass_on(&self.plan, me, outputs.messages);
            }
            Produced::Nothing => return Ok(false),
            Produced::End => self.ended = true,
        }
        Ok(true)
    }

    /// Lets a node handle its next frame where that is whole and the node is ready for it.
    fn handle(&mut self, me: usize) -> Result<bool, RunError> {
        let Some(frame) = self.delivery.next_frame(&self.plan, me) else { return Ok(false) };
        let place = format!("frame {}", frame.key.index);
        let seat = &mut self.nodes[me];
        let begin = Instant::now();
        if !seat.node.ready(&frame).map_err(|error| node_error(&self.plan, me, &place, &error))? {
            return Ok(false);
        }
        let mut outputs = LocalOutputs::new(&self.plan.nodes[me], Some(frame.key));
        let processed = seat.node.process(&frame, &mut outputs, &seat.context);
        processed
            .and_then(|()| outputs.end().map_err(Into::into))
            .map_err(|error| node_error(&self.plan, me, &place, &error))?;
        seat.summary.work += begin.elapsed();
        seat.summary.frames += 1;
        seat.acknowledged = seat.acknowledged.max(seat.node.safe_until(frame.key.index + 1));
        self.delivery.done(&self.plan, me, frame.key.index);
        self.delivery.pass_on(&self.plan, me, outputs.messages);
        Ok(true)
    }

    /// First frame that not all sinks are done with.
    fn acknowledged_by_all(&self) -> u64 {
        self.plan.acknowledgers().map(|me| self.nodes[me].acknowledged).min().unwrap_or(0)
    }

    fn stalled(&self) -> RunError {
        let name = |me: usize| &self.plan.nodes[me].name;
        let waiting = (0..self.nodes.len()).filter_map(|me| {
            let frame = self.delivery.oldest(me)?;
            Some(format!("`{}` waits at frame {frame}", name(me)))
        });
        let mut causes: Vec<String> = waiting.collect();
        if causes.is_empty() {
            let held = self.acknowledged_by_all();
            let holding = self.plan.acknowledgers().filter(|me| self.nodes[*me].acknowledged == held);
            causes.extend(holding.map(|me| format!("`{}` holds frame {held} back", name(me))));
        }
        RunError::Stalled { causes: causes.join(", "), window: self.plan.window }
    }

    fn close(self) -> Result<LocalSummary, RunError> {
        let frames = self.next;
        let mut nodes = Vec::with_capacity(self.nodes.len());
        for (me, mut seat) in self.nodes.into_iter().enumerate() {
            seat.node.finish(&seat.context).map_err(|error| node_error(&self.plan, me, "end", &error))?;
            nodes.push(seat.summary);
        }
        Ok(LocalSummary { frames, nodes })
    }
}

fn node_error(plan: &Plan, me: usize, place: &str, error: &NodeError) -> RunError {
    let cause = crate::error::chain(&**error);
    RunError::Node { node: plan.nodes[me].name.clone(), place: place.to_owned(), cause }
}
