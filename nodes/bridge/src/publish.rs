use crate::participant::topic_name;
use crate::{BridgeConfig, BridgeError, Participant, publisher_qos};
use pseudoflow_msgs::ros::{
    Detection3DArray, DiagnosticArray, Header, Naming, PoseStamped, RosMessage, TFMessage, Time, best_pose, detections,
    diagnostics, pose_stamped, transforms,
};
use pseudoflow_msgs::{FrameKey, ObjectPose, ObjectStatus};
use ros2_client::{Publisher, WriteError};

/// What has been published.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Published {
    /// Frames whose messages were handed to DDS.
    pub frames: u64,
    /// Messages of `object_pose` among them: frames without a pose that stands have none.
    pub poses: u64,
    /// Messages given up because a reliable subscriber took too long.
    pub given_up: u64,
}

/// Publishes the poses of frames as ROS 2 messages.
pub struct PosePublisher {
    object_pose: Publisher<PoseStamped>,
    object_poses: Publisher<Detection3DArray>,
    tf: Publisher<TFMessage>,
    object_status: Publisher<DiagnosticArray>,
    object_id: Option<u32>,
    naming: Naming,
    published: Published,
}

impl PosePublisher {
    /// Announces the topics.
    ///
    /// # Errors
    /// When the configuration is wrong or DDS refuses.
    pub fn new(participant: &mut Participant, config: &BridgeConfig) -> Result<Self, BridgeError> {
        let qos = publisher_qos(config.queue_depth);
        Ok(Self {
            object_pose: participant.publisher(&config.topic("object_pose")?, &qos)?,
            object_poses: participant.publisher(&config.topic("object_poses")?, &qos)?,
            tf: participant.publisher(&topic_name("tf", "/tf")?, &qos)?,
            object_status: participant.publisher(&config.topic("object_status")?, &qos)?,
            object_id: config.object_id,
            naming: config.naming()?,
            published: Published::default(),
        })
    }

    /// Publishes the poses (`camera_from_object`) of one frame with the image's stamp and optical frame, and the tracks where
    /// the graph has some.
    ///
    /// # Errors
    /// When the stamp does not fit into ROS time or DDS fails. A subscriber that is too slow is no error: what it
    /// would not take is given up, counted and logged.
    pub fn publish(
        &mut self,
        key: FrameKey,
        frame_id: &str,
        poses: &[ObjectPose],
        statuses: Option<&[ObjectStatus]>,
    ) -> Result<(), BridgeError> {
        let header = header(key, frame_id)?;
        let mut given_up = 0;
        if let Some(best) = best_pose(poses, self.object_id) {
            given_up += send("object_pose", &self.object_pose, pose_stamped(&header, best))?;
            self.published.poses += 1;
        }
        given_up += send("object_poses", &self.object_poses, detections(&header, poses, &self.naming))?;
        given_up += send("tf", &self.tf, transforms(&header, poses))?;
        if let Some(statuses) = statuses {
            given_up += send("object_status", &self.object_status, diagnostics(&header, statuses))?;
        }
        if given_up > 0 {
            self.published.given_up += given_up;
            log::warn!(
                "frame {}: a reliable subscriber did not take a message in time; {} given up so far",
                key.index,
                self.published.given_up
            );
        }
        self.published.frames += 1;
        Ok(())
    }

    /// What has been published so far.
    #[must_use]
    pub fn published(&self) -> Published {
        self.published
    }
}

fn header(key: FrameKey, frame_id: &str) -> Result<Header, BridgeError> {
    let stamp = Time::from_ns(key.stamp_ns).ok_or(BridgeError::Stamp { index: key.index, stamp_ns: key.stamp_ns })?;
    Ok(Header { stamp, frame_id: frame_id.to_owned() })
}

/// Returns how many messages were given up: 0 or 1.
fn send<M: RosMessage>(topic: &'static str, publisher: &Publisher<M>, message: M) -> Result<u64, BridgeError> {
    match publisher.publish(message) {
        Ok(()) => Ok(0),
        Err(WriteError::WouldBlock { .. }) => Ok(1),
        Err(error) => Err(BridgeError::Publish { topic, cause: error.to_string() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_that_of_the_image() {
        let key = FrameKey { index: 3, stamp_ns: 1_700_000_000_000_000_007 };
        let expected = Header { stamp: Time { sec: 1_700_000_000, nanosec: 7 }, frame_id: "camera_optical".into() };
        assert_eq!(header(key, "camera_optical").unwrap(), expected);
        let far = FrameKey { index: 3, stamp_ns: i64::MAX };
        assert!(header(far, "camera").unwrap_err().to_string().contains("frame 3"));
    }
}
