use super::links::TICK;
use super::{Ending, Launch, RunError, Runner};
use crate::board::{State, Word};
use crate::clock::monotonic_ns;
use crate::{Node, Produced};
use pseudoflow_msgs::FrameKey;
use std::time::Duration;

/// How often a source that had nothing is asked again.
const POLL: Duration = Duration::from_millis(1);
/// A gap between stamps that is no pause of a recording but another clock.
const LONGEST_GAP_NS: i64 = 10_000_000_000;

/// What a live source knows of its frames.
#[derive(Default)]
struct Traffic {
    /// Frames in the graph that are not acknowledged.
    in_flight: Vec<u64>,
    generations: Vec<u64>,
    ended: bool,
    /// A recording played as if live: the next frame.
    next: u64,
    last: Option<FrameKey>,
    /// When the frame that waits came (a camera's), or was due (a recording's): its age counts from here.
    due_ns: u64,
    gap_ns: u64,
}

impl<N: Node> Runner<'_, N> {
    /// The loop of a source in live mode. A recording (`paced`) plays at the pace of its stamps, from when every node is
    /// there: its frames do not pass while somebody still starts.
    pub(super) fn pass_live_frames(&mut self, paced: bool) -> Result<Ending, RunError> {
        self.outputs.hold = true;
        let mut traffic = Traffic { next: self.launch.acknowledged_by_all(), ..Traffic::default() };
        let mut next = 0;
        loop {
            if self.launch.board.stop_requested() || (traffic.ended && self.outputs.frame().is_none()) {
                return Ok(Ending::InOrder);
            }
            self.watch(&mut traffic);
            self.pass_bad_on()?;
            if !self.launch.plan.nodes[self.launch.me].inputs.is_empty() {
                self.take_frames(&mut next)?;
            }
            let early = self.outputs.frame().is_some() && monotonic_ns() < traffic.due_ns + traffic.gap_ns;
            let waits = paced && (early || !self.launch.board.all_came());
            let busy = !traffic.ended && !waits && self.ask(&mut traffic, paced)?;
            let sent = self.admit(&mut traffic)?;
            let pause = if busy || sent {
                Duration::ZERO
            } else if traffic.ended {
                TICK
            } else {
                POLL
            };
            if !pause.is_zero() && self.sleep(pause)? {
                return Ok(Ending::Terminated);
            }
        }
    }

    /// Strikes off what is acknowledged, and everything when a node has come back: it has lost what it had.
    fn watch(&self, traffic: &mut Traffic) {
        let Launch { plan, board, .. } = self.launch;
        let generations = board.generations();
        if generations != traffic.generations {
            traffic.in_flight.clear();
            traffic.generations = generations;
        }
        let there = plan.acknowledgers().filter(|node| board.state(*node) == State::Ready);
        let done = there.map(|node| board.get(node, Word::Acknowledged)).min().unwrap_or(0);
        traffic.in_flight.retain(|index| *index >= done);
    }

    /// Asks the node for what is new; `true` when it had something.
    fn ask(&mut self, traffic: &mut Traffic, paced: bool) -> Result<bool, RunError> {
        let launch = self.launch;
        launch.beat(None);
        let produced = match paced {
            true => self.node.produce(traffic.next, &mut self.outputs, &self.context),
            false => self.node.poll(&mut self.outputs, &self.context),
        };
        if let Some(refused) = self.node.take_refused() {
            launch.board.count_bad(launch.me, None, refused.messages, &refused.last);
        }
        let produced = match produced {
            Ok(produced) => produced,
            Err(error) => {
                let place = if paced { format!("frame {}", traffic.next) } else { "a message".to_owned() };
                self.complaints.hear(launch, &place, &error)?;
                self.outputs.abandon();
                traffic.next += 1;
                return Ok(false);
            }
        };
        launch.board.add(launch.me, Word::Drops, std::mem::take(&mut self.outputs.replaced));
        match produced {
            Produced::Nothing => return Ok(false),
            Produced::End => traffic.ended = true,
            Produced::Frame(key) => {
                self.outputs.end().map_err(|e| launch.error(format!("frame {}", key.index), e.to_string()))?;
                traffic.next += 1;
                traffic.schedule(key, paced);
            }
        }
        Ok(true)
    }

    /// Sends the frame that waits, when it is due and the graph has room for it.
    fn admit(&mut self, traffic: &mut Traffic) -> Result<bool, RunError> {
        let Launch { plan, board, me, .. } = self.launch;
        let now_ns = monotonic_ns();
        let Some(key) = self.outputs.frame().filter(|_| now_ns >= traffic.due_ns && board.all_came()) else {
            return Ok(false);
        };
        if traffic.in_flight.len() as u64 >= plan.window {
            return Ok(false);
        }
        self.outputs.release(traffic.due_ns).map_err(|e| self.launch.ipc_error(e))?;
        self.links.ring_consumers();
        traffic.in_flight.push(key.index);
        board.count_frame(*me, now_ns, monotonic_ns(), traffic.due_ns);
        Ok(true)
    }
}

impl Traffic {
    fn schedule(&mut self, key: FrameKey, paced: bool) {
        let gap = self.last.filter(|_| paced).map(|last| key.stamp_ns - last.stamp_ns);
        self.last = Some(key);
        self.due_ns = match gap {
            Some(gap @ 0..LONGEST_GAP_NS) => {
                self.gap_ns = gap as u64;
                self.due_ns + self.gap_ns
            }
            _ => monotonic_ns(),
        };
    }
}
