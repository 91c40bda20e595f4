use pseudoflow_imaging::{RgbImage, encode_jpeg};
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection3DArray, DiagnosticArray, Header, Naming, PoseStamped, TFMessage, best_pose,
    detections, diagnostics, pose_stamped, transforms,
};
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose, ObjectStatus};
use pseudoflow_runtime::NodeError;
use pseudoflow_runtime::bag::{BagWriter, Qos, TopicId};
use std::collections::BTreeMap;

/// The topics of a recording: those alone that get messages.
pub(crate) struct Topics {
    image: Option<(TopicId, TopicId)>,
    initial_poses: Option<TopicId>,
    poses: Option<PoseTopics>,
    overlay: Option<TopicId>,
    object_status: Option<TopicId>,
    /// Of other nodes, by name: made when the first comes.
    pictures: BTreeMap<String, TopicId>,
}

struct PoseTopics {
    object_poses: TopicId,
    object_pose: TopicId,
    tf: TopicId,
}

/// What a recording holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extras {
    pub(crate) images: bool,
    pub(crate) initial_poses: bool,
    pub(crate) poses: bool,
    pub(crate) overlay: bool,
    pub(crate) statuses: bool,
}

/// Where messages of a frame go.
pub(crate) struct FrameWriter<'a> {
    pub(crate) bag: &'a mut BagWriter,
    pub(crate) topics: &'a mut Topics,
    pub(crate) header: Header,
    pub(crate) stamp_ns: i64,
    pub(crate) sequence: u32,
}

impl Topics {
    pub(crate) fn add_to(bag: &mut BagWriter, extras: Extras) -> Result<Self, NodeError> {
        let mut image = None;
        if extras.images {
            let frames = bag.add_topic::<CompressedImage>("/camera/image/compressed", Qos::SENSOR_DATA)?;
            image = Some((frames, bag.add_topic::<CameraInfo>("/camera/camera_info", Qos::SENSOR_DATA)?));
        }
        let mut initial_poses = None;
        if extras.initial_poses {
            initial_poses = Some(bag.add_topic::<Detection3DArray>("/initial_poses", Qos::RELIABLE)?);
        }
        let object_poses =
            extras.poses.then(|| bag.add_topic::<Detection3DArray>("/object_poses", Qos::RELIABLE)).transpose()?;
        let overlay = extras.overlay.then(|| bag.add_topic::<CompressedImage>("/overlay/compressed", Qos::SENSOR_DATA));
        let overlay = overlay.transpose()?;
        let object_status = extras.statuses.then(|| bag.add_topic::<DiagnosticArray>("/object_status", Qos::RELIABLE));
        let object_status = object_status.transpose()?;
        let mut poses = None;
        if let Some(object_poses) = object_poses {
            let object_pose = bag.add_topic::<PoseStamped>("/object_pose", Qos::RELIABLE)?;
            poses =
                Some(PoseTopics { object_poses, object_pose, tf: bag.add_topic::<TFMessage>("/tf", Qos::RELIABLE)? });
        }
        Ok(Self { image, initial_poses, poses, overlay, object_status, pictures: BTreeMap::new() })
    }
}

impl FrameWriter<'_> {
    /// The frame as JPEG, and its camera.
    pub(crate) fn image(&mut self, jpeg: Vec<u8>, frame: &CameraFrameHeader) -> Result<(), NodeError> {
        let Some((image, camera_info)) = self.topics.image else { return Ok(()) };
        self.compressed(image, jpeg)?;
        let message = CameraInfo::pinhole(self.header.clone(), (frame.width, frame.height), frame.intrinsics);
        Ok(self.bag.write(camera_info, self.stamp_ns, self.sequence, &message)?)
    }

    pub(crate) fn overlay(&mut self, jpeg: Vec<u8>) -> Result<(), NodeError> {
        self.topics.overlay.map_or(Ok(()), |topic| self.compressed(topic, jpeg))
    }

    /// A JPEG of another node, as `/NAME/compressed`.
    pub(crate) fn picture(&mut self, name: &str, jpeg: Vec<u8>) -> Result<(), NodeError> {
        let topic = match self.topics.pictures.get(name) {
            Some(topic) => *topic,
            None => {
                let topic = self.bag.add_topic::<CompressedImage>(&format!("/{name}/compressed"), Qos::SENSOR_DATA)?;
                self.topics.pictures.insert(name.to_owned(), topic);
                topic
            }
        };
        self.compressed(topic, jpeg)
    }

    fn compressed(&mut self, topic: TopicId, data: Vec<u8>) -> Result<(), NodeError> {
        let message = CompressedImage { header: self.header.clone(), format: "jpeg".into(), data };
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &message)?)
    }

    pub(crate) fn initial_poses(&mut self, poses: &[ObjectPose]) -> Result<(), NodeError> {
        let Some(topic) = self.topics.initial_poses else { return Ok(()) };
        let message = detections(&self.header, poses, &Naming::default());
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &message)?)
    }

    /// `/object_status`.
    pub(crate) fn statuses(&mut self, statuses: &[ObjectStatus]) -> Result<(), NodeError> {
        let Some(topic) = self.topics.object_status else { return Ok(()) };
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &diagnostics(&self.header, statuses))?)
    }

    /// `/object_poses`, `/tf`, and `/object_pose` where a pose stands.
    pub(crate) fn poses(&mut self, poses: &[ObjectPose]) -> Result<(), NodeError> {
        let Some(topics) = &self.topics.poses else { return Ok(()) };
        let (stamp_ns, sequence) = (self.stamp_ns, self.sequence);
        let all = detections(&self.header, poses, &Naming::default());
        self.bag.write(topics.object_poses, stamp_ns, sequence, &all)?;
        self.bag.write(topics.tf, stamp_ns, sequence, &transforms(&self.header, poses))?;
        if let Some(best) = best_pose(poses, None) {
            self.bag.write(topics.object_pose, stamp_ns, sequence, &pose_stamped(&self.header, best))?;
        }
        Ok(())
    }
}

/// The frame as JPEG.
pub(crate) fn jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, NodeError> {
    Ok(encode_jpeg(image, quality)?)
}
