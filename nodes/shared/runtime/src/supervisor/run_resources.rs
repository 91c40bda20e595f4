use super::SupervisorError;
use crate::board::Board;
use crate::ipc::RunIpc;
use crate::runner::{BOARD_FILE, IPC_FILE, STATE_DIR};
use rustix::process::{Pid, test_kill_process};
use std::fs;
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const SHARED_MEMORY: &str = "/dev/shm";
const ROOT_BEGIN: &str = "pseudoflow-";
const OWNER_FILE: &str = "owner";

/// All that a run occupies outside its results: shared memory, a temporary folder, the state folder. It is given
/// back when this is dropped; what a killed supervisor left is given back by the next one.
pub(super) struct RunResources {
    state_dir: PathBuf,
    ipc: RunIpc,
    board: Board,
}

fn prefix(id: &str) -> String {
    format!("iox2_pf{id}_")
}

impl RunResources {
    pub(super) fn claim(run_dir: &Path, nodes: usize) -> Result<Self, SupervisorError> {
        let file_error = |path: &Path| {
            let path = path.to_owned();
            move |source| SupervisorError::File { path, source }
        };
        reclaim_abandoned();
        let state_dir = run_dir.join(STATE_DIR);
        if let Some(pid) = owner(&state_dir) {
            return Err(SupervisorError::Busy { run_dir: run_dir.to_owned(), pid });
        }
        fs::create_dir_all(run_dir).map_err(file_error(run_dir))?;
        let _ = fs::remove_dir_all(&state_dir);
        private_dir(&state_dir).map_err(file_error(&state_dir))?;
        let (id, root) = fresh_root()?;
        let ipc = RunIpc { prefix: prefix(&id), root, supervisor: std::process::id() };
        let board = Board::create(&state_dir.join(BOARD_FILE), nodes).map_err(file_error(&state_dir))?;
        // From here on the drop gives everything back.
        let resources = Self { state_dir, ipc, board };
        let describe = || -> io::Result<()> {
            fs::write(resources.state_dir.join(IPC_FILE), serde_json::to_vec(&resources.ipc)?)?;
            let pid = resources.ipc.supervisor.to_string();
            fs::write(resources.state_dir.join(OWNER_FILE), &pid)?;
            fs::write(resources.ipc.root.join(OWNER_FILE), &pid)
        };
        describe().map_err(file_error(&resources.state_dir))?;
        Ok(resources)
    }

    pub(super) fn board(&self) -> &Board {
        &self.board
    }

    pub(super) fn ipc(&self) -> &RunIpc {
        &self.ipc
    }
}

impl Drop for RunResources {
    fn drop(&mut self) {
        give_back(&self.ipc.prefix, &self.ipc.root);
        let _ = fs::remove_dir_all(&self.state_dir);
    }
}

fn private_dir(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new().mode(0o700).create(path)
}

/// A folder of its own for the run, with a short path: sockets must fit into 108 bytes.
fn fresh_root() -> Result<(String, PathBuf), SupervisorError> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.subsec_nanos());
    let mut seed = u64::from(std::process::id()) << 32 | u64::from(now);
    loop {
        seed = (seed ^ (seed >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let id = format!("{:08x}", seed >> 32);
        let path = std::env::temp_dir().join(format!("{ROOT_BEGIN}{id}"));
        match private_dir(&path) {
            Ok(()) => return Ok((id, path)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(source) => return Err(SupervisorError::File { path, source }),
        }
    }
}

/// The living process that owns a folder.
fn owner(dir: &Path) -> Option<u32> {
    let pid: u32 = fs::read_to_string(dir.join(OWNER_FILE)).ok()?.trim().parse().ok()?;
    let alive = test_kill_process(Pid::from_raw(i32::try_from(pid).ok()?)?).is_ok();
    alive.then_some(pid)
}

fn give_back(prefix: &str, root: &Path) {
    let segments = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    for segment in segments.filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix)) {
        let _ = fs::remove_file(segment.path());
    }
    let _ = fs::remove_dir_all(root);
}

/// Gives back what supervisors left that were killed.
fn reclaim_abandoned() {
    let folders = fs::read_dir(std::env::temp_dir()).into_iter().flatten().flatten();
    for folder in folders {
        let name = folder.file_name().to_string_lossy().into_owned();
        let Some(id) = name.strip_prefix(ROOT_BEGIN).filter(|id| id.len() == 8) else { continue };
        let abandoned = folder.path().join(OWNER_FILE).exists() && owner(&folder.path()).is_none();
        if abandoned {
            log::info!("giving back what run {id} left");
            give_back(&prefix(id), &folder.path());
        }
    }
}
