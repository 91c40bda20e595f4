use crate::camera::{self, Camera, Picture};
use crate::participant::topic_name;
use crate::publish::check_depth;
use crate::{BridgeError, DdsEnvironment, Participant, PosePublisher, PublishConfig};
use pseudoflow_msgs::ros::{Naming, object_poses};
use pseudoflow_msgs::{CameraFrame, CameraFrameHeader, FrameKey, ObjectPose, ObjectPoses};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Produced, Role, read};
use schemars::JsonSchema;
use serde::Deserialize;

/// How images come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// `sensor_msgs/Image`.
    #[default]
    Raw,
    /// `sensor_msgs/CompressedImage`: jpeg or png.
    Compressed,
}

/// Which camera, and how the answer is published.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Topic of the images, from `/` on.
    pub image: String,
    /// How they come.
    #[serde(default)]
    pub transport: Transport,
    /// Topic of their calibration; each image needs one of the same stamp.
    pub camera_info: String,
    /// Whether the images are rectified already: then P of the calibration holds, not K and D.
    #[serde(default)]
    pub rectified: bool,
    /// Topic of a detector's initial poses (Detection3DArray); each image then waits for one of the same stamp.
    #[serde(default)]
    pub detections: Option<String>,
    /// Images that wait for what belongs to them, 1 to 10000; older ones are dropped and counted.
    #[serde(default = "default_depth")]
    pub queue_depth: u32,
    /// How poses that the graph feeds back are published, and what objects are called.
    #[serde(default)]
    pub publish: PublishConfig,
}

fn default_depth() -> u32 {
    10
}

/// The node `camera`: a live ROS 2 camera as the source of a graph. It sends `initial_poses` with each frame: those of
/// the detector, or none. Poses that come back by `poses` (a feedback edge) are published by the same
/// participant.
pub struct CameraSource {
    camera: Box<dyn Camera>,
    publisher: PosePublisher,
    naming: Naming,
    image_topic: String,
    next_index: u64,
    frame_id: String,
    rgb: Vec<u8>,
    last_published: Option<FrameKey>,
    participant: Participant,
}

impl Node for CameraSource {
    const KIND: &'static str = "camera";
    const ROLE: Role = Role::LiveSource;
    type Config = CameraConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::latest::<ObjectPoses>("poses")]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::optional::<CameraFrame>("frame"), PortSpec::optional::<ObjectPoses>("initial_poses")]
    }

    fn check(config: &CameraConfig) -> Result<(), NodeError> {
        DdsEnvironment::of_process()?;
        topic_name("image", &config.image)?;
        topic_name("camera_info", &config.camera_info)?;
        config.detections.as_ref().map_or(Ok(()), |topic| topic_name("detections", topic).map(|_| ()))?;
        check_depth("queue_depth", config.queue_depth)?;
        Ok(config.publish.check()?)
    }

    fn create(config: CameraConfig, _: &Context) -> Result<Self, NodeError> {
        let mut participant = Participant::open(DdsEnvironment::of_process()?, &config.publish.node_name)?;
        Ok(Self {
            camera: camera::open(&mut participant, &config)?,
            publisher: PosePublisher::new(&mut participant, &config.publish)?,
            naming: config.publish.naming()?,
            image_topic: config.image,
            next_index: 0,
            frame_id: String::new(),
            rgb: Vec::new(),
            last_published: None,
            participant,
        })
    }

    /// Publishes the poses that the graph feeds back, each frame's once.
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let key = inputs.key();
        if inputs.bytes("poses").is_none() || self.last_published == Some(key) {
            return Ok(());
        }
        let poses = read::<ObjectPoses>(inputs, "poses")?;
        self.last_published = Some(key);
        Ok(self.publisher.publish(key, &self.frame_id, poses.poses)?)
    }

    fn poll(&mut self, outputs: &mut dyn Outputs, _: &Context) -> Result<Produced, NodeError> {
        let Some(picture) = self.camera.next(&mut self.rgb)? else { return Ok(Produced::Nothing) };
        let key = FrameKey { index: self.next_index, stamp_ns: picture.stamp_ns };
        self.send(outputs, key, &picture)?;
        self.next_index += 1;
        self.frame_id = picture.frame_id;
        Ok(Produced::Frame(key))
    }
}

impl CameraSource {
    /// The participant: who has been found so far.
    #[must_use]
    pub fn participant(&self) -> &Participant {
        &self.participant
    }

    fn initial_poses(&self, picture: &Picture) -> Vec<ObjectPose> {
        let Some(detections) = &picture.detections else { return Vec::new() };
        if detections.header.frame_id != picture.frame_id {
            let (theirs, ours) = (&detections.header.frame_id, &picture.frame_id);
            log::warn!("detections in frame `{theirs}` ignored: the detector must give poses in the image's `{ours}`");
            return Vec::new();
        }
        let (poses, errors) = object_poses(detections, &self.naming);
        errors.iter().for_each(|error| log::warn!("{error}"));
        poses
    }

    fn send(&self, outputs: &mut dyn Outputs, key: FrameKey, picture: &Picture) -> Result<(), NodeError> {
        let (width, height) = picture.size;
        let frame_id = CameraFrameHeader::frame_id_bytes(&picture.frame_id).ok_or_else(|| BridgeError::FrameId {
            topic: self.image_topic.clone(),
            frame_id: picture.frame_id.clone(),
        })?;
        let (image_id, intrinsics) = (key.index as u32, picture.intrinsics);
        let header = CameraFrameHeader { width, height, scene_id: 0, image_id, intrinsics, frame_id };
        outputs.send("frame", key, CameraFrame::byte_len(width, height), &mut |bytes| {
            CameraFrame::write(bytes, header).rgb.copy_from_slice(&self.rgb);
        })?;
        let initial = self.initial_poses(picture);
        outputs.send("initial_poses", key, ObjectPoses::byte_len(initial.len()), &mut |bytes| {
            ObjectPoses::write(bytes, 0, image_id, &initial);
        })
    }
}
