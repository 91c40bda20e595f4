use super::{Launch, RunError};
use crate::bad::bad_frames;
use crate::clock::monotonic_ns;
use crate::{BadFrames, BadInput, NodeError};

/// Between two log lines about bad frames: a hostile participant must not fill the log.
const PAUSE_NS: u64 = 1_000_000_000;

/// Keeps account of frames that a node could not use.
#[derive(Debug, Default)]
pub(super) struct Complaints {
    told_ns: Option<u64>,
    untold: u64,
    /// What the node knows of the run's bad frames, and when that was looked at.
    known: Vec<BadFrames>,
    looked_ns: u64,
}

impl Complaints {
    /// Counts and names a bad frame of a live graph; any other error, and any error of a replay, comes back.
    pub(super) fn hear(&mut self, launch: &Launch, place: &str, error: &NodeError) -> Result<(), RunError> {
        let bad = error.downcast_ref::<BadInput>().filter(|_| !launch.plan.replay());
        let Some(bad) = bad else { return Err(launch.node_error(place, error)) };
        let from = launch.producer_of(bad.port).map(|name| format!(" from `{name}`")).unwrap_or_default();
        let cause = crate::error::chain(&*bad.cause);
        let text = format!("{place} dropped: input `{}`{from}: {cause}", bad.port);
        let input = launch.node().inputs.iter().position(|input| input.port == bad.port);
        launch.board.count_bad(launch.me, input, 1, &text);
        self.tell(&text);
        Ok(())
    }

    /// What all nodes of a live run have dropped, when that has changed since this was last asked: once a second at most.
    pub(super) fn news(&mut self, launch: &Launch) -> Option<&[BadFrames]> {
        let now_ns = monotonic_ns();
        if launch.plan.replay() || now_ns.saturating_sub(self.looked_ns) < PAUSE_NS {
            return None;
        }
        self.looked_ns = now_ns;
        let bad = bad_frames(&launch.plan, &launch.board);
        let changed = bad != self.known;
        self.known = bad;
        changed.then_some(&self.known)
    }

    fn tell(&mut self, text: &str) {
        let now_ns = monotonic_ns();
        if self.told_ns.is_some_and(|told| now_ns.saturating_sub(told) < PAUSE_NS) {
            self.untold += 1;
            return;
        }
        match std::mem::take(&mut self.untold) {
            0 => log::warn!("{text}"),
            more => log::warn!("{text} (and {more} more since the last such line)"),
        }
        self.told_ns = Some(now_ns);
    }
}
