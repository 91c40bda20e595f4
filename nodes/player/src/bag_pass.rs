//! What the pass that opens a bag collects of images, cameras and detections, and what it finds wrong with them.

use crate::{BagOptions, PlayerError};
use pseudoflow_bag::Visited;
use pseudoflow_edge::camera::Lens;
use pseudoflow_edge::pixels::check_rgb;
use pseudoflow_imaging::image_size;
use pseudoflow_msgs::CameraFrameHeader;
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection2DArray, Detection3DArray, Header, Image, RosMessage, from_cdr, object_poses,
};
use std::collections::BTreeMap;
use std::path::Path;

/// An image on the pass.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SeenImage {
    pub(crate) stamp_ns: i64,
    pub(crate) size_px: (u32, u32),
}

/// The cameras of a topic.
#[derive(Debug, Default)]
pub(crate) struct Cameras {
    /// Stamp and calibration (number in `calibrations`) of each message.
    pub(crate) messages: Vec<(i64, usize)>,
    /// Each calibration once, without its header.
    pub(crate) calibrations: Vec<CameraInfo>,
}

impl Cameras {
    fn add(&mut self, info: CameraInfo) {
        let stamp_ns = info.header.stamp.as_ns();
        let info = CameraInfo { header: Header::default(), ..info };
        // Most recordings have one calibration; the last is looked at first.
        let number = self.calibrations.iter().rposition(|known| *known == info).unwrap_or_else(|| {
            self.calibrations.push(info);
            self.calibrations.len() - 1
        });
        self.messages.push((stamp_ns, number));
    }
}

/// All topics of the types that could be played, since which of them are is known at the end only.
pub(crate) struct Pass<'a> {
    options: &'a BagOptions,
    pub(crate) images: BTreeMap<String, Vec<SeenImage>>,
    pub(crate) cameras: BTreeMap<String, Cameras>,
    /// Message of each stamp on the topic of initial poses.
    pub(crate) poses: BTreeMap<i64, usize>,
    /// And on that of rectangles.
    pub(crate) rectangles: BTreeMap<i64, usize>,
    /// Objects of the initial poses and the first stamp of each.
    pub(crate) objects: BTreeMap<u32, i64>,
    /// The first thing wrong with each topic: an error only if the topic is played.
    wrong: BTreeMap<String, Wrong>,
}

struct Wrong {
    number: usize,
    cause: Box<dyn std::error::Error + Send + Sync>,
}

impl<'a> Pass<'a> {
    pub(crate) fn new(options: &'a BagOptions) -> Self {
        let (images, cameras, poses) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let rectangles = BTreeMap::new();
        Self { options, images, cameras, poses, rectangles, objects: BTreeMap::new(), wrong: BTreeMap::new() }
    }

    pub(crate) fn visit(&mut self, visited: &Visited<'_>) {
        let (topic, number) = (&visited.topic.name, visited.number);
        if let Err(cause) = self.look_at(topic, &visited.topic.type_name, number, visited.message.data) {
            self.wrong.entry(topic.clone()).or_insert(Wrong { number, cause });
        }
    }

    fn look_at(
        &mut self,
        topic: &str,
        type_name: &str,
        number: usize,
        data: &[u8],
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        if type_name == CompressedImage::type_name() {
            let message: CompressedImage = from_cdr(data)?;
            let size_px = image_size(&message.data, &format!("CompressedImage of format `{}`", message.format))?;
            self.image(topic, &message.header, size_px)
        } else if type_name == Image::type_name() {
            let message: Image = from_cdr(data)?;
            check_rgb(&message)?;
            self.image(topic, &message.header, (message.width, message.height))
        } else if type_name == CameraInfo::type_name() {
            let info: CameraInfo = from_cdr(data)?;
            Lens::check(&info, self.options.rectified)?;
            self.cameras.entry(topic.to_owned()).or_default().add(info);
            Ok(())
        } else if self.options.poses_topic.as_deref() == Some(topic) && type_name == Detection3DArray::type_name() {
            self.detections(number, &from_cdr(data)?)
        } else if self.options.rectangles_topic.as_deref() == Some(topic) && type_name == Detection2DArray::type_name()
        {
            let array: Detection2DArray = from_cdr(data)?;
            self.rectangles.insert(array.header.stamp.as_ns(), number);
            Ok(())
        } else {
            Ok(())
        }
    }

    fn image(
        &mut self,
        topic: &str,
        header: &Header,
        size_px: (u32, u32),
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        if size_px.0 == 0 || size_px.1 == 0 {
            return Err("the image has no pixels: record it again".into());
        }
        if CameraFrameHeader::frame_id_bytes(&header.frame_id).is_none() {
            return Err(format!("header.frame_id `{}` is longer than 63 bytes: shorten it", header.frame_id).into());
        }
        self.images.entry(topic.to_owned()).or_default().push(SeenImage { stamp_ns: header.stamp.as_ns(), size_px });
        Ok(())
    }

    fn detections(
        &mut self,
        number: usize,
        array: &Detection3DArray,
    ) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let stamp_ns = array.header.stamp.as_ns();
        let (poses, errors) = object_poses(array, &self.options.naming);
        if let Some(error) = errors.into_iter().next() {
            return Err(error.into());
        }
        for pose in &poses {
            self.objects.entry(pose.object_id).or_insert(stamp_ns);
        }
        self.poses.insert(stamp_ns, number);
        Ok(())
    }

    /// The first thing wrong with one of the topics that are played.
    pub(crate) fn refuse(&mut self, path: &Path, topics: [Option<&String>; 4]) -> Result<(), PlayerError> {
        for topic in topics.into_iter().flatten() {
            if let Some(Wrong { number, cause }) = self.wrong.remove(topic) {
                return Err(PlayerError::Message { path: path.to_owned(), topic: topic.clone(), number, cause });
            }
        }
        Ok(())
    }
}
