//! Messages between the nodes of one process, joined by frame as [`crate::runner`] joins them.

use crate::plan::{Plan, PlannedNode};
use crate::runner::OutputError;
use crate::{Inputs, NodeError, Outputs};
use pseudoflow_msgs::{AlignedBytes, FrameKey};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Instant;

/// A message that has several readers.
#[derive(Clone)]
pub(super) struct Sent {
    key: FrameKey,
    bytes: Rc<AlignedBytes>,
}

/// What waits before each node.
pub(super) struct Delivery {
    nodes: Vec<Waiting>,
    /// When the source had made each frame that may still be on its way.
    made: BTreeMap<u64, Instant>,
}

#[derive(Default)]
struct Waiting {
    /// By frame: a place for each input, open where nothing has come or the input is not joined.
    frames: BTreeMap<u64, Vec<Option<Sent>>>,
    /// Of each input that is not joined: the newest message, or all that no frame has had yet.
    latest: Vec<Vec<Sent>>,
}

impl Delivery {
    pub(super) fn new(plan: &Plan) -> Self {
        let waiting =
            |node: &PlannedNode| Waiting { latest: vec![Vec::new(); node.inputs.len()], ..Waiting::default() };
        Self { nodes: plan.nodes.iter().map(waiting).collect(), made: BTreeMap::new() }
    }

    /// The source has made a frame; those below `needed_from` are done with.
    pub(super) fn made(&mut self, index: u64, needed_from: u64) {
        self.made = self.made.split_off(&needed_from);
        self.made.insert(index, Instant::now());
    }

    /// Gives a node's messages to whoever takes them.
    pub(super) fn pass_on(&mut self, plan: &Plan, producer: usize, messages: Vec<(&'static str, Sent)>) {
        for (port, sent) in messages {
            for (node, waiting) in plan.nodes.iter().zip(&mut self.nodes) {
                let takes = |input: &&crate::plan::PlannedInput| input.producer == producer && input.output == port;
                for (place, input) in node.inputs.iter().enumerate().filter(|(_, input)| takes(input)) {
                    if input.latest {
                        if !input.queued {
                            waiting.latest[place].clear();
                        }
                        waiting.latest[place].push(sent.clone());
                    } else {
                        let frame = waiting.frames.entry(sent.key.index);
                        frame.or_insert_with(|| vec![None; node.inputs.len()])[place] = Some(sent.clone());
                    }
                }
            }
        }
    }

    /// The oldest frame before a node, where all joined messages of it have come.
    pub(super) fn next_frame(&self, plan: &Plan, me: usize) -> Option<Frame> {
        let waiting = &self.nodes[me];
        let (_, messages) = waiting.frames.first_key_value()?;
        let mut key = None;
        let mut ports = Vec::with_capacity(messages.len());
        for (place, input) in plan.nodes[me].inputs.iter().enumerate() {
            let sent = if input.latest { waiting.latest[place].clone() } else { vec![messages[place].clone()?] };
            key = key.or(sent.first().filter(|_| !input.latest).map(|sent| sent.key));
            ports.push(Port { name: input.port, queued: input.queued, sent });
        }
        let key = key?;
        Some(Frame { key, made: self.made.get(&key.index).copied(), ports })
    }

    /// A node has handled a frame, and had what was queued.
    pub(super) fn done(&mut self, plan: &Plan, me: usize, index: u64) {
        self.nodes[me].frames.remove(&index);
        let queued = plan.nodes[me].inputs.iter().zip(&mut self.nodes[me].latest).filter(|(input, _)| input.queued);
        queued.for_each(|(_, messages)| messages.clear());
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.iter().all(|node| node.frames.is_empty())
    }

    /// The oldest frame that waits before a node.
    pub(super) fn oldest(&self, me: usize) -> Option<u64> {
        self.nodes[me].frames.keys().next().copied()
    }
}

/// What a node gets.
pub(super) struct Frame {
    pub(super) key: FrameKey,
    made: Option<Instant>,
    ports: Vec<Port>,
}

struct Port {
    name: &'static str,
    queued: bool,
    sent: Vec<Sent>,
}

impl Inputs for Frame {
    fn key(&self) -> FrameKey {
        self.key
    }

    fn age_ns(&self) -> u64 {
        self.made.map_or(0, |made| u64::try_from(made.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn bytes(&self, port: &str) -> Option<&[u8]> {
        let port = self.ports.iter().find(|p| p.name == port && !p.queued)?;
        port.sent.last().map(|sent| &**sent.bytes)
    }

    fn late(&self, port: &str) -> Vec<(FrameKey, &[u8])> {
        let ports = self.ports.iter().filter(|p| p.name == port && p.queued);
        ports.flat_map(|p| p.sent.iter().map(|sent| (sent.key, &**sent.bytes))).collect()
    }

    fn is_connected(&self, port: &str) -> bool {
        self.ports.iter().any(|p| p.name == port)
    }
}

/// What a node sends for one frame.
pub(super) struct LocalOutputs<'a> {
    node: &'a PlannedNode,
    /// The frame that the messages must belong to; a source says it with its first message.
    frame: Option<FrameKey>,
    pub(super) messages: Vec<(&'static str, Sent)>,
}

impl<'a> LocalOutputs<'a> {
    pub(super) fn new(node: &'a PlannedNode, frame: Option<FrameKey>) -> Self {
        Self { node, frame, messages: Vec::new() }
    }

    /// Every port that somebody joins must have been sent.
    pub(super) fn end(&self) -> Result<(), OutputError> {
        let sent = |port: &str| self.messages.iter().any(|(name, _)| *name == port);
        let missing = self.node.outputs.iter().find(|output| !output.joined_by.is_empty() && !sent(output.port));
        missing.map_or(Ok(()), |output| Err(OutputError::Missing(output.port)))
    }

    /// Checks that a joined message belongs to the frame and comes once.
    fn join(&mut self, port: &'static str, key: FrameKey) -> Result<(), OutputError> {
        if let Some(frame) = self.frame.filter(|frame| frame.index != key.index) {
            return Err(OutputError::WrongFrame { port, sent: key.index, expected: frame.index });
        }
        if self.messages.iter().any(|(name, _)| *name == port) {
            return Err(OutputError::Twice(port));
        }
        self.frame = Some(key);
        Ok(())
    }
}

impl Outputs for LocalOutputs<'_> {
    fn send(
        &mut self,
        port: &str,
        key: FrameKey,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), NodeError> {
        let found = self.node.outputs.iter().find(|output| output.port == port);
        let output = found.ok_or_else(|| OutputError::Unknown(port.to_owned()))?;
        if !output.is_connected() {
            return Ok(());
        }
        if !output.joined_by.is_empty() {
            self.join(output.port, key)?;
        }
        let mut bytes = AlignedBytes::zeroed(len);
        fill(&mut bytes);
        self.messages.push((output.port, Sent { key, bytes: Rc::new(bytes) }));
        Ok(())
    }

    fn is_connected(&self, port: &str) -> bool {
        self.node.outputs.iter().any(|output| output.port == port && output.is_connected())
    }
}
