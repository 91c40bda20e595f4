use crate::description::urdf;
use crate::ledger::Ledger;
use crate::names::Names;
use crate::{BridgeConfig, BridgeError, Participant, latched_qos, publisher_qos};
use pseudoflow_edge::Catalogue;
use pseudoflow_msgs::ros::{
    Detection3DArray, DiagnosticArray, Follower, Header, LabelInfo, Naming, PoseStamped, PoseWithCovarianceStamped,
    RosMessage, StringMessage, TFMessage, Time, VisionClass, VisionInfo, detections, diagnostics, pose_stamped,
    pose_with_covariance_stamped, standing, transforms,
};
use pseudoflow_msgs::{FrameKey, ObjectPose, ObjectStatus};
use ros2_client::{Publisher, WriteError};
use std::collections::BTreeMap;

/// Instances of one object that get topics of their own.
const MAX_INSTANCES: u32 = 16;

/// What has been published.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Published {
    /// Frames whose messages were handed to DDS.
    pub(crate) frames: u64,
    /// Messages of `object_pose` among them: frames in which the object that it follows does not stand have none.
    pub(crate) poses: u64,
    /// Messages given up because a reliable subscriber took too long.
    pub(crate) given_up: u64,
}

/// Publishes the poses of frames as ROS 2 messages.
pub(crate) struct PosePublisher {
    config: BridgeConfig,
    catalogue: Catalogue,
    object_pose: Publisher<PoseStamped>,
    object_poses: Publisher<Detection3DArray>,
    refused: Publisher<Detection3DArray>,
    /// `objects/NAME/pose`: one of each object, more when more instances are found.
    objects: BTreeMap<(u32, u32), Publisher<PoseWithCovarianceStamped>>,
    tf: Option<Publisher<TFMessage>>,
    object_status: Publisher<DiagnosticArray>,
    /// What came in and was dropped.
    diagnostics: Publisher<DiagnosticArray>,
    /// Of the last frame.
    header: Header,
    latched: Latched,
    follower: Follower,
    published: Published,
}

/// What is said once.
struct Latched {
    _vision_info: Publisher<VisionInfo>,
    _label_info: Publisher<LabelInfo>,
    description: Publisher<StringMessage>,
    /// The optical frame that the description begins at.
    described: Option<String>,
}

impl PosePublisher {
    /// Announces the topics.
    ///
    /// # Errors
    /// When the configuration is wrong or DDS refuses.
    pub(crate) fn new(
        participant: &mut Participant,
        names: &Names,
        config: &BridgeConfig,
        catalogue: Catalogue,
    ) -> Result<Self, BridgeError> {
        let qos = publisher_qos(config.queue_depth);
        let wanted = config.object.as_deref().map(|name| catalogue.naming.wanted(name)).transpose()?;
        let tf = config.tf.enabled.then(|| participant.advertise(names, "/tf", qos.clone())).transpose()?;
        let ids: Vec<u32> = catalogue.naming.named().map(|(id, _)| id).collect();
        let mut publisher = Self {
            object_pose: participant.advertise(names, "object_pose", qos.clone())?,
            object_poses: participant.advertise(names, "object_poses", qos.clone())?,
            refused: participant.advertise(names, "object_poses/refused", qos.clone())?,
            objects: BTreeMap::new(),
            tf,
            object_status: participant.advertise(names, "object_status", qos.clone())?,
            diagnostics: participant.advertise(names, "diagnostics", qos)?,
            latched: Latched::open(participant, names, config, &catalogue)?,
            follower: Follower::new(wanted, (config.switch_after_s * 1e9) as i64),
            header: Header::default(),
            published: Published::default(),
            config: config.clone(),
            catalogue,
        };
        ids.into_iter().try_for_each(|id| publisher.announce(participant, names, (id, 0)))?;
        Ok(publisher)
    }

    /// A topic of its own for an instance.
    fn announce(
        &mut self,
        participant: &mut Participant,
        names: &Names,
        identity: (u32, u32),
    ) -> Result<(), BridgeError> {
        let token = self.catalogue.naming.token(identity.0, identity.1);
        let qos = publisher_qos(self.config.queue_depth);
        let publisher = participant.advertise(names, &format!("objects/{token}/pose"), qos)?;
        self.objects.insert(identity, publisher);
        self.latched.described = None;
        Ok(())
    }

    /// Publishes the poses (`camera_from_object`) of one frame with the image's stamp and optical frame, and the tracks where
    /// the graph has some.
    ///
    /// # Errors
    /// When the stamp does not fit into ROS time or DDS fails. A subscriber that is too slow is no error: what it
    /// would not take is given up, counted and logged.
    pub(crate) fn publish(
        &mut self,
        participant: &mut Participant,
        names: &Names,
        key: FrameKey,
        frame_id: &str,
        poses: &[ObjectPose],
        statuses: Option<&[ObjectStatus]>,
    ) -> Result<(), BridgeError> {
        let header = header(key, frame_id)?;
        let (good, refused) = standing(poses);
        for pose in &good {
            if !self.objects.contains_key(&pose.identity()) && pose.instance < MAX_INSTANCES {
                self.announce(participant, names, pose.identity())?;
            }
        }
        let mut given_up = self.latched.describe(frame_id, &self.catalogue, &self.config, self.objects.keys())?;
        let naming = &self.catalogue.naming;
        given_up += send("object_poses", &self.object_poses, detections(&header, &good, naming))?;
        given_up += send("object_poses/refused", &self.refused, detections(&header, &refused, naming))?;
        if let Some(tf) = &self.tf {
            given_up += send("tf", tf, transforms(&header, &good, naming, &self.config.tf_prefix()))?;
        }
        for pose in ObjectPose::likeliest(&good) {
            if let Some(publisher) = self.objects.get(&pose.identity()) {
                given_up += send("objects/NAME/pose", publisher, pose_with_covariance_stamped(&header, pose))?;
            }
        }
        if let Some(pose) = self.follower.choose(key.stamp_ns, &good) {
            given_up += send("object_pose", &self.object_pose, pose_stamped(&header, pose))?;
            self.published.poses += 1;
        }
        if let Some(statuses) = statuses {
            given_up += send("object_status", &self.object_status, diagnostics(&header, statuses, naming))?;
        }
        self.header = header;
        self.count(key, given_up);
        Ok(())
    }

    fn count(&mut self, key: FrameKey, given_up: u64) {
        self.published.frames += 1;
        self.published.given_up += given_up;
        if given_up > 0 {
            let all = self.published.given_up;
            log::warn!(
                "frame {}: a reliable subscriber did not take a message in time; {all} given up so far",
                key.index
            );
        }
    }

    /// What objects are called.
    pub(crate) fn naming(&self) -> &Naming {
        &self.catalogue.naming
    }

    /// Publishes what came in and was dropped, where that has changed.
    pub(crate) fn report(&mut self, ledger: &mut Ledger) -> Result<(), BridgeError> {
        let report = ledger.report(&self.header);
        report.map_or(Ok(()), |report| send("diagnostics", &self.diagnostics, report).map(|_| ()))
    }

    /// What has been published so far.
    #[must_use]
    pub(crate) fn published(&self) -> Published {
        self.published
    }
}

impl Latched {
    fn open(
        participant: &mut Participant,
        names: &Names,
        config: &BridgeConfig,
        catalogue: &Catalogue,
    ) -> Result<Self, BridgeError> {
        let vision_info = participant.advertise(names, "vision_info", latched_qos())?;
        let label_info = participant.advertise(names, "label_info", latched_qos())?;
        send("vision_info", &vision_info, vision(config, catalogue))?;
        send("label_info", &label_info, labels(catalogue))?;
        Ok(Self {
            _vision_info: vision_info,
            _label_info: label_info,
            description: participant.advertise(names, "object_description", latched_qos())?,
            described: None,
        })
    }

    /// Describes the objects' frames below the optical frame, which the first image names.
    fn describe<'a>(
        &mut self,
        frame_id: &str,
        catalogue: &Catalogue,
        config: &BridgeConfig,
        instances: impl Iterator<Item = &'a (u32, u32)>,
    ) -> Result<u64, BridgeError> {
        if self.described.as_deref() == Some(frame_id) {
            return Ok(0);
        }
        self.described = Some(frame_id.to_owned());
        let data = urdf(catalogue, &config.tf_prefix(), frame_id, instances.copied());
        send("object_description", &self.description, StringMessage { data })
    }
}

fn vision(config: &BridgeConfig, catalogue: &Catalogue) -> VisionInfo {
    VisionInfo {
        header: Header::default(),
        method: format!("pseudoflow {}", env!("CARGO_PKG_VERSION")),
        database_location: catalogue.folder.display().to_string(),
        database_version: catalogue.version(&config.weights),
    }
}

fn labels(catalogue: &Catalogue) -> LabelInfo {
    let class = |(id, name): (u32, &str)| match u16::try_from(id) {
        Ok(class_id) => Some(VisionClass { class_id, class_name: name.to_owned() }),
        Err(_) => {
            log::warn!("object {id} (`{name}`) is left out of label_info, whose ids end at 65535");
            None
        }
    };
    let class_map = catalogue.naming.named().filter_map(class).collect();
    LabelInfo { header: Header::default(), class_map, threshold: 0.0 }
}

fn header(key: FrameKey, frame_id: &str) -> Result<Header, BridgeError> {
    let stamp = Time::from_ns(key.stamp_ns).ok_or(BridgeError::Stamp { index: key.index, stamp_ns: key.stamp_ns })?;
    Ok(Header { stamp, frame_id: frame_id.to_owned() })
}

/// Returns how many messages were given up: 0 or 1.
fn send<M: RosMessage>(topic: &str, publisher: &Publisher<M>, message: M) -> Result<u64, BridgeError> {
    match publisher.publish(message) {
        Ok(()) => Ok(0),
        Err(WriteError::WouldBlock { .. }) => Ok(1),
        Err(error) => Err(BridgeError::Publish { topic: topic.to_owned(), cause: error.to_string() }),
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

    #[test]
    fn all_classes_are_named_with_their_ids() {
        let object_names = [(5, "mustard".to_owned()), (70_000, "far".to_owned())].into();
        let config = BridgeConfig { object_names, ..BridgeConfig::default() };
        let catalogue = config.catalogue().unwrap();
        assert_eq!(labels(&catalogue).class_map, [VisionClass { class_id: 5, class_name: "mustard".into() }]);
        assert!(vision(&config, &catalogue).method.starts_with("pseudoflow "));
    }
}
