//! Messages that come after their frame: kept until the frame that they are for.

use pseudoflow_msgs::{Message, ObjectPose, ObjectPoses};
use pseudoflow_runtime::{Inputs, NodeError, Port};
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
    pub(crate) fn new(port: &Port<ObjectPoses<'static>>) -> Self {
        Self { port: port.name(), ..Self::default() }
    }

    pub(crate) fn is_connected(&self, inputs: &dyn Inputs) -> bool {
        inputs.is_connected(self.port)
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

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_msgs::FrameKey;
    use pseudoflow_runtime::{InMemory, Outputs};

    fn found(frame: u64, objects: &[u32]) -> InMemory {
        let key = FrameKey { index: frame, stamp_ns: 0 };
        let pose = |id: &u32| ObjectPose {
            object_id: *id,
            instance: 0,
            status: 0,
            source: 0,
            score: 0.5,
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            translation_m: [0.0, 0.0, 1.0],
            covariance: [0.0; 36],
        };
        let poses: Vec<ObjectPose> = objects.iter().map(pose).collect();
        let mut inputs = InMemory::new(key);
        let fill = &mut |bytes: &mut [u8]| ObjectPoses::write(bytes, 0, 0, &poses);
        inputs.send("found", key, ObjectPoses::byte_len(poses.len()), fill).unwrap();
        inputs
    }

    #[test]
    fn objects_of_one_frame_may_be_found_one_after_the_other() {
        let mut late = Late::new(&Port::late("found"));
        for (frame, objects) in [(3, vec![1]), (4, vec![]), (3, vec![2, 2]), (7, vec![5])] {
            late.absorb(&found(frame, &objects), false).unwrap();
        }
        let ids = |poses: &[ObjectPose]| poses.iter().map(|pose| pose.object_id).collect::<Vec<_>>();
        let taken: Vec<_> = late.take_until(6).iter().map(|(frame, poses)| (*frame, ids(poses))).collect();
        assert_eq!(taken, [(3, vec![1, 2, 2])]);
        assert_eq!(late.take_until(7).len(), 1);
    }
}
