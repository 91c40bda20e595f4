use crate::{BadFrames, Context, OrBadInput, Refused};
use pseudoflow_msgs::{AlignedBytes, FrameKey, Message};
use schemars::JsonSchema;
use serde::de::DeserializeOwned;

/// What goes wrong inside a node: the node's own error, whatever its type. The runtime adds node, frame and graph.
pub type NodeError = Box<dyn std::error::Error + Send + Sync>;

/// What a node is for the runtime's delivery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Makes frames on demand, any of them again at any time: [`Node::produce`]. The runtime holds its window.
    ReplaySource,
    /// Makes frames when the world does: [`Node::poll`].
    LiveSource,
    /// Messages in, messages out, one of each port per frame.
    Transform,
    /// The end of the line: when its `process` returns, the frame is safe and is acknowledged to the source.
    Sink,
}

/// One named port of a node kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PortSpec {
    /// The name that graphs use.
    pub name: &'static str,
    /// [`Message::TYPE_NAME`] of what it carries.
    pub message: &'static str,
    /// Whether a graph must connect it (inputs only).
    pub required: bool,
    /// Inputs only: not joined by frame; the newest message that has come is there with every frame, none before
    /// the first. Such a port may close a cycle that the graph declares as `feedback`.
    pub latest: bool,
    /// `latest` inputs only: none is given up for a newer one. All that have come since the last frame are there:
    /// [`Inputs::late`].
    pub queued: bool,
}

impl PortSpec {
    /// A port that carries `M` and must be connected.
    #[must_use]
    pub const fn required<M: Message>(name: &'static str) -> Self {
        Self { name, message: M::TYPE_NAME, required: true, latest: false, queued: false }
    }

    /// A port that carries `M` and may stay open.
    #[must_use]
    pub const fn optional<M: Message>(name: &'static str) -> Self {
        Self { name, message: M::TYPE_NAME, required: false, latest: false, queued: false }
    }

    /// An input that carries `M`, may stay open, and is not joined by frame: [`Inputs::bytes`] gives the newest
    /// message that has come. Its producer need not send one per frame.
    #[must_use]
    pub const fn latest<M: Message>(name: &'static str) -> Self {
        Self { name, message: M::TYPE_NAME, required: false, latest: true, queued: false }
    }

    /// An input that carries `M`, may stay open, and is not joined by frame: [`Inputs::late`] gives all messages that have
    /// come since the last frame, each with the frame that it belongs to.
    #[must_use]
    pub const fn late<M: Message>(name: &'static str) -> Self {
        Self { name, message: M::TYPE_NAME, required: false, latest: true, queued: true }
    }
}

/// What a source did when it was asked for a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Produced {
    /// The frame was sent on every output.
    Frame(FrameKey),
    /// There is nothing yet; ask again.
    Nothing,
    /// There is no such frame: the recording ends before it.
    End,
}

/// A node: a deterministic function of its inputs, its configuration and its state.
///
/// It reads no clock and no global random source: both come from the [`Context`]. It never sees the middleware.
pub trait Node: Sized {
    /// The name that graphs use: `flow`, `pnp`, ...
    const KIND: &'static str;
    /// How the runtime treats it.
    const ROLE: Role;
    /// Whether [`Node::finish`] keeps what would be lost otherwise: a run that is asked to stop waits for it longer than for
    /// anything else.
    const KEEPS: bool = false;
    /// Its block in the graph's YAML; unknown keys must be refused (`deny_unknown_fields`).
    type Config: DeserializeOwned + JsonSchema;

    /// Ports that messages come in by.
    fn inputs() -> Vec<PortSpec>;
    /// Ports that messages go out by.
    fn outputs() -> Vec<PortSpec>;

    /// Checks what types cannot say about a configuration (ranges, files that must exist). `pseudoflow check`
    /// calls it before anything starts.
    ///
    /// # Errors
    /// One that names field, value and remedy.
    fn check(config: &Self::Config) -> Result<(), NodeError>;

    /// Optional inputs that this configuration cannot do without. `pseudoflow check` finds those that are not connected.
    fn needs(_config: &Self::Config) -> Vec<&'static str> {
        Vec::new()
    }

    /// Makes the node: loads models, opens devices, warms up.
    ///
    /// # Errors
    /// Whatever keeps it from working.
    fn create(config: Self::Config, context: &Context) -> Result<Self, NodeError>;

    /// Called once before the first frame of a process, also after a restart: sends what consumers of `latest` ports must
    /// have before anything else, under the key of frame 0.
    ///
    /// # Errors
    /// What keeps the node from working.
    fn begin(&mut self, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let _ = (outputs, context);
        Ok(())
    }

    /// Whether a frame can be handled with what has come by `latest` ports. A frame that is not ready is asked for again
    /// when the next message comes; frames behind it wait.
    ///
    /// # Errors
    /// When no message that may still come could make it ready.
    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        let _ = inputs;
        Ok(true)
    }

    /// Sinks: frames below the returned one are never needed again, even if the process dies now. `handled` is the frame
    /// after the one that `process` has just returned from. A sink that gathers frames returns less until what it made
    /// of them is on disk; the window must then hold more frames than it gathers.
    fn safe_until(&self, handled: u64) -> u64 {
        handled
    }

    /// Handles one frame: all connected inputs of it are there. Must send each connected output once.
    ///
    /// # Errors
    /// [`BadInput`](crate::BadInput) for a frame that cannot be used where the next one may be: a live graph drops and
    /// counts it. Anything else is what no other frame would heal: a replay ends with it, a live graph starts the node
    /// again and gives up when that does not help. What is merely not found in a frame is no error: say so in the
    /// messages that go out.
    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError>;

    /// How many objects a frame is about, where that decides how long it takes: a run's summary gives the node's work by it.
    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        let _ = inputs;
        None
    }

    /// Replay sources: makes frame `index` (any index, also an earlier one again: after a consumer's death).
    ///
    /// # Errors
    /// What keeps the recording from being read on.
    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        let _ = (index, outputs, context);
        Ok(Produced::End)
    }

    /// Live sources: sends what has come from outside since the last call, without waiting.
    ///
    /// # Errors
    /// What keeps the outside from being read on.
    fn poll(&mut self, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        let _ = (outputs, context);
        Ok(Produced::Nothing)
    }

    /// Live sources: what was refused from outside since this was last asked, for the run's table and summary. Asked for after
    /// each [`Node::poll`].
    fn take_refused(&mut self) -> Option<Refused> {
        None
    }

    /// Live graphs: what all nodes of the run have dropped so far, by input, whenever that has changed (once a second at most):
    /// for a node that tells the world outside.
    ///
    /// # Errors
    /// What keeps the node from working.
    fn hear_of_bad(&mut self, bad: &[BadFrames], context: &Context) -> Result<(), NodeError> {
        let _ = (bad, context);
        Ok(())
    }

    /// Called once when the run ends in order: flush and close files here.
    ///
    /// # Errors
    /// What could not be kept.
    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        let _ = context;
        Ok(())
    }
}

/// The messages of one frame.
pub trait Inputs {
    /// The frame.
    fn key(&self) -> FrameKey;
    /// Nanoseconds of real time since the frame came to its source, or was due (a recording played live). For what is
    /// measured or abandoned in live mode; nothing that replay must repeat may depend on it.
    fn age_ns(&self) -> u64 {
        0
    }
    /// The message that came by a port; `None` when the graph leaves the port open.
    fn bytes(&self, port: &str) -> Option<&[u8]>;
    /// Of a [`PortSpec::late`] input: what has come since the last frame, in order of coming, each with the frame that it
    /// belongs to. After a death a message may come twice.
    fn late(&self, port: &str) -> Vec<(FrameKey, &[u8])> {
        self.bytes(port).map(|bytes| (self.key(), bytes)).into_iter().collect()
    }
    /// Whether the graph gives a port a producer.
    fn is_connected(&self, port: &str) -> bool {
        self.bytes(port).is_some()
    }
}

/// Where a node's messages go.
pub trait Outputs {
    /// Sends a message of `len` bytes; `fill` writes it in place (zeroed or not: write all of it). A port that
    /// the graph leaves open costs nothing: `fill` is not called. In replay every connected output is sent for every frame; live, one
    /// that is left out is given up for that frame, so that frames without work do not push work aside.
    ///
    /// # Errors
    /// When no memory could be had or the port does not exist.
    fn send(&mut self, port: &str, key: FrameKey, len: usize, fill: &mut dyn FnMut(&mut [u8]))
    -> Result<(), NodeError>;
    /// Whether somebody is connected: large extras need not be computed for nobody.
    fn is_connected(&self, port: &str) -> bool;
}

/// Reads a required input in place.
///
/// # Errors
/// When the port is open; [`BadInput`](crate::BadInput) when the message is malformed.
pub fn read<'a, M: Message>(inputs: &'a dyn Inputs, port: &'static str) -> Result<M::View<'a>, NodeError> {
    let bytes = inputs.bytes(port).ok_or(MissingInput(port))?;
    M::view(bytes).or_bad_input(port)
}

/// An input that a node cannot do without.
#[derive(Debug, thiserror::Error)]
#[error("input `{0}` is not connected: give it a producer in the graph")]
pub struct MissingInput(pub &'static str);

/// Inputs and outputs in memory: to run nodes in tests and inside one process.
#[derive(Debug, Default)]
pub struct InMemory {
    /// The frame.
    pub key: Option<FrameKey>,
    /// Messages by port name.
    pub messages: Vec<(String, AlignedBytes)>,
}

impl InMemory {
    /// An empty frame.
    #[must_use]
    pub fn new(key: FrameKey) -> Self {
        Self { key: Some(key), messages: Vec::new() }
    }
}

impl Inputs for InMemory {
    fn key(&self) -> FrameKey {
        self.key.unwrap_or(FrameKey { index: 0, stamp_ns: 0 })
    }

    fn bytes(&self, port: &str) -> Option<&[u8]> {
        self.messages.iter().find(|(name, _)| name == port).map(|(_, bytes)| &**bytes)
    }
}

impl Outputs for InMemory {
    fn send(
        &mut self,
        port: &str,
        key: FrameKey,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), NodeError> {
        let mut bytes = AlignedBytes::zeroed(len);
        fill(&mut bytes);
        self.key = Some(key);
        self.messages.retain(|(name, _)| name != port);
        self.messages.push((port.to_owned(), bytes));
        Ok(())
    }

    fn is_connected(&self, _port: &str) -> bool {
        true
    }
}
