//! What was sent of late: another node's death may bring a frame back, which then gets what it got.

use crate::node::{INITIAL_POSES, STATUS};
use pseudoflow_msgs::{FrameKey, ObjectPose, ObjectPoses, ObjectStatus, ObjectStatuses};
use pseudoflow_runtime::{NodeError, Outputs};
use std::collections::VecDeque;

/// What was sent for a frame.
#[derive(Debug, Clone)]
pub(crate) struct Sent {
    pub(crate) key: FrameKey,
    /// Scene and image.
    pub(crate) image: (u32, u32),
    pub(crate) searched: bool,
    pub(crate) poses: Vec<ObjectPose>,
    pub(crate) statuses: Vec<ObjectStatus>,
}

impl Sent {
    pub(crate) fn send(&self, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let (scene_id, image_id) = self.image;
        INITIAL_POSES.send(outputs, self.key, ObjectPoses::byte_len(self.poses.len()), &mut |bytes| {
            ObjectPoses::write(bytes, scene_id, image_id, &self.poses);
        })?;
        STATUS.send(outputs, self.key, ObjectStatuses::byte_len(self.statuses.len()), &mut |bytes| {
            ObjectStatuses::write(bytes, self.searched, &self.statuses);
        })
    }
}

/// Frames that are remembered; more than are in flight.
const REMEMBERED: usize = 128;

/// The last frames.
#[derive(Debug, Default)]
pub(crate) struct Memory(VecDeque<Sent>);

impl Memory {
    pub(crate) fn of_frame(&self, index: u64) -> Option<&Sent> {
        self.0.iter().find(|sent| sent.key.index == index)
    }

    pub(crate) fn of_image(&self, image: (u32, u32)) -> Option<&Sent> {
        self.0.iter().find(|sent| sent.image == image)
    }

    pub(crate) fn last(&self) -> Option<&Sent> {
        self.0.back()
    }

    /// Keeps what was sent for a new frame.
    pub(crate) fn remember(&mut self, sent: Sent) {
        if self.last().is_none_or(|last| last.key.index < sent.key.index) {
            self.0.push_back(sent);
            if self.0.len() > REMEMBERED {
                self.0.pop_front();
            }
        }
    }
}
