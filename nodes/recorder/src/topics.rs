use pseudoflow_bag::{BagWriter, Qos, TopicId};
use pseudoflow_imaging::{RgbImage, encode_jpeg};
use pseudoflow_msgs::ros::{
    BagMessage, CameraInfo, CompressedImage, Detection3DArray, DiagnosticArray, Header, Naming, PoseStamped,
    PoseWithCovarianceStamped, TFMessage, detections, diagnostics, pose_stamped, pose_with_covariance_stamped,
    standing, transforms,
};
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose, ObjectStatus};
use pseudoflow_runtime::NodeError;
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
    refused: TopicId,
    /// `/objects/NAME/pose` of each instance, made when its first pose comes.
    objects: BTreeMap<(u32, u32), TopicId>,
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
    pub(crate) naming: &'a Naming,
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
            let refused = bag.add_topic::<Detection3DArray>("/object_poses/refused", Qos::RELIABLE)?;
            let tf = bag.add_topic::<TFMessage>("/tf", Qos::RELIABLE)?;
            poses = Some(PoseTopics { object_poses, refused, objects: BTreeMap::new(), object_pose, tf });
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
        let message = detections(&self.header, poses, self.naming);
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &message)?)
    }

    /// `/object_status`.
    pub(crate) fn statuses(&mut self, statuses: &[ObjectStatus]) -> Result<(), NodeError> {
        let Some(topic) = self.topics.object_status else { return Ok(()) };
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, &diagnostics(&self.header, statuses, self.naming))?)
    }

    /// `/object_poses` of what stands and `/object_poses/refused` of the rest, `/tf`, `/objects/NAME/pose`, and
    /// `/object_pose` where the object that it follows stands.
    pub(crate) fn poses(&mut self, poses: &[ObjectPose], followed: Option<&ObjectPose>) -> Result<(), NodeError> {
        let Some(topics) = &mut self.topics.poses else { return Ok(()) };
        let (header, naming) = (&self.header, self.naming);
        let mut write = Write { bag: self.bag, stamp_ns: self.stamp_ns, sequence: self.sequence };
        let (good, refused) = standing(poses);
        write.message(topics.object_poses, &detections(header, &good, naming))?;
        write.message(topics.refused, &detections(header, &refused, naming))?;
        write.message(topics.tf, &transforms(header, poses, naming, ""))?;
        for pose in ObjectPose::likeliest(&good) {
            let topic = match topics.objects.get(&pose.identity()) {
                Some(topic) => *topic,
                None => {
                    let name = format!("/objects/{}/pose", naming.token(pose.object_id, pose.instance));
                    let topic = write.bag.add_topic::<PoseWithCovarianceStamped>(&name, Qos::RELIABLE)?;
                    topics.objects.insert(pose.identity(), topic);
                    topic
                }
            };
            write.message(topic, &pose_with_covariance_stamped(header, pose))?;
        }
        followed.map_or(Ok(()), |pose| write.message(topics.object_pose, &pose_stamped(header, pose)))
    }
}

/// Messages of one frame into a bag.
struct Write<'a> {
    bag: &'a mut BagWriter,
    stamp_ns: i64,
    sequence: u32,
}

impl Write<'_> {
    fn message<M: BagMessage>(&mut self, topic: TopicId, message: &M) -> Result<(), NodeError> {
        Ok(self.bag.write(topic, self.stamp_ns, self.sequence, message)?)
    }
}

/// The frame as JPEG.
pub(crate) fn jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, NodeError> {
    Ok(encode_jpeg(image, quality)?)
}
