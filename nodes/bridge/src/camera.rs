use crate::decode::CameraImage;
use crate::sync::{Complete, StampSync};
use crate::{BridgeError, CameraConfig, Participant, Transport, participant::topic_name, sensor_qos};
use pseudoflow_edge::camera::LensCache;
use pseudoflow_msgs::ros::{CameraInfo, CompressedImage, Detection3DArray, Image, RosMessage};
use ros2_client::Subscription;

/// What stands beside the pixels of a decoded image.
#[derive(Debug)]
pub(crate) struct Picture {
    pub(crate) stamp_ns: i64,
    pub(crate) frame_id: String,
    pub(crate) size: (u32, u32),
    pub(crate) intrinsics: [f64; 4],
    pub(crate) detections: Option<Detection3DArray>,
}

/// A camera's topics.
pub(crate) trait Camera {
    /// The next complete image, its pixels (R, G, B) into `rgb`; `None` when none has come.
    fn next(&mut self, rgb: &mut Vec<u8>) -> Result<Option<Picture>, BridgeError>;
}

/// Subscribes to the topics of the configuration.
pub(crate) fn open(participant: &mut Participant, config: &CameraConfig) -> Result<Box<dyn Camera>, BridgeError> {
    Ok(match config.transport {
        Transport::Raw => Box::new(Topics::<Image>::open(participant, config)?),
        Transport::Compressed => Box::new(Topics::<CompressedImage>::open(participant, config)?),
    })
}

struct Topics<M: CameraImage> {
    config: CameraConfig,
    images: Subscription<M>,
    infos: Subscription<CameraInfo>,
    detections: Option<Subscription<Detection3DArray>>,
    sync: StampSync<M, CameraInfo, Detection3DArray>,
    warned_at: u64,
    lens: LensCache,
    scratch: Vec<u8>,
}

impl<M: CameraImage> Topics<M> {
    fn open(participant: &mut Participant, config: &CameraConfig) -> Result<Self, BridgeError> {
        let qos = sensor_qos(config.queue_depth);
        let detections = match &config.detections {
            Some(topic) => Some(participant.subscription(&topic_name("camera.detections", topic)?, &qos)?),
            None => None,
        };
        Ok(Self {
            images: participant.subscription(&topic_name("camera.image", &config.image)?, &qos)?,
            infos: participant.subscription(&topic_name("camera.camera_info", &config.camera_info)?, &qos)?,
            sync: StampSync::new(config.queue_depth as usize, detections.is_some()),
            detections,
            config: config.clone(),
            warned_at: 0,
            lens: LensCache::default(),
            scratch: Vec::new(),
        })
    }

    fn receive(&mut self) {
        for image in received(&self.images, &self.config.image) {
            self.sync.push_image(image.header().stamp.as_ns(), image);
        }
        for info in received(&self.infos, &self.config.camera_info) {
            self.sync.push_info(info.header.stamp.as_ns(), info);
        }
        if let (Some(detections), Some(topic)) = (&self.detections, &self.config.detections) {
            for array in received(detections, topic) {
                self.sync.push_extra(array.header.stamp.as_ns(), array);
            }
        }
        self.warn_of_dropped();
    }

    /// Says at the 1st, 2nd, 4th, 8th ... image dropped what was missing.
    fn warn_of_dropped(&mut self) {
        if self.sync.dropped() >= (self.warned_at * 2).max(1) {
            self.warned_at = self.sync.dropped();
            let CameraConfig { image, camera_info, detections, .. } = &self.config;
            let with = detections.as_ref().map_or(camera_info.clone(), |d| format!("{camera_info} and {d}"));
            log::warn!("{} images of {image} dropped: nothing of the same stamp on {with} in time", self.warned_at);
        }
    }

    fn picture(
        &mut self,
        set: Complete<M, CameraInfo, Detection3DArray>,
        rgb: &mut Vec<u8>,
    ) -> Result<Picture, BridgeError> {
        let size = set.image.decode(rgb)?;
        let lens = self.lens.lens(&set.info, size, self.config.rectified);
        let lens = lens.map_err(|cause| BridgeError::Intrinsics { topic: self.config.camera_info.clone(), cause })?;
        let intrinsics = lens.intrinsics();
        lens.rectify(rgb, &mut self.scratch);
        let frame_id = set.image.header().frame_id.clone();
        Ok(Picture { stamp_ns: set.stamp_ns, frame_id, size, intrinsics, detections: set.extra })
    }
}

impl<M: CameraImage> Camera for Topics<M> {
    fn next(&mut self, rgb: &mut Vec<u8>) -> Result<Option<Picture>, BridgeError> {
        self.receive();
        let Some(set) = self.sync.take() else { return Ok(None) };
        let stamp_ns = set.stamp_ns;
        match self.picture(set, rgb) {
            // One damaged file is no reason to stop a camera.
            Err(error @ BridgeError::Image(_)) => {
                log::warn!("{}: image of {stamp_ns} ns skipped: {error}", self.config.image);
                Ok(None)
            }
            other => other.map(Some),
        }
    }
}

/// All messages that wait; those that cannot be read are logged.
fn received<M: RosMessage>(subscription: &Subscription<M>, topic: &str) -> Vec<M> {
    let mut messages = Vec::new();
    loop {
        match subscription.take() {
            Ok(Some((message, _))) => messages.push(message),
            Ok(None) => return messages,
            Err(error) => {
                log::warn!("{topic}: a message could not be read: {error}");
                return messages;
            }
        }
    }
}
