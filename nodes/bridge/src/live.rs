//! The bridge as the source of a live graph: a camera's images as frames, and what detectors say about them.

use crate::camera::{Camera, Picture, received, stamp_of};
use crate::detections::{Answer, Matcher, Memory, Remembered};
use crate::ledger::Ledger;
use crate::names::Names;
use crate::node::{DETECTED, FOUND, FRAME, INITIAL_POSES};
use crate::{BridgeConfig, BridgeError, CameraConfig, Participant, sensor_qos};
use pseudoflow_msgs::ros::{Detection2DArray, Detection3DArray, Naming, RosMessage};
use pseudoflow_msgs::{CameraFrame, CameraFrameHeader, DetectedFrame, FrameKey, ObjectPose, ObjectPoses};
use pseudoflow_runtime::{Context, NodeError, Outputs, Port, Produced};
use ros2_client::{Name, Subscription};
use std::collections::VecDeque;

/// Most memory for images that wait for a detection.
const MOST_WAITING_BYTES: usize = 256 << 20;

/// What the outside is heard with.
pub(crate) struct Ears<'a> {
    pub(crate) participant: &'a mut Participant,
    pub(crate) names: &'a Names,
    pub(crate) naming: &'a Naming,
    pub(crate) ledger: &'a mut Ledger,
}

/// A camera and its detectors.
pub(crate) struct LiveCamera {
    camera: Camera,
    detections: Option<Detector<Detection3DArray>>,
    rectangles: Option<Detector<Detection2DArray>>,
    memory: Memory,
    /// Where the graph joins frames with initial poses: images whose detections have not come.
    waiting: VecDeque<Waiting>,
    next_index: u64,
    /// Optical frame of the newest image.
    frame_id: Option<String>,
    rgb: Vec<u8>,
}

struct Waiting {
    key: FrameKey,
    picture: Picture,
    rgb: Vec<u8>,
}

struct Detector<M> {
    topic: Name,
    subscription: Subscription<M>,
    matcher: Matcher<M>,
}

impl<M: RosMessage + Answer> Detector<M> {
    fn open(
        participant: &mut Participant,
        names: &Names,
        field: &'static str,
        topic: Option<&String>,
        camera: &CameraConfig,
    ) -> Result<Option<Self>, BridgeError> {
        let Some(topic) = topic else { return Ok(None) };
        let topic = names.resolve(field, topic)?;
        let subscription = participant.subscribe(names, &topic, sensor_qos(camera.queue_depth))?;
        let matcher = Matcher::new(topic.to_string(), camera.memory_s);
        Ok(Some(Self { topic, subscription, matcher }))
    }

    fn receive(&mut self, ledger: &mut Ledger) {
        let topic = self.topic.to_string();
        for answer in received(&self.subscription, &topic, ledger) {
            match stamp_of(answer.header()) {
                Ok(_) => self.matcher.push(answer, ledger),
                Err(cause) => ledger.drop(&topic, "stamp", cause),
            }
        }
    }
}

impl LiveCamera {
    pub(crate) fn open(
        participant: &mut Participant,
        names: &Names,
        config: &BridgeConfig,
        context: &Context,
    ) -> Result<Option<Self>, BridgeError> {
        let Some(camera) = &config.camera else { return Ok(None) };
        let (poses, rectangles) = (camera.detections.as_ref(), camera.rectangles.as_ref());
        Ok(Some(Self {
            camera: Camera::open(participant, names, camera)?,
            detections: Detector::open(participant, names, "camera.detections", poses, camera)?,
            rectangles: Detector::open(participant, names, "camera.rectangles", rectangles, camera)?,
            memory: Memory::new(camera.memory_s),
            waiting: VecDeque::new(),
            // Frames of a later life are newer than all of an earlier one.
            next_index: u64::from(context.restarts) << 32,
            frame_id: None,
            rgb: Vec::new(),
        }))
    }

    /// Optical frame of the newest image.
    pub(crate) fn frame_id(&self) -> Option<&str> {
        self.frame_id.as_deref()
    }

    pub(crate) fn poll(&mut self, ears: &mut Ears<'_>, outputs: &mut dyn Outputs) -> Result<Produced, NodeError> {
        if let Some(detector) = &mut self.detections {
            detector.receive(ears.ledger);
        }
        if let Some(detector) = &mut self.rectangles {
            detector.receive(ears.ledger);
        }
        let joined = self.detections.is_some() && outputs.is_connected(INITIAL_POSES.name());
        let next = self.camera.next(ears.participant, ears.names, ears.ledger, &mut self.rgb)?;
        let keep_pixels = self.rectangles.is_some() && outputs.is_connected(DETECTED.name());
        let fresh = next.map(|picture| (self.admit(&picture, keep_pixels), picture));
        self.send_rectangles(ears, outputs)?;
        if joined {
            if let Some((key, picture)) = fresh {
                self.wait(key, picture);
            }
            return self.send_detected(ears, outputs);
        }
        self.send_found(ears, outputs)?;
        let Some((key, picture)) = fresh else { return Ok(Produced::Nothing) };
        send_frame(outputs, key, &picture, &self.rgb)?;
        send_poses(outputs, &INITIAL_POSES, key, &[])?;
        Ok(Produced::Frame(key))
    }

    /// The key of a new image, which is remembered.
    fn admit(&mut self, picture: &Picture, keep_pixels: bool) -> FrameKey {
        let key = FrameKey { index: self.next_index, stamp_ns: picture.stamp_ns };
        self.next_index += 1;
        self.frame_id = Some(picture.frame_name.clone());
        let rgb = keep_pixels.then(|| self.rgb.clone());
        self.memory.remember(Remembered { key, header: header(key, picture), rgb });
        key
    }

    fn wait(&mut self, key: FrameKey, picture: Picture) {
        self.waiting.push_back(Waiting { key, picture, rgb: self.rgb.clone() });
        let bytes = |waiting: &VecDeque<Waiting>| waiting.iter().map(|w| w.rgb.len()).sum::<usize>();
        while bytes(&self.waiting) > MOST_WAITING_BYTES {
            self.waiting.pop_front();
        }
        let memory = &self.memory;
        self.waiting.retain(|waiting| memory.holds(waiting.key));
    }

    /// Where frames are joined with initial poses: the image of the next answer goes on with it. Images before it get none.
    fn send_detected(&mut self, ears: &mut Ears<'_>, outputs: &mut dyn Outputs) -> Result<Produced, NodeError> {
        let Some(detector) = &mut self.detections else { return Ok(Produced::Nothing) };
        while let Some((key, poses)) = detector.matcher.take(&self.memory, ears.naming, ears.ledger) {
            let Some(at) = self.waiting.iter().position(|waiting| waiting.key == key) else {
                ears.ledger.drop(&detector.topic.to_string(), "overtaken", "an answer for a later image came before");
                continue;
            };
            let Some(Waiting { key, picture, rgb }) = self.waiting.drain(..=at).next_back() else { continue };
            send_frame(outputs, key, &picture, &rgb)?;
            send_poses(outputs, &INITIAL_POSES, key, &poses)?;
            return Ok(Produced::Frame(key));
        }
        Ok(Produced::Nothing)
    }

    fn send_found(&mut self, ears: &mut Ears<'_>, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let Some(detector) = &mut self.detections else { return Ok(()) };
        while let Some((key, poses)) = detector.matcher.take(&self.memory, ears.naming, ears.ledger) {
            send_poses(outputs, &FOUND, key, &poses)?;
        }
        Ok(())
    }

    fn send_rectangles(&mut self, ears: &mut Ears<'_>, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
        let Some(detector) = &mut self.rectangles else { return Ok(()) };
        while let Some((key, found)) = detector.matcher.take(&self.memory, ears.naming, ears.ledger) {
            let Some(Remembered { header, rgb: Some(rgb), .. }) = self.memory.image_of(key) else { continue };
            DETECTED.send(outputs, key, DetectedFrame::byte_len(header, found.len()), &mut |bytes| {
                DetectedFrame::write(bytes, *header, &found, rgb);
            })?;
        }
        Ok(())
    }
}

fn header(key: FrameKey, picture: &Picture) -> CameraFrameHeader {
    let (width, height) = picture.size;
    let (image_id, intrinsics, frame_id) = (key.index as u32, picture.intrinsics, picture.frame_id);
    CameraFrameHeader { width, height, scene_id: 0, image_id, intrinsics, frame_id }
}

fn send_frame(outputs: &mut dyn Outputs, key: FrameKey, picture: &Picture, rgb: &[u8]) -> Result<(), NodeError> {
    let header = header(key, picture);
    FRAME.send(outputs, key, CameraFrame::byte_len(header.width, header.height), &mut |bytes| {
        CameraFrame::write(bytes, header).rgb.copy_from_slice(rgb);
    })
}

fn send_poses(
    outputs: &mut dyn Outputs,
    port: &Port<ObjectPoses<'static>>,
    key: FrameKey,
    poses: &[ObjectPose],
) -> Result<(), NodeError> {
    port.send(outputs, key, ObjectPoses::byte_len(poses.len()), &mut |bytes| {
        ObjectPoses::write(bytes, 0, key.index as u32, poses);
    })
}
