use super::IpcError;
use iceoryx2::port::{listener::Listener, notifier::Notifier};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event::PortFactory;
use std::io::Read;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

fn service(node: &Node<ipc::Service>, name: &str, processes: usize) -> Result<PortFactory<ipc::Service>, IpcError> {
    let what = format!("opening the bell of `{name}`");
    let service = ServiceName::new(&format!("wake/{name}")).map_err(|e| IpcError::new(&*what, e))?;
    node.service_builder(&service)
        .event()
        .max_notifiers(2 * processes + 2)
        .max_listeners(2)
        .max_nodes(2 * processes + 2)
        .event_id_max_value(0)
        .open_or_create()
        .map_err(|e| IpcError::new(what, e))
}

/// Wakes one node.
#[derive(Debug)]
pub(crate) struct Bell {
    notifier: Notifier<ipc::Service>,
    /// Keeps the service alive between the lives of its node.
    _service: PortFactory<ipc::Service>,
}

impl Bell {
    /// The bell of the node `name` in a run of so many processes.
    pub(crate) fn of(node: &Node<ipc::Service>, name: &str, processes: usize) -> Result<Self, IpcError> {
        let service = service(node, name, processes)?;
        let notifier = service
            .notifier_builder()
            .default_event_id(EventId::new(0))
            .create()
            .map_err(|e| IpcError::new(format!("creating the bell of `{name}`"), e))?;
        Ok(Self { notifier, _service: service })
    }

    pub(crate) fn ring(&self) {
        // Nobody there, or one that died: it looks around by itself when it comes.
        if let Err(error) = self.notifier.notify() {
            log::debug!("could not wake a node: {error:?}");
        }
    }
}

/// What a node sleeps on: its bell and the signals that ask it to end.
#[derive(Debug)]
pub(crate) struct Sleeper {
    waitset: WaitSet<ipc::Service>,
    listener: Listener<ipc::Service>,
    signals: SignalPipe,
    _service: PortFactory<ipc::Service>,
}

impl Sleeper {
    pub(crate) fn new(node: &Node<ipc::Service>, name: &str, processes: usize) -> Result<Self, IpcError> {
        let service = service(node, name, processes)?;
        let create = |e: &dyn std::fmt::Debug| IpcError::new(format!("creating the listener of `{name}`"), e);
        let listener = service.listener_builder().create().map_err(|e| create(&e))?;
        let waitset = WaitSetBuilder::new()
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| create(&e))?;
        let signals = SignalPipe::new().map_err(|e| create(&e))?;
        Ok(Self { waitset, listener, signals, _service: service })
    }

    /// Sleeps until the bell rings, a signal comes or the time is over; `true` when a signal has come.
    pub(crate) fn sleep(&mut self, at_most: Duration) -> Result<bool, IpcError> {
        {
            let attach = |e| IpcError::new("waiting", e);
            let _bell = self.waitset.attach_notification(&self.listener).map_err(attach)?;
            let _signals = self.waitset.attach_notification(&self.signals).map_err(attach)?;
            self.waitset
                .wait_and_process_once_with_timeout(|_| CallbackProgression::Continue, at_most)
                .map_err(|e| IpcError::new("waiting", e))?;
        }
        self.listener.try_wait(|_| {}).map_err(|e| IpcError::new("reading the bell", e))?;
        Ok(self.signals.came())
    }
}

/// A pipe that SIGTERM and SIGINT write to, so that a sleeper wakes for them.
#[derive(Debug)]
struct SignalPipe {
    stream: UnixStream,
    descriptor: FileDescriptor,
    came: bool,
}

impl SignalPipe {
    fn new() -> std::io::Result<Self> {
        let (stream, write) = UnixStream::pair()?;
        stream.set_nonblocking(true)?;
        signal_hook::low_level::pipe::register(signal_hook::consts::SIGTERM, write.try_clone()?)?;
        signal_hook::low_level::pipe::register(signal_hook::consts::SIGINT, write)?;
        let descriptor = FileDescriptor::non_owning_new(stream.as_raw_fd())
            .ok_or_else(|| std::io::Error::from(std::io::ErrorKind::InvalidInput))?;
        Ok(Self { stream, descriptor, came: false })
    }

    fn came(&mut self) -> bool {
        let mut bytes = [0; 16];
        self.came |= matches!(self.stream.read(&mut bytes), Ok(count) if count > 0);
        self.came
    }
}

impl FileDescriptorBased for SignalPipe {
    fn file_descriptor(&self) -> &FileDescriptor {
        &self.descriptor
    }
}

impl SynchronousMultiplexing for SignalPipe {}
