use crate::camera::{self, Camera, Picture};
use crate::{BridgeConfig, BridgeError, DdsEnvironment, Participant, PosePublisher};
use pseudoflow_msgs::ros::{Naming, object_poses};
use pseudoflow_msgs::{CameraFrame, CameraFrameHeader, FrameKey, ObjectPose, ObjectPoses, ObjectStatuses};
use pseudoflow_runtime::{Context, Inputs, MissingInput, Node, NodeError, Outputs, PortSpec, Produced, Role, read};
use std::time::Duration;

/// How long the participant stays after the last message, for subscribers that ask for a repeat.
const LINGER: Duration = Duration::from_millis(200);

/// The node `bridge`.
pub struct Bridge {
    publisher: PosePublisher,
    camera: Option<LiveCamera>,
    participant: Participant,
}

struct LiveCamera {
    topics: Box<dyn Camera>,
    image_topic: String,
    naming: Naming,
    next_index: u64,
    /// Optical frame of the newest image.
    frame_id: Option<String>,
    rgb: Vec<u8>,
}

impl Node for Bridge {
    const KIND: &'static str = "bridge";
    const ROLE: Role = Role::LiveSource;
    type Config = BridgeConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![
            PortSpec::optional::<ObjectPoses>("poses"),
            PortSpec::optional::<CameraFrame>("frame"),
            PortSpec::optional::<ObjectStatuses>("status"),
        ]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::optional::<CameraFrame>("frame"), PortSpec::optional::<ObjectPoses>("initial_poses")]
    }

    fn check(config: &BridgeConfig) -> Result<(), NodeError> {
        DdsEnvironment::of_process()?;
        Ok(config.check()?)
    }

    fn create(config: BridgeConfig, context: &Context) -> Result<Self, NodeError> {
        config.check()?;
        let environment = DdsEnvironment::of_process()?;
        let mut participant = Participant::open(environment, &config.namespace, &config.node_name)?;
        let publisher = PosePublisher::new(&mut participant, &config)?;
        let camera = LiveCamera::open(&mut participant, &config, context)?;
        Ok(Self { publisher, camera, participant })
    }

    /// Publishes a frame's poses. Where the graph gives no `frame`, they are poses of the bridge's own camera.
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let poses = read::<ObjectPoses>(inputs, "poses")?;
        let key = inputs.key();
        let frame_id = match (inputs.bytes("frame"), &self.camera) {
            (Some(_), _) => read::<CameraFrame>(inputs, "frame")?.header.frame_id(),
            (None, Some(LiveCamera { frame_id: Some(frame_id), .. })) => frame_id,
            (None, Some(_)) => {
                log::info!("frame {}: its image came in an earlier life of this node; not published", key.index);
                return Ok(());
            }
            (None, None) => return Err(MissingInput("frame").into()),
        };
        let statuses = match inputs.bytes("status") {
            Some(_) => Some(read::<ObjectStatuses>(inputs, "status")?.statuses),
            None => None,
        };
        Ok(self.publisher.publish(&mut self.participant, key, frame_id, poses.poses, statuses)?)
    }

    fn poll(&mut self, outputs: &mut dyn Outputs, _: &Context) -> Result<Produced, NodeError> {
        self.camera.as_mut().ok_or(BridgeError::NoCamera)?.poll(outputs)
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        std::thread::sleep(LINGER);
        log::info!("published {:?}", self.publisher.published());
        Ok(())
    }
}

impl Bridge {
    /// The participant: who has been found so far.
    #[must_use]
    pub fn participant(&self) -> &Participant {
        &self.participant
    }
}

impl LiveCamera {
    fn open(
        participant: &mut Participant,
        config: &BridgeConfig,
        context: &Context,
    ) -> Result<Option<Self>, BridgeError> {
        let Some(camera) = &config.camera else { return Ok(None) };
        Ok(Some(Self {
            topics: camera::open(participant, camera)?,
            image_topic: camera.image.clone(),
            naming: config.catalogue()?.naming,
            // Frames of a later life are newer than all of an earlier one.
            next_index: u64::from(context.restarts) << 32,
            frame_id: None,
            rgb: Vec::new(),
        }))
    }

    fn poll(&mut self, outputs: &mut dyn Outputs) -> Result<Produced, NodeError> {
        let Some(picture) = self.topics.next(&mut self.rgb)? else { return Ok(Produced::Nothing) };
        let key = FrameKey { index: self.next_index, stamp_ns: picture.stamp_ns };
        self.send(outputs, key, &picture)?;
        self.next_index += 1;
        self.frame_id = Some(picture.frame_id);
        Ok(Produced::Frame(key))
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

    /// The detector's poses for the image; none without a detector.
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
}
