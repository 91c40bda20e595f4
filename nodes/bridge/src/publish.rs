use crate::participant::{node_name, topic_name};
use crate::{BridgeError, Participant, publisher_qos};
use pseudoflow_msgs::ros::{
    Detection3DArray, Header, Naming, PoseStamped, RosMessage, TFMessage, Time, best_pose, detections, pose_stamped,
    transforms,
};
use pseudoflow_msgs::{FrameKey, ObjectPose};
use ros2_client::{Name, Publisher, WriteError};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Most messages that a publisher or subscription may keep.
pub(crate) const MAX_QUEUE_DEPTH: u32 = 10_000;

/// How poses are published.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PublishConfig {
    /// Name of the ROS 2 node.
    pub node_name: String,
    /// Namespace of `object_pose` and `object_poses`; `/tf` stays where ROS 2 looks for it.
    pub namespace: String,
    /// The object of `object_pose`; without it, the one with the best score.
    pub object_id: Option<u32>,
    /// What objects are called in `class_id`, by object id; the id in digits where a name is missing.
    pub object_names: BTreeMap<u32, String>,
    /// Messages kept for slow reliable subscribers, 1 to 10000.
    pub queue_depth: u32,
}

impl Default for PublishConfig {
    fn default() -> Self {
        Self {
            node_name: "pseudoflow".into(),
            namespace: "/".into(),
            object_id: None,
            object_names: BTreeMap::new(),
            queue_depth: 100,
        }
    }
}

impl PublishConfig {
    /// Checks names and ranges.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn check(&self) -> Result<(), BridgeError> {
        node_name(&self.node_name)?;
        self.topic("object_pose")?;
        check_depth("queue_depth", self.queue_depth)?;
        self.naming().map(|_| ())
    }

    /// What objects are called.
    ///
    /// # Errors
    /// When two could not be told apart.
    pub fn naming(&self) -> Result<Naming, BridgeError> {
        Naming::new(self.object_names.clone()).map_err(BridgeError::AmbiguousName)
    }

    fn topic(&self, name: &str) -> Result<Name, BridgeError> {
        let namespace = self.namespace.trim_end_matches('/');
        topic_name("namespace", &format!("{namespace}/{name}"))
    }
}

pub(crate) fn check_depth(field: &'static str, depth: u32) -> Result<(), BridgeError> {
    if (1..=MAX_QUEUE_DEPTH).contains(&depth) {
        return Ok(());
    }
    Err(BridgeError::Range { field, value: depth.into(), min: 1, max: MAX_QUEUE_DEPTH.into() })
}

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
    object_id: Option<u32>,
    naming: Naming,
    published: Published,
}

impl PosePublisher {
    /// Announces the topics.
    ///
    /// # Errors
    /// When the configuration is wrong or DDS refuses.
    pub fn new(participant: &mut Participant, config: &PublishConfig) -> Result<Self, BridgeError> {
        config.check()?;
        let qos = publisher_qos(config.queue_depth);
        Ok(Self {
            object_pose: participant.publisher(&config.topic("object_pose")?, &qos)?,
            object_poses: participant.publisher(&config.topic("object_poses")?, &qos)?,
            tf: participant.publisher(&topic_name("tf", "/tf")?, &qos)?,
            object_id: config.object_id,
            naming: config.naming()?,
            published: Published::default(),
        })
    }

    /// Publishes the poses (`camera_from_object`) of one frame with the image's stamp and optical frame.
    ///
    /// # Errors
    /// When the stamp does not fit into ROS time or DDS fails. A subscriber that is too slow is no error: what it
    /// would not take is given up, counted and logged.
    pub fn publish(&mut self, key: FrameKey, frame_id: &str, poses: &[ObjectPose]) -> Result<(), BridgeError> {
        let header = header(key, frame_id)?;
        let mut given_up = 0;
        if let Some(best) = best_pose(poses, self.object_id) {
            given_up += send("object_pose", &self.object_pose, pose_stamped(&header, best))?;
            self.published.poses += 1;
        }
        given_up += send("object_poses", &self.object_poses, detections(&header, poses, &self.naming))?;
        given_up += send("tf", &self.tf, transforms(&header, poses))?;
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
    fn the_default_configuration_is_valid_and_wrong_ones_name_the_field() {
        PublishConfig::default().check().unwrap();
        let refused = |config: PublishConfig| config.check().unwrap_err().to_string();
        let default = PublishConfig::default;
        assert!(refused(PublishConfig { queue_depth: 0, ..default() }).contains("`queue_depth: 0`"));
        assert!(refused(PublishConfig { namespace: "a b".into(), ..default() }).contains("`namespace: "));
        assert!(refused(PublishConfig { node_name: "a/b".into(), ..default() }).contains("`node_name: "));
        let object_names = [(1, "cup".to_owned()), (2, "cup".to_owned())].into();
        assert!(refused(PublishConfig { object_names, ..default() }).contains("`cup`"));
    }

    #[test]
    fn topics_lie_in_the_namespace() {
        let topic = |namespace: &str| {
            PublishConfig { namespace: namespace.into(), ..PublishConfig::default() }
                .topic("object_pose")
                .unwrap()
                .to_string()
        };
        assert_eq!(topic("/"), "/object_pose");
        assert_eq!(topic("/robot/arm"), "/robot/arm/object_pose");
    }

    #[test]
    fn the_header_is_that_of_the_image() {
        let key = FrameKey { index: 3, stamp_ns: 1_700_000_000_000_000_007 };
        let expected = Header { stamp: Time { sec: 1_700_000_000, nanosec: 7 }, frame_id: "camera_optical".into() };
        assert_eq!(header(key, "camera_optical").unwrap(), expected);
        let far = FrameKey { index: 3, stamp_ns: i64::MAX };
        assert!(header(far, "camera").unwrap_err().to_string().contains("frame 3"));
    }
}
