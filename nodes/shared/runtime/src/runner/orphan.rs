use super::RunError;
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal, test_kill_process};
use std::time::Duration;

/// Ends this process when the supervisor does: politely first, so that recordings are closed, by force when the
/// node is too deep in its work to notice.
pub(super) fn die_with(supervisor: u32) -> Result<(), RunError> {
    let pid = i32::try_from(supervisor).ok().and_then(Pid::from_raw).ok_or(RunError::Orphan(supervisor))?;
    let is_child = getppid() == Some(pid);
    if is_child {
        set_parent_process_death_signal(Some(Signal::TERM)).map_err(|_| RunError::Orphan(supervisor))?;
    }
    // The parent may have died before the line above; a process started by hand has another parent.
    if (is_child && getppid() != Some(pid)) || test_kill_process(pid).is_err() {
        return Err(RunError::Orphan(supervisor));
    }
    std::thread::spawn(move || {
        while test_kill_process(pid).is_ok() {
            std::thread::sleep(Duration::from_secs(1));
        }
        std::thread::sleep(Duration::from_secs(10));
        std::process::exit(1);
    });
    Ok(())
}
