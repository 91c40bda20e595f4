use pseudoflow_imaging::{RgbImage, encode_jpeg};
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection3DArray, Header, Naming, PoseStamped, TFMessage, best_pose, detections,
    pose_stamped, transforms,
};
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose};
use pseudoflow_runtime::NodeError;
use pseudoflow_runtime::bag::{BagWriter, Qos, TopicId};

/// The topics of a recording: those alone that get messages.
pub(crate) struct Topics {
    image: Option<(TopicId, TopicId)>,
    initial_poses: Option<TopicId>,
    object_poses: TopicId,
    object_pose: TopicId,
    tf: TopicId,
    overlay: Option<TopicId>,
}

/// What a recording holds besides refined poses.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extras {
    pub(crate) images: bool,
    pub(crate) initial_poses: bool,
    pub(crate) overlay: bool,
}

/// Where messages of a frame go.
pub(crate) struct FrameWriter<'a> {
    pub(crate) bag: &'a mut BagWriter,
    pub(crate) topics: &'a Topics,
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
        let mut poses = |name| bag.add_topic::<Detection3DArray>(name, Qos::RELIABLE);
        let initial_poses = extras.initial_poses.then(|| poses("/initial_poses")).transpose()?;
        let object_poses = poses("/object_poses")?;
        let overlay = extras.overlay.then(|| bag.add_topic::<CompressedImage>("/overlay/compressed", Qos::SENSOR_DATA));
        Ok(Self {
            image,
            initial_poses,
            object_poses,
            overlay: overlay.transpose()?,
            object_pose: bag.add_topic::<PoseStamped>("/object_pose", Qos::RELIABLE)?,
            tf: bag.add_topic::<TFMessage>("/tf", Qos::RELIABLE)?,
        })
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

    fn compressed(&mut self, topic: TopicId, data: Vec<u8>) -> Result<(), NodeError> {
        let message = CompressedImage { header: self.header.clone(), format: "jpeg".into(), data };
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &message)?)
    }

    pub(crate) fn initial_poses(&mut self, poses: &[ObjectPose]) -> Result<(), NodeError> {
        let Some(topic) = self.topics.initial_poses else { return Ok(()) };
        let message = detections(&self.header, poses, &Naming::default());
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &message)?)
    }

    /// `/object_poses`, `/tf`, and `/object_pose` where a pose stands.
    pub(crate) fn poses(&mut self, poses: &[ObjectPose]) -> Result<(), NodeError> {
        let (stamp_ns, sequence) = (self.stamp_ns, self.sequence);
        let all = detections(&self.header, poses, &Naming::default());
        self.bag.write(self.topics.object_poses, stamp_ns, sequence, &all)?;
        self.bag.write(self.topics.tf, stamp_ns, sequence, &transforms(&self.header, poses))?;
        if let Some(best) = best_pose(poses, None) {
            self.bag.write(self.topics.object_pose, stamp_ns, sequence, &pose_stamped(&self.header, best))?;
        }
        Ok(())
    }
}

/// The frame as JPEG.
pub(crate) fn jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, NodeError> {
    Ok(encode_jpeg(image, quality)?)
}
