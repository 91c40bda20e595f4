//! A live camera: its images with their calibrations, as the driver gives them. What cannot be used is dropped and counted.

mod config;
mod watch;

pub use config::{CameraConfig, InfoMode, Transport};
pub(crate) use config::{CameraOrTopic, camera_or_topic};

use crate::ledger::Ledger;
use crate::names::Names;
use crate::sync::{Joined, PATIENCE, StampSync};
use crate::{BridgeError, Participant, sensor_qos};
use pseudoflow_edge::camera::{Lens, LensCache, read_calibration};
use pseudoflow_edge::pixels::{check_rgb, write_rgb, write_rgb_of_file};
use pseudoflow_msgs::CameraFrameHeader;
use pseudoflow_msgs::ros::{CameraInfo, CompressedImage, Header, Image, RosMessage};
use ros2_client::qos::Reliability;
use ros2_client::{Name, Subscription};
use std::time::{Duration, Instant};
use watch::{TopicState, Watch, why};

pub(crate) use watch::Offer;

/// How often publishers are looked for while none is known.
const LOOK: Duration = Duration::from_millis(50);
/// How long a raw topic may come after the compressed one of the same driver.
const RAW_GRACE: Duration = Duration::from_millis(500);

/// What stands beside the pixels of a rectified image.
#[derive(Debug)]
pub(crate) struct Picture {
    pub(crate) stamp_ns: i64,
    pub(crate) frame_id: [u8; pseudoflow_msgs::FRAME_ID_BYTES],
    pub(crate) frame_name: String,
    pub(crate) size: (u32, u32),
    pub(crate) intrinsics: [f64; 4],
}

/// An image as it came.
enum Incoming {
    Raw(Image),
    File(CompressedImage),
}

enum Images {
    /// Nobody has been found who publishes them; since when compressed ones are offered.
    Undecided {
        looked: Option<Instant>,
        compressed_since: Option<Instant>,
    },
    Raw(Subscription<Image>),
    Compressed(Subscription<CompressedImage>),
}

/// A camera's topics.
pub(crate) struct Camera {
    config: CameraConfig,
    raw: Name,
    compressed: Name,
    info: Name,
    images: Images,
    infos: Option<Subscription<CameraInfo>>,
    /// Where images take the calibration that came last.
    latest: Option<CameraInfo>,
    sync: StampSync<Incoming, CameraInfo>,
    lens: LensCache,
    scratch: Vec<u8>,
    watch: Watch,
    /// Why the last calibration did not fit an image of its stamp.
    misfit: String,
    /// Images and calibrations that came since an image went on.
    came: (u64, u64),
}

impl Camera {
    pub(crate) fn open(
        participant: &mut Participant,
        names: &Names,
        config: &CameraConfig,
    ) -> Result<Self, BridgeError> {
        let calibration = config.calibration.as_deref().map(read_calibration).transpose()?;
        // Neighbours of the images' topic as it is called in the end, remapped or not.
        let image = |name: &str| names.resolve("camera.image", name);
        let raw = image(config.raw_topic())?;
        let beside = |topic: String| names.resolve("camera.image", &topic);
        let info = match &config.camera_info {
            Some(topic) => names.resolve("camera.camera_info", topic)?,
            None => beside(CameraConfig::of_topic(&raw.to_string()).info_topic())?,
        };
        let compressed = match config.transport {
            Transport::Compressed => image(&config.image)?,
            _ => beside(CameraConfig::of_topic(&raw.to_string()).compressed_topic())?,
        };
        let infos = match &calibration {
            Some(_) => None,
            None => Some(participant.subscribe(names, &info, sensor_qos(config.queue_depth))?),
        };
        let mut camera = Self {
            raw,
            compressed,
            info,
            images: Images::Undecided { looked: None, compressed_since: None },
            infos,
            latest: calibration,
            sync: StampSync::new(config.queue_depth as usize),
            lens: LensCache::default(),
            scratch: Vec::new(),
            watch: Watch::new(Instant::now()),
            misfit: String::new(),
            came: (0, 0),
            config: config.clone(),
        };
        match config.transport {
            Transport::Raw => camera.take_raw(participant, names)?,
            Transport::Compressed => camera.take_compressed(participant, names)?,
            Transport::Auto => {}
        }
        Ok(camera)
    }

    /// The topic that images come by, as far as it is known.
    pub(crate) fn topic(&self) -> &Name {
        match self.images {
            Images::Compressed(_) => &self.compressed,
            _ => &self.raw,
        }
    }

    fn take_raw(&mut self, participant: &mut Participant, names: &Names) -> Result<(), BridgeError> {
        let qos = sensor_qos(self.config.queue_depth);
        self.images = Images::Raw(participant.subscribe(names, &self.raw, qos)?);
        log::info!("images: {} (sensor_msgs/Image)", self.raw);
        Ok(())
    }

    fn take_compressed(&mut self, participant: &mut Participant, names: &Names) -> Result<(), BridgeError> {
        let qos = sensor_qos(self.config.queue_depth);
        self.images = Images::Compressed(participant.subscribe(names, &self.compressed, qos)?);
        log::info!("images: {} (sensor_msgs/CompressedImage)", self.compressed);
        Ok(())
    }

    /// Takes whichever transport is published: raw images where there are both.
    fn decide(&mut self, participant: &mut Participant, names: &Names, now: Instant) -> Result<(), BridgeError> {
        let Images::Undecided { looked, compressed_since } = &mut self.images else { return Ok(()) };
        if looked.is_some_and(|at| now.duration_since(at) < LOOK) {
            return Ok(());
        }
        *looked = Some(now);
        let offers = |name: &Name, kind: &str| {
            participant.offers(&name.to_string()).iter().any(|offer| offer.type_name.ends_with(kind))
        };
        let raw = offers(&self.raw, "::Image_");
        let compressed = offers(&self.compressed, "::CompressedImage_");
        if compressed && compressed_since.is_none() {
            *compressed_since = Some(now);
        }
        let patient = compressed_since.is_some_and(|since| now.duration_since(since) < RAW_GRACE);
        match (raw, compressed && !patient) {
            (true, _) => self.take_raw(participant, names),
            (false, true) => self.take_compressed(participant, names),
            (false, false) => Ok(()),
        }
    }

    /// The next complete image, its pixels (R, G, B, rectified) into `rgb`; `None` when none has come.
    pub(crate) fn next(
        &mut self,
        participant: &mut Participant,
        names: &Names,
        ledger: &mut Ledger,
        rgb: &mut Vec<u8>,
    ) -> Result<Option<Picture>, BridgeError> {
        let now = Instant::now();
        self.decide(participant, names, now)?;
        self.receive(ledger);
        self.sync.expire(now);
        if let Some(picture) = self.take(rgb, ledger) {
            self.watch.image(now);
            self.came = (0, 0);
            return Ok(Some(picture));
        }
        if self.watch.is_due(now) {
            ledger.say(format!("no image: {}", why(&self.states(participant), self.sync.waiting())));
        }
        Ok(None)
    }

    fn receive(&mut self, ledger: &mut Ledger) {
        let info_topic = self.info.to_string();
        let infos = self.infos.as_ref().map_or_else(Vec::new, |infos| received(infos, &info_topic, ledger));
        for info in infos {
            self.came.1 += 1;
            self.push_info(info, &info_topic, ledger);
        }
        let topic = self.topic().to_string();
        let images: Vec<Incoming> = match &self.images {
            Images::Undecided { .. } => Vec::new(),
            Images::Raw(images) => received(images, &topic, ledger).into_iter().map(Incoming::Raw).collect(),
            Images::Compressed(images) => received(images, &topic, ledger).into_iter().map(Incoming::File).collect(),
        };
        for image in images {
            self.came.0 += 1;
            match image.check() {
                Ok(stamp_ns) => self.push_image(stamp_ns, image, &topic, ledger),
                Err((kind, cause)) => ledger.drop(&topic, kind, cause),
            }
        }
        let alone =
            |other: &str| format!("nothing of the same stamp on {other} within {PATIENCE:?}, or newer ones went on");
        let [images, infos] = self.sync.take_dropped();
        for (topic, other, dropped) in [(&topic, &info_topic, images), (&info_topic, &topic, infos)] {
            ledger.drop_many(topic, "unpaired", dropped.alone, alone(other));
            ledger.drop_many(topic, "calibration", dropped.misfits, &self.misfit);
        }
    }

    fn push_info(&mut self, info: CameraInfo, topic: &str, ledger: &mut Ledger) {
        let stamp_ns = match stamp_of(&info.header) {
            Ok(stamp_ns) => stamp_ns,
            Err(cause) => return ledger.drop(topic, "stamp", cause),
        };
        if let Err(cause) = Lens::check(&info, self.config.rectified) {
            return ledger.drop(topic, "calibration", cause);
        }
        match self.config.info {
            InfoMode::Exact => self.sync.push_info(stamp_ns, info),
            InfoMode::Latest => self.latest = Some(info),
        }
    }

    fn push_image(&mut self, stamp_ns: i64, image: Incoming, topic: &str, ledger: &mut Ledger) {
        let exact = self.config.info == InfoMode::Exact && self.infos.is_some();
        match &self.latest {
            _ if exact => self.sync.push_image(stamp_ns, image),
            Some(info) => {
                self.sync.push_info(stamp_ns, info.clone());
                self.sync.push_image(stamp_ns, image);
            }
            None => ledger.drop(topic, "no calibration", format!("nothing has come on {} yet", self.info)),
        }
    }

    /// The oldest image that can be used with a calibration that can be used.
    fn take(&mut self, rgb: &mut Vec<u8>, ledger: &mut Ledger) -> Option<Picture> {
        let topic = self.topic().to_string();
        let Self { sync, lens, scratch, misfit, config, .. } = self;
        sync.take(|stamp_ns, image, info| {
            let size = match image.decode(rgb) {
                Ok(size) => size,
                Err(cause) => {
                    ledger.drop(&topic, "image", cause);
                    return Joined::BadImage;
                }
            };
            match lens.lens(info, size, config.rectified) {
                Ok(lens) => {
                    lens.rectify(rgb, scratch);
                    let frame_name = image.header().frame_id.clone();
                    // One that does not fit has been refused when it came.
                    let Some(frame_id) = CameraFrameHeader::frame_id_bytes(&frame_name) else {
                        return Joined::BadImage;
                    };
                    Joined::Whole(Picture { stamp_ns, frame_id, frame_name, size, intrinsics: lens.intrinsics() })
                }
                Err(cause) => {
                    *misfit = cause.to_string();
                    Joined::Apart
                }
            }
        })
    }

    /// What is known of the camera's topics, for the log.
    fn states(&self, participant: &Participant) -> Vec<TopicState> {
        let state = |name: &Name, wanted, reliable, came| TopicState {
            name: name.to_string(),
            wanted,
            offers: participant.offers(&name.to_string()),
            reliable,
            came,
        };
        let reliable = |qos: Option<Reliability>| matches!(qos, Some(Reliability::Reliable { .. }));
        let of = |name: &Name| reliable(participant.requested(name));
        let images = match &self.images {
            Images::Compressed(_) => ("sensor_msgs/CompressedImage", &self.compressed),
            _ => ("sensor_msgs/Image", &self.raw),
        };
        let mut states = vec![state(images.1, images.0, of(images.1), self.came.0)];
        if self.infos.is_some() {
            states.push(state(&self.info, "sensor_msgs/CameraInfo", of(&self.info), self.came.1));
        }
        states
    }
}

impl Incoming {
    fn header(&self) -> &Header {
        match self {
            Self::Raw(image) => &image.header,
            Self::File(image) => &image.header,
        }
    }

    /// The stamp; what can be seen to be wrong without looking at the pixels otherwise, in a word and in whole.
    fn check(&self) -> Result<i64, (&'static str, String)> {
        let stamp_ns = stamp_of(self.header()).map_err(|cause| ("stamp", cause))?;
        let name = &self.header().frame_id;
        if CameraFrameHeader::frame_id_bytes(name).is_none() {
            return Err(("frame_id", format!("`{name}` is longer than 63 bytes: shorten it in the driver")));
        }
        match self {
            Self::Raw(image) => check_rgb(image).map_err(|cause| ("image", cause.to_string()))?,
            Self::File(_) => {}
        }
        Ok(stamp_ns)
    }

    fn decode(&self, rgb: &mut Vec<u8>) -> Result<(u32, u32), pseudoflow_edge::pixels::PixelError> {
        match self {
            Self::Raw(image) => write_rgb(image, rgb),
            Self::File(image) => write_rgb_of_file(image, rgb),
        }
    }
}

/// The stamp of a message, which recordings can hold.
pub(crate) fn stamp_of(header: &Header) -> Result<i64, String> {
    let stamp = header.stamp;
    if stamp.sec < 0 || stamp.nanosec >= 1_000_000_000 {
        return Err(format!("{} s {} ns is no stamp since 1970", stamp.sec, stamp.nanosec));
    }
    Ok(stamp.as_ns())
}

/// All messages that wait; those that cannot be read are counted.
pub(crate) fn received<M: RosMessage>(subscription: &Subscription<M>, topic: &str, ledger: &mut Ledger) -> Vec<M> {
    /// Enough for any queue: a topic that never ends must not keep the others from being read.
    const MOST_AT_ONCE: usize = 256;
    let mut messages = Vec::new();
    for _ in 0..MOST_AT_ONCE {
        match subscription.take() {
            Ok(Some((message, _))) => messages.push(message),
            Ok(None) => return messages,
            Err(error) => ledger.drop(topic, "unreadable", error),
        }
    }
    messages
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_msgs::ros::Time;

    #[test]
    fn stamps_before_the_epoch_and_broken_ones_are_refused() {
        let of = |sec, nanosec| stamp_of(&Header { stamp: Time { sec, nanosec }, frame_id: String::new() });
        assert_eq!(of(3, 4), Ok(3_000_000_004));
        assert!(of(-1, 0).is_err() && of(0, u32::MAX).is_err());
    }
}
