//! Messages that come after their frame: kept until the frame that they are for.

use pseudoflow_msgs::{Message, ObjectPose, ObjectPoses};
use pseudoflow_runtime::{Inputs, NodeError};
use std::collections::BTreeMap;

/// What has come by one port and was not used yet.
#[derive(Debug, Default)]
pub(crate) struct Late {
    port: &'static str,
    waiting: BTreeMap<u64, Vec<ObjectPose>>,
    /// All frames up to this one have come (replay sends one message a frame, in order).
    newest: Option<u64>,
}

impl Late {
    pub(crate) fn new(port: &'static str) -> Self {
        Self { port, ..Self::default() }
    }

    /// Whether the message of a frame is there.
    pub(crate) fn has(&self, inputs: &dyn Inputs, frame: u64) -> bool {
        self.newest.is_some_and(|newest| newest >= frame)
            || inputs.late(self.port).iter().any(|(k, _)| k.index >= frame)
    }

    /// Takes over what has come; what comes again after a death is known already.
    pub(crate) fn absorb(&mut self, inputs: &dyn Inputs, replay: bool) -> Result<(), NodeError> {
        for (key, bytes) in inputs.late(self.port) {
            if replay && self.newest.is_some_and(|newest| key.index <= newest) {
                continue;
            }
            self.newest = self.newest.max(Some(key.index));
            let poses = ObjectPoses::view(bytes)?.poses;
            if !poses.is_empty() {
                // Live, objects of one frame may be found one after the other.
                self.waiting.entry(key.index).or_default().extend_from_slice(poses);
            }
        }
        Ok(())
    }

    /// What was found in frames up to one, by frame.
    pub(crate) fn take_until(&mut self, frame: u64) -> BTreeMap<u64, Vec<ObjectPose>> {
        let later = self.waiting.split_off(&(frame + 1));
        std::mem::replace(&mut self.waiting, later)
    }
}
