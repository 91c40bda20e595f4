use super::IpcError;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{publisher::Publisher, subscriber::Subscriber};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Factory;
use pseudoflow_msgs::{FrameKey, layout::ALIGNMENT};

/// What travels beside every message.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, ZeroCopySend)]
pub(crate) struct Envelope {
    pub(crate) index: u64,
    pub(crate) stamp_ns: i64,
    /// When the message was sent, monotonic.
    pub(crate) sent_ns: u64,
    /// When the frame came to its source, or was due, monotonic.
    pub(crate) origin_ns: u64,
    /// Not 0 where there is no message: the frame was given up on the way.
    pub(crate) void: u64,
}

impl Envelope {
    pub(crate) fn key(&self) -> FrameKey {
        FrameKey { index: self.index, stamp_ns: self.stamp_ns }
    }
}

/// One output of one node, as a service. Every process of the run states the same sizes.
#[derive(Debug)]
pub(crate) struct Topic(Factory<ipc::Service, [u8], Envelope>);

/// How many messages a consumer can hold while its join waits: a window's worth, with room for a second copy of
/// each after a death.
fn depth(window: u64) -> usize {
    2 * window as usize + 2
}

impl Topic {
    /// `consumers` counts the subscribers in the graph; `keep_last` lets consumers that come late have the newest
    /// message.
    pub(crate) fn open(
        node: &Node<ipc::Service>,
        name: &str,
        window: u64,
        consumers: usize,
        keep_last: bool,
    ) -> Result<Self, IpcError> {
        let what = format!("opening the channel `{name}`");
        let service = ServiceName::new(name).map_err(|e| IpcError::new(&*what, e))?;
        let alignment = Alignment::new(ALIGNMENT).ok_or_else(|| IpcError::new(&*what, ALIGNMENT))?;
        node.service_builder(&service)
            .publish_subscribe::<[u8]>()
            .user_header::<Envelope>()
            .payload_alignment(alignment)
            // A full buffer gives up its oldest message and never blocks. In replay what is given up is never
            // needed: a later copy of it has come, or its frame is acknowledged (see `runner`).
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(depth(window))
            .subscriber_max_borrowed_samples(depth(window))
            .history_size(usize::from(keep_last))
            // Twice of everything: a successor may come before its dead predecessor is cleaned away.
            .max_publishers(2)
            .max_subscribers(2 * consumers.max(1))
            .max_nodes(2 * consumers + 6)
            .open_or_create()
            .map(Self)
            .map_err(|e| IpcError::new(what, e))
    }

    pub(crate) fn publisher(&self) -> Result<MessageOut, IpcError> {
        self.0
            .publisher_builder()
            .initial_max_slice_len(4096)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .max_loaned_samples(3)
            .create()
            .map(MessageOut)
            .map_err(|e| IpcError::new("creating an output", e))
    }

    pub(crate) fn subscriber(&self) -> Result<MessageIn, IpcError> {
        let created = self.0.subscriber_builder().create();
        created.map(MessageIn).map_err(|e| IpcError::new("creating an input", e))
    }
}

/// The sending end of a topic.
#[derive(Debug)]
pub(crate) struct MessageOut(Publisher<ipc::Service, [u8], Envelope>);

/// A message that is being written, in shared memory already.
#[derive(Debug)]
pub(crate) struct Loaned(SampleMut<ipc::Service, [u8], Envelope>);

impl MessageOut {
    pub(crate) fn loan(&self, len: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<Loaned, IpcError> {
        let mut sample = self
            .0
            .loan_slice_uninit(len)
            .map_err(|e| IpcError::new(format!("getting {len} bytes for a message"), e))?;
        let block = sample.payload_mut();
        // SAFETY: the block lies in a mapped file, whose bytes always hold some value; `u8` allows every value.
        fill(unsafe { std::slice::from_raw_parts_mut(block.as_mut_ptr().cast::<u8>(), block.len()) });
        // SAFETY: as above: all bytes hold values.
        Ok(Loaned(unsafe { sample.assume_init() }))
    }

    /// Connects subscribers that have come, and gives them the last message where the topic keeps it.
    pub(crate) fn update(&self) {
        if let Err(error) = self.0.update_connections() {
            log::warn!("could not connect to a new consumer: {error:?}");
        }
    }
}

impl Loaned {
    pub(crate) fn send(mut self, envelope: Envelope) -> Result<(), IpcError> {
        *self.0.user_header_mut() = envelope;
        self.0.send().map(|_| ()).map_err(|e| IpcError::new("sending a message", e))
    }
}

/// The receiving end of a topic.
#[derive(Debug)]
pub(crate) struct MessageIn(Subscriber<ipc::Service, [u8], Envelope>);

/// A message that is read in place; its memory is given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Received(Sample<ipc::Service, [u8], Envelope>);

impl MessageIn {
    pub(crate) fn receive(&self) -> Result<Option<Received>, IpcError> {
        self.0.receive().map(|sample| sample.map(Received)).map_err(|e| IpcError::new("receiving a message", e))
    }
}

impl Received {
    pub(crate) fn envelope(&self) -> &Envelope {
        self.0.user_header()
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        self.0.payload()
    }
}
