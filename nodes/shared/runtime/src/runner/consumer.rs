use super::links::TICK;
use super::outputs::NoOutputs;
use super::{Ending, Launch, RunError, Runner};
use crate::Node;
use crate::board::{State, Word};
use crate::clock::monotonic_ns;

impl<N: Node> Runner<'_, N> {
    /// The loop of transforms and sinks.
    pub(super) fn consume(&mut self) -> Result<Ending, RunError> {
        let mut next = 0;
        loop {
            // Looked at before the inputs are emptied: what a finished producer sent is there by then.
            let last_round = self.producers_finished();
            let all_taken = self.take_frames(&mut next)?;
            if last_round && all_taken {
                return Ok(Ending::InOrder);
            }
            if self.sleep(TICK)? {
                return Ok(Ending::Terminated);
            }
        }
    }

    fn producers_finished(&self) -> bool {
        let Launch { plan, board, me, .. } = self.launch;
        let mut joined = plan.nodes[*me].inputs.iter().filter(|input| !input.latest);
        joined.all(|input| board.state(input.producer) == State::Finished)
    }

    /// Handles all frames that can be handled now; `false` when one waits for a message of a `latest` port.
    pub(super) fn take_frames(&mut self, next: &mut u64) -> Result<bool, RunError> {
        loop {
            self.intake.drain().map_err(|e| self.launch.ipc_error(e))?;
            match self.pick(next) {
                Some(index) if !self.handle(index, next)? => return Ok(false),
                Some(_) => {}
                None => return Ok(true),
            }
        }
    }

    fn pick(&mut self, next: &mut u64) -> Option<u64> {
        if self.launch.plan.replay() { self.pick_in_order(next) } else { self.pick_newest() }
    }

    /// The first whole frame that is not ahead of its turn. What everybody has acknowledged is never needed again;
    /// an acknowledging node needs nothing again.
    fn pick_in_order(&mut self, next: &mut u64) -> Option<u64> {
        let Launch { plan, board, me, .. } = self.launch;
        let needed = match plan.nodes[*me].acknowledges {
            true => board.get(*me, Word::Acknowledged),
            false => self.launch.acknowledged_by_all(),
        };
        self.intake.join.drop_below(needed);
        *next = needed.max(*next);
        self.intake.join.first_complete(*next)
    }

    fn pick_newest(&mut self) -> Option<u64> {
        let index = self.intake.join.last_complete()?;
        let passed = self.intake.join.drop_below(index);
        self.launch.board.add(self.launch.me, Word::Drops, passed);
        Some(index)
    }

    fn handle(&mut self, index: u64, next: &mut u64) -> Result<bool, RunError> {
        let Launch { plan, board, me, .. } = self.launch;
        let Some(frame) = self.intake.take(index) else { return Ok(true) };
        let (origin_ns, begin_ns) = (frame.envelope.origin_ns, monotonic_ns());
        let place = || format!("frame {index}");
        let node_error = |error| self.launch.node_error(place(), &error);
        if !self.node.ready(&frame).map_err(node_error)? {
            let messages = frame.into_messages();
            self.intake.put_back(index, messages);
            return Ok(false);
        }
        if *me == plan.source {
            // What a source takes in ends there; its outputs belong to the frame that it is making.
            self.node.process(&frame, &mut NoOutputs, &self.context).map_err(node_error)?;
        } else {
            self.outputs.begin(Some(frame.envelope.key()), origin_ns);
            self.node.process(&frame, &mut self.outputs, &self.context).map_err(node_error)?;
            self.outputs.end().map_err(|error| self.launch.error(place(), error.to_string()))?;
        }
        let objects = N::objects(&frame);
        drop(frame);
        self.intake.forget_queued();
        self.links.ring_consumers();
        if plan.nodes[*me].acknowledges {
            let safe = self.node.safe_until(index + 1);
            board.set(*me, Word::Acknowledged, safe.max(board.get(*me, Word::Acknowledged)));
            self.links.ring_source();
        }
        match index < *next {
            true => board.add(*me, Word::Repeats, 1),
            // A source counts what it makes.
            false if *me != plan.source => {
                let end_ns = monotonic_ns();
                board.count_frame(*me, begin_ns, end_ns, origin_ns);
                if let Some(objects) = objects {
                    board.count_objects(*me, objects, end_ns - begin_ns);
                }
            }
            false => {}
        }
        *next = (*next).max(index + 1);
        Ok(true)
    }
}
