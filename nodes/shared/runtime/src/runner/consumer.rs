use super::links::TICK;
use super::outputs::{IpcOutputs, NoOutputs};
use super::{Ending, Launch, RunError, Runner};
use crate::board::{State, Word};
use crate::clock::monotonic_ns;
use crate::{Context, Inputs, Node, NodeError};
use pseudoflow_msgs::FrameKey;

/// What a node did with a frame.
enum Handled {
    /// It needs a message of a `latest` port first.
    Waits,
    /// Done, with the number of objects where the node counts them.
    Done(Option<usize>),
}

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
            self.pass_voids()?;
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

    /// The newest whole frame that asks for work: one without objects must not push another aside that has some.
    fn pick_newest(&mut self) -> Option<u64> {
        let whole = self.intake.join.complete_newest_first();
        let index = whole.iter().copied().find(|index| self.has_work(*index)).or(whole.first().copied())?;
        let passed = self.intake.join.drop_below(index);
        self.launch.board.add(self.launch.me, Word::Drops, passed);
        Some(index)
    }

    fn has_work(&mut self, index: u64) -> bool {
        let Some(frame) = self.intake.take(index) else { return false };
        let empty = N::objects(&frame) == Some(0);
        let messages = frame.into_messages();
        self.intake.put_back(index, messages);
        !empty
    }

    fn handle(&mut self, index: u64, next: &mut u64) -> Result<bool, RunError> {
        let launch = self.launch;
        let Some(frame) = self.intake.take(index) else { return Ok(true) };
        let (key, origin_ns, begin_ns) = (frame.envelope.key(), frame.envelope.origin_ns, monotonic_ns());
        launch.beat(Some(index));
        let ends_here = launch.me == launch.plan.source;
        let handled = match ends_here {
            true => work(&mut self.node, &frame, None, &self.context),
            false => {
                self.outputs.begin(Some(key), origin_ns);
                work(&mut self.node, &frame, Some(&mut self.outputs), &self.context)
            }
        };
        launch.beat(None);
        match handled {
            Ok(Handled::Waits) => {
                let messages = frame.into_messages();
                self.intake.put_back(index, messages);
                return Ok(false);
            }
            Ok(Handled::Done(objects)) => {
                drop(frame);
                if index < *next {
                    launch.board.add(launch.me, Word::Repeats, 1);
                } else if !ends_here {
                    // A source counts what it makes.
                    launch.count_frame(objects, begin_ns, origin_ns);
                }
            }
            Err(error) => {
                drop(frame);
                self.refuse(key, &error)?;
            }
        }
        self.intake.forget_queued();
        self.pass_on(index);
        *next = (*next).max(index + 1);
        Ok(true)
    }

    /// A frame that could not be used: in a live graph it is dropped, counted, and given up for all that follow.
    fn refuse(&mut self, key: FrameKey, error: &NodeError) -> Result<(), RunError> {
        let launch = self.launch;
        self.complaints.hear(launch, &format!("frame {}", key.index), error)?;
        match launch.me == launch.plan.source {
            true => Ok(()),
            false => self.outputs.void().map_err(|e| launch.ipc_error(e)),
        }
    }

    /// Gives frames on as given up that another node has given up.
    fn pass_voids(&mut self) -> Result<(), RunError> {
        let launch = self.launch;
        while let Some(envelope) = self.intake.take_void() {
            if launch.me != launch.plan.source {
                self.outputs.begin(Some(envelope.key()), envelope.origin_ns);
                self.outputs.void().map_err(|e| launch.ipc_error(e))?;
            }
            self.pass_on(envelope.index);
        }
        Ok(())
    }

    /// This node is done with a frame: wakes those who wait for it.
    fn pass_on(&mut self, index: u64) {
        let Launch { plan, board, me, .. } = self.launch;
        self.links.ring_consumers();
        if plan.nodes[*me].acknowledges {
            let safe = self.node.safe_until(index + 1);
            board.set(*me, Word::Acknowledged, safe.max(board.get(*me, Word::Acknowledged)));
            self.links.ring_source();
        }
    }
}

/// Lets the node handle a frame. What a source takes in ends there (`outputs` is `None`): its outputs belong to the
/// frame that it is making.
fn work<N: Node>(
    node: &mut N,
    frame: &dyn Inputs,
    outputs: Option<&mut IpcOutputs>,
    context: &Context,
) -> Result<Handled, NodeError> {
    if !node.ready(frame)? {
        return Ok(Handled::Waits);
    }
    match outputs {
        None => node.process(frame, &mut NoOutputs, context)?,
        Some(outputs) => {
            node.process(frame, outputs, context)?;
            outputs.end_transform()?;
        }
    }
    Ok(Handled::Done(N::objects(frame)))
}
