use super::intake::topic;
use crate::clock::monotonic_ns;
use crate::ipc::{Envelope, IpcError, Loaned, MessageOut};
use crate::plan::Plan;
use crate::{NodeError, Outputs};
use iceoryx2::prelude::{Node, ipc};
use pseudoflow_msgs::FrameKey;

/// What a node did with its outputs that nobody could join.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OutputError {
    #[error("there is no output `{0}`: the node's `outputs()` names all of them")]
    Unknown(String),
    #[error("output `{0}` was sent twice for one frame: send each output once")]
    Twice(&'static str),
    #[error("output `{0}` was not sent: in replay send every connected output for every frame, empty if need be")]
    Missing(&'static str),
    #[error("output `{0}` was sent while taking results in: a source sends in `produce` or `poll`")]
    Source(String),
    #[error("output `{port}` was sent for frame {sent} instead of {expected}: pass the frame's own key on")]
    WrongFrame { port: &'static str, sent: u64, expected: u64 },
}

/// All outputs of a node, one message of each per frame.
pub(super) struct IpcOutputs {
    ports: Vec<OutPort>,
    /// Live: outputs may be left out.
    may_skip: bool,
    /// Somebody must hear of frames that are given up ([`Plan::must_tell_voids`]).
    tells_voids: bool,
    /// Live sources: keep messages back until [`IpcOutputs::release`].
    pub(super) hold: bool,
    frame: Option<FrameKey>,
    origin_ns: u64,
    /// Whole frames that a newer one has pushed out of the hold.
    pub(super) replaced: u64,
}

struct OutPort {
    name: &'static str,
    publisher: Option<MessageOut>,
    joined: bool,
    keeps_last: bool,
    sent: bool,
    held: Option<Loaned>,
}

impl IpcOutputs {
    pub(super) fn new(node: &Node<ipc::Service>, plan: &Plan, me: usize) -> Result<Self, IpcError> {
        let mut ports = Vec::new();
        for output in &plan.nodes[me].outputs {
            let connected = output.is_connected();
            let publisher = connected.then(|| topic(node, plan, me, output.port)?.publisher()).transpose()?;
            let (joined, keeps_last) = (!output.joined_by.is_empty(), !output.latest_of.is_empty());
            ports.push(OutPort { name: output.port, publisher, joined, keeps_last, sent: false, held: None });
        }
        let (may_skip, tells_voids) = (!plan.replay(), plan.must_tell_voids(me));
        Ok(Self { ports, may_skip, tells_voids, hold: false, frame: None, origin_ns: 0, replaced: 0 })
    }

    /// Begins a frame; a source does not know its key yet.
    pub(super) fn begin(&mut self, frame: Option<FrameKey>, origin_ns: u64) {
        self.frame = frame;
        self.origin_ns = origin_ns;
        self.ports.iter_mut().for_each(|port| port.sent = false);
    }

    /// Ends a frame: every port that somebody joins must have been sent.
    pub(super) fn end(&self) -> Result<(), OutputError> {
        let missing = self.ports.iter().find(|port| port.joined && !port.sent);
        missing.map_or(Ok(()), |port| Err(OutputError::Missing(port.name)))
    }

    /// The same for a node that takes frames in. Live, what it did not send is given up for this frame: it asks for no work there, and
    /// must not push work aside.
    pub(super) fn end_transform(&mut self) -> Result<(), NodeError> {
        if self.may_skip {
            return Ok(self.void()?);
        }
        Ok(self.end()?)
    }

    /// Key of the frame that is held back or being sent.
    pub(super) fn frame(&self) -> Option<FrameKey> {
        self.frame
    }

    /// Sends what was held back: a frame that came, or was due, at `origin_ns`.
    pub(super) fn release(&mut self, origin_ns: u64) -> Result<(), IpcError> {
        let Some(key) = self.frame.take() else { return Ok(()) };
        let envelope = envelope(key, origin_ns);
        for port in &mut self.ports {
            if let Some(loaned) = port.held.take() {
                loaned.send(Envelope { sent_ns: monotonic_ns(), ..envelope })?;
            }
            port.sent = false;
        }
        Ok(())
    }

    /// Tells those who join a port that the frame of [`Self::begin`] is given up, where it was not sent yet; but where nothing was sent of
    /// it and nobody else knows of it.
    pub(super) fn void(&mut self) -> Result<(), IpcError> {
        let begun = self.ports.iter().any(|port| port.joined && port.sent);
        let Some(key) = self.frame.filter(|_| begun || self.tells_voids) else { return Ok(()) };
        let envelope = Envelope { void: 1, ..envelope(key, self.origin_ns) };
        for port in self.ports.iter_mut().filter(|port| port.joined && !port.sent) {
            if let Some(publisher) = &port.publisher {
                publisher.loan(size_of::<u64>(), &mut |bytes| bytes.fill(0))?.send(envelope)?;
                port.sent = true;
            }
        }
        Ok(())
    }

    /// Gives up what a source has made of a frame so far.
    pub(super) fn abandon(&mut self) {
        self.frame = None;
        for port in &mut self.ports {
            (port.sent, port.held) = (false, None);
        }
    }

    /// Lets consumers that have come late have the last message where a port keeps it.
    pub(super) fn update(&self) {
        self.ports.iter().filter(|port| port.keeps_last).filter_map(|p| p.publisher.as_ref()).for_each(|p| p.update());
    }

    /// A held frame makes way when a message of another frame comes.
    fn make_way(&mut self, key: FrameKey) {
        if self.hold && self.frame.is_some_and(|frame| frame != key) {
            self.replaced += 1;
            self.abandon();
        }
    }
}

fn envelope(key: FrameKey, origin_ns: u64) -> Envelope {
    Envelope { index: key.index, stamp_ns: key.stamp_ns, sent_ns: monotonic_ns(), origin_ns, void: 0 }
}

impl Outputs for IpcOutputs {
    fn send(
        &mut self,
        port: &str,
        key: FrameKey,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), NodeError> {
        // What nobody joins may belong to an earlier frame: the one that waits stays.
        if self.ports.iter().any(|p| p.name == port && p.joined) {
            self.make_way(key);
        }
        let found = self.ports.iter_mut().find(|p| p.name == port);
        let port = found.ok_or_else(|| OutputError::Unknown(port.to_owned()))?;
        let Some(publisher) = &port.publisher else { return Ok(()) };
        if port.joined {
            if let Some(frame) = self.frame.filter(|frame| frame.index != key.index) {
                let (sent, expected) = (key.index, frame.index);
                return Err(OutputError::WrongFrame { port: port.name, sent, expected }.into());
            }
            if std::mem::replace(&mut port.sent, true) {
                return Err(OutputError::Twice(port.name).into());
            }
            self.frame = Some(key);
        }
        let loaned = publisher.loan(len, fill)?;
        if self.hold && port.joined {
            port.held = Some(loaned);
        } else {
            loaned.send(envelope(key, self.origin_ns))?;
        }
        Ok(())
    }

    fn is_connected(&self, port: &str) -> bool {
        self.ports.iter().any(|p| p.name == port && p.publisher.is_some())
    }
}

/// What a source may send while it takes results in: nothing.
pub(super) struct NoOutputs;

impl Outputs for NoOutputs {
    fn send(&mut self, port: &str, _: FrameKey, _: usize, _: &mut dyn FnMut(&mut [u8])) -> Result<(), NodeError> {
        Err(OutputError::Source(port.to_owned()).into())
    }

    fn is_connected(&self, _: &str) -> bool {
        false
    }
}
