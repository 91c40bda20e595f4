use super::IpcError;
use iceoryx2::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;

/// Where a run keeps its shared memory: a prefix of its own in /dev/shm and a folder of its own for sockets and
/// services, so that runs never meet and what a run leaves can be told apart.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunIpc {
    /// Begins the name of every segment in /dev/shm.
    pub(crate) prefix: String,
    /// Folder of everything that is not in /dev/shm.
    pub(crate) root: PathBuf,
    /// Process that owns the run and cleans up after it.
    pub(crate) supervisor: u32,
}

impl RunIpc {
    pub(crate) fn node(&self, name: &str) -> Result<Node<ipc::Service>, IpcError> {
        set_log_level_from_env_or(LogLevel::Fatal);
        let name = NodeName::new(name).map_err(|e| IpcError::new("naming a node", e))?;
        NodeBuilder::new()
            .name(&name)
            .config(&self.config()?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| IpcError::new("joining the run", e))
    }

    fn config(&self) -> Result<Config, IpcError> {
        let root = self.root.to_str().unwrap_or_default();
        let mut config = Config::default();
        config.global.prefix =
            FileName::new(self.prefix.as_bytes()).map_err(|e| IpcError::new("naming the run's memory", e))?;
        let path = Path::new(root.as_bytes()).map_err(|e| IpcError::new("naming the run's folder", e))?;
        config.global.set_root_path(&path);
        config.global.creation_timeout = Duration::from_secs(5);
        // The supervisor alone reclaims: it knows who died and when nobody else does the same.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(config)
    }
}
