//! iceoryx2, and nothing else of the crate sees it: services of a run, messages as slices in shared memory, and
//! the events that wake consumers.

mod run_ipc;
mod topic;
mod wake;

pub(crate) use run_ipc::RunIpc;
pub(crate) use topic::{Envelope, Loaned, MessageIn, MessageOut, Received, Topic};
pub(crate) use wake::{Bell, Sleeper};

/// What the shared memory layer could not do.
#[derive(Debug, thiserror::Error)]
#[error("shared memory: {what} failed: {cause}: check the space and rights of /dev/shm and {}", std::env::temp_dir().display())]
pub struct IpcError {
    what: String,
    cause: String,
}

impl IpcError {
    fn new(what: impl Into<String>, cause: impl std::fmt::Debug) -> Self {
        Self { what: what.into(), cause: format!("{cause:?}") }
    }
}
