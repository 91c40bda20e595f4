//! Finds processes that live but no longer move.

use crate::board::{Board, State, Word};
use crate::clock::monotonic_ns;
use std::time::Duration;

/// Between two looks at a process.
const PERIOD_NS: u64 = 100_000_000;
/// How long a process may be stopped (SIGSTOP): who debugs a node traces it, which is another state.
const STOPPED_NS: u64 = 500_000_000;
/// A longer pause of the supervisor itself (a machine that slept, a container that was paused) judges nobody.
const OWN_PAUSE_NS: u64 = 5_000_000_000;

/// How long a node may be without a sign of life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Deadlines {
    /// In a frame.
    pub(super) frame: Duration,
    /// From its start to its first frame: models are loaded and warmed up.
    pub(super) start: Duration,
}

/// What the supervisor remembers of its looks.
#[derive(Debug)]
pub(super) struct Watchdog {
    deadlines: Deadlines,
    /// When each node was first seen stopped, ns; 0 while it runs.
    stopped_ns: Vec<u64>,
    last_look_ns: u64,
    /// No silence before this moment counts.
    judged_from_ns: u64,
}

impl Watchdog {
    pub(super) fn new(deadlines: Deadlines, nodes: usize) -> Self {
        let now_ns = monotonic_ns();
        Self { deadlines, stopped_ns: vec![0; nodes], last_look_ns: now_ns, judged_from_ns: now_ns }
    }

    /// Whether it is time to look at all processes; notes pauses of this process itself.
    pub(super) fn is_due(&mut self) -> bool {
        let now_ns = monotonic_ns();
        let since = now_ns.saturating_sub(self.last_look_ns);
        if since > OWN_PAUSE_NS {
            self.judged_from_ns = now_ns;
            self.stopped_ns.fill(0);
        }
        let due = since >= PERIOD_NS;
        if due {
            self.last_look_ns = now_ns;
        }
        due
    }

    /// Why the process of a node must go; `None` while it moves.
    pub(super) fn complaint(&mut self, board: &Board, node: usize, pid: u32) -> Option<String> {
        let now_ns = monotonic_ns();
        if is_stopped(pid) {
            let since = &mut self.stopped_ns[node];
            if *since == 0 {
                *since = now_ns;
            }
            return (now_ns - *since >= STOPPED_NS).then(|| "stalled: it was stopped (SIGSTOP)".to_owned());
        }
        self.stopped_ns[node] = 0;
        let silent_ns = now_ns.saturating_sub(board.get(node, Word::Beat).max(self.judged_from_ns));
        let starting = board.state(node) == State::Away;
        let limit = if starting { self.deadlines.start } else { self.deadlines.frame };
        (u128::from(silent_ns) > limit.as_nanos()).then(|| {
            let place = match board.get(node, Word::At).checked_sub(1) {
                Some(frame) => format!("in frame {frame}"),
                None if starting => "in its start".to_owned(),
                None => "between frames".to_owned(),
            };
            let key = if starting { "start_deadline_s" } else { "frame_deadline_s" };
            format!("stalled: no sign of life for {} s {place} (`{key}`)", silent_ns / 1_000_000_000)
        })
    }
}

/// Whether a process is stopped by a signal, as /proc tells.
fn is_stopped(pid: u32) -> bool {
    // The name, in brackets, may hold anything.
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('T'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board(folder: &tempfile::TempDir) -> Board {
        Board::create(&folder.path().join("board"), 1).unwrap()
    }

    #[test]
    fn silence_counts_from_the_last_sign_of_life_or_the_supervisors_own_pause() {
        let folder = tempfile::tempdir().unwrap();
        let board = board(&folder);
        let deadlines = Deadlines { frame: Duration::from_secs(100), start: Duration::from_secs(1000) };
        let mut dog = Watchdog::new(deadlines, 1);
        let own = std::process::id();
        let now_ns = monotonic_ns();
        let ago = |seconds: u64| now_ns.saturating_sub(seconds * 1_000_000_000);
        (dog.judged_from_ns, dog.last_look_ns) = (0, now_ns);
        board.set_state(0, State::Ready);
        board.beat(0, ago(50), Some(7));
        assert_eq!(dog.complaint(&board, 0, own), None);
        board.beat(0, now_ns.wrapping_sub(150_000_000_000), Some(7));
        let text = dog.complaint(&board, 0, own).unwrap_or_default();
        assert!(text.contains("in frame 7") && text.contains("frame_deadline_s"), "{text}");
        board.set_state(0, State::Away);
        assert_eq!(dog.complaint(&board, 0, own), None, "a start may take longer");
        board.set_state(0, State::Ready);
        dog.last_look_ns = ago(60);
        assert!(dog.is_due());
        assert_eq!(dog.complaint(&board, 0, own), None, "the machine slept");
    }
}
