use super::join::Join;
use crate::Inputs;
use crate::ipc::{Envelope, IpcError, MessageIn, Received, Topic};
use crate::plan::{Plan, PlannedInput};
use iceoryx2::prelude::{Node, ipc};
use pseudoflow_msgs::{AlignedBytes, FrameKey};
use std::collections::VecDeque;

/// All inputs of a node.
pub(super) struct Intake {
    joined: Vec<(&'static str, MessageIn)>,
    latest: Vec<Latest>,
    queued: Vec<Queued>,
    pub(super) join: Join<Received>,
    /// Frames that were given up on the way.
    voids: VecDeque<Envelope>,
}

/// An input of which nothing is given up between two frames. Its messages are copied: their memory goes back at once, so that
/// their number is bounded by [`MOST_QUEUED`] alone.
struct Queued {
    port: &'static str,
    input: MessageIn,
    messages: VecDeque<(FrameKey, AlignedBytes)>,
}

/// More messages of one port than this are no queue but a node that handles no frames.
const MOST_QUEUED: usize = 256;

struct Latest {
    port: &'static str,
    input: MessageIn,
    message: Option<Received>,
}

/// The topic of an output, stated the same by everybody.
pub(crate) fn topic(node: &Node<ipc::Service>, plan: &Plan, producer: usize, port: &str) -> Result<Topic, IpcError> {
    let planned = &plan.nodes[producer];
    let output = planned.outputs.iter().find(|output| output.port == port);
    let (joined, latest) = output.map_or((0, 0), |o| (o.joined_by.len(), o.latest_of.len()));
    Topic::open(node, &format!("frames/{}/{port}", planned.name), plan.window, joined + latest, latest > 0)
}

impl Intake {
    pub(super) fn new(node: &Node<ipc::Service>, plan: &Plan, me: usize) -> Result<Self, IpcError> {
        let connect = |input: &PlannedInput| topic(node, plan, input.producer, &input.output)?.subscriber();
        let (mut joined, mut latest, mut queued) = (Vec::new(), Vec::new(), Vec::new());
        for planned in &plan.nodes[me].inputs {
            let (port, input) = (planned.port, connect(planned)?);
            if planned.queued {
                queued.push(Queued { port, input, messages: VecDeque::new() });
            } else if planned.latest {
                latest.push(Latest { port, input, message: None });
            } else {
                joined.push((port, input));
            }
        }
        let join = Join::new(joined.len(), 2 * plan.window as usize);
        Ok(Self { joined, latest, queued, join, voids: VecDeque::new() })
    }

    /// Takes all that has come.
    pub(super) fn drain(&mut self) -> Result<(), IpcError> {
        for (input, (_, port)) in self.joined.iter().enumerate() {
            while let Some(message) = port.receive()? {
                let envelope = *message.envelope();
                if envelope.void == 0 {
                    self.join.insert(envelope.index, input, message);
                } else {
                    // It must not take the place of a frame that waits for something.
                    self.join.give_up(envelope.index);
                    self.voids.push_back(envelope);
                }
            }
        }
        for latest in &mut self.latest {
            while let Some(message) = latest.input.receive()? {
                if message.envelope().void == 0 {
                    latest.message = Some(message);
                }
            }
        }
        for queued in &mut self.queued {
            while let Some(message) = queued.input.receive()? {
                if message.envelope().void != 0 {
                    continue;
                }
                queued.messages.push_back((message.envelope().key(), AlignedBytes::copy_of(message.bytes())));
                if queued.messages.len() > MOST_QUEUED {
                    queued.messages.pop_front();
                    log::warn!("`{}`: {MOST_QUEUED} messages wait for a frame: the oldest is given up", queued.port);
                }
            }
        }
        Ok(())
    }

    /// Gives up what was queued: a frame has had it.
    pub(super) fn forget_queued(&mut self) {
        self.queued.iter_mut().for_each(|queued| queued.messages.clear());
    }

    /// The next frame that was given up on the way.
    pub(super) fn take_void(&mut self) -> Option<Envelope> {
        self.voids.pop_front()
    }

    /// Takes a whole frame out.
    pub(super) fn take(&mut self, index: u64) -> Option<Frame<'_>> {
        let messages = self.join.take(index)?;
        let envelope = *messages.first()?.envelope();
        Some(Frame { envelope, intake: self, messages })
    }

    /// Takes a whole frame back that could not be handled yet.
    pub(super) fn put_back(&mut self, index: u64, messages: Vec<Received>) {
        for (input, message) in messages.into_iter().enumerate() {
            self.join.insert(index, input, message);
        }
    }
}

/// One frame's messages, read in place.
pub(super) struct Frame<'a> {
    pub(super) envelope: Envelope,
    intake: &'a Intake,
    messages: Vec<Received>,
}

impl Frame<'_> {
    pub(super) fn into_messages(self) -> Vec<Received> {
        self.messages
    }
}

impl Inputs for Frame<'_> {
    fn key(&self) -> FrameKey {
        self.envelope.key()
    }

    fn age_ns(&self) -> u64 {
        crate::clock::monotonic_ns().saturating_sub(self.envelope.origin_ns)
    }

    fn bytes(&self, port: &str) -> Option<&[u8]> {
        let joined = self.intake.joined.iter().position(|(name, _)| *name == port);
        let latest = || self.intake.latest.iter().find(|latest| latest.port == port)?.message.as_ref();
        joined.map(|input| &self.messages[input]).or_else(latest).map(Received::bytes)
    }

    fn late(&self, port: &str) -> Vec<(FrameKey, &[u8])> {
        let queued = self.intake.queued.iter().filter(|queued| queued.port == port);
        queued.flat_map(|queued| queued.messages.iter().map(|(key, bytes)| (*key, &**bytes))).collect()
    }

    fn is_connected(&self, port: &str) -> bool {
        let queued = self.intake.queued.iter().any(|queued| queued.port == port);
        queued
            || self.intake.joined.iter().any(|(name, _)| *name == port)
            || self.intake.latest.iter().any(|l| l.port == port)
    }
}
