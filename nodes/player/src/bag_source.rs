use crate::bag_pass::{Cameras, Pass, SeenImage};
use crate::source::{FrameFacts, check_sizes};
use crate::{FrameSource, LoadedFrame, PlayerError};
use pseudoflow_bag::{BagReader, TopicInfo, TopicNumber};
use pseudoflow_edge::camera::{LensCache, image_size_px};
use pseudoflow_edge::pixels::{write_rgb, write_rgb_of_file};
use pseudoflow_edge::rectangle_of;
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection2DArray, Detection3DArray, Image, Naming, RosMessage, object_poses,
};
use pseudoflow_msgs::{CameraFrameHeader, FRAME_ID_BYTES, ObjectPose, Rectangle};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which topics of a bag are played.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BagOptions {
    /// Topic of the images; without: the only one of an image type.
    pub image_topic: Option<String>,
    /// Topic of the CameraInfo; without: the only one of its type.
    pub camera_info_topic: Option<String>,
    /// Topic of initial poses (Detection3DArray); none without.
    pub poses_topic: Option<String>,
    /// Topic of a detector's rectangles (Detection2DArray); none without.
    pub rectangles_topic: Option<String>,
    /// Whether the images are rectified already, so that P holds instead of K and D.
    pub rectified: bool,
    /// The camera of all images, instead of a CameraInfo topic.
    pub calibration: Option<CameraInfo>,
    /// Names of objects in the detections.
    pub naming: Naming,
}

/// A rosbag2 recording. Opened once whole: every checksum, image size, camera and detection is looked at before the
/// first frame, so that what cannot be played is refused before anything is written.
#[derive(Debug)]
pub struct BagSource {
    reader: BagReader,
    path: PathBuf,
    images: (TopicNumber, bool),
    poses_topic: Option<TopicNumber>,
    rectangles_topic: Option<TopicNumber>,
    naming: Naming,
    frames: Vec<Frame>,
    calibrations: Vec<CameraInfo>,
    rectified: bool,
    lens: LensCache,
    scratch: Vec<u8>,
    objects: BTreeMap<u32, usize>,
    /// `(scene, image)` of each frame where the bag was made from a BOP scene.
    bop_ids: Vec<(u32, u32)>,
}

#[derive(Debug)]
struct Frame {
    stamp_ns: i64,
    intrinsics: [f64; 4],
    /// Number of its camera in the source's `calibrations`.
    calibration: usize,
    /// Message of the poses topic with the image's stamp.
    poses: Option<usize>,
    /// And of the rectangles topic.
    rectangles: Option<usize>,
}

impl BagSource {
    /// Opens and checks a bag.
    ///
    /// # Errors
    /// When it is damaged, topics are missing or ambiguous, an image has no camera, a camera no intrinsics, or the
    /// images' size changes or is not the camera's.
    pub fn open(path: &Path, options: &BagOptions) -> Result<Self, PlayerError> {
        let mut pass = Pass::new(options);
        let reader = BagReader::open_visiting(path, &mut |visited| {
            pass.visit(&visited);
            Ok(())
        })?;
        let compressed = CompressedImage::type_name();
        let image_types = [Image::type_name(), compressed.clone()];
        let image_topic = choose(&reader, options.image_topic.as_deref(), &image_types, "image_topic")?;
        let info_topic = match options.calibration {
            Some(_) => None,
            None => {
                let types = [CameraInfo::type_name()];
                Some(choose(&reader, options.camera_info_topic.as_deref(), &types, "camera_info_topic")?)
            }
        };
        let poses_types = [Detection3DArray::type_name()];
        let poses_topic = options.poses_topic.as_deref().map(|name| reader.topic(name, &poses_types)).transpose()?;
        let types = [Detection2DArray::type_name()];
        let rectangles_topic =
            options.rectangles_topic.as_deref().map(|name| reader.topic(name, &types)).transpose()?;
        pass.refuse(
            path,
            [Some(&image_topic), info_topic.as_ref(), options.poses_topic.as_ref(), options.rectangles_topic.as_ref()],
        )?;

        let cameras = match (&options.calibration, &info_topic) {
            (Some(info), _) => Cameras { messages: vec![(i64::MIN, 0)], calibrations: vec![info.clone()] },
            (None, Some(topic)) => pass.cameras.remove(topic).unwrap_or_default(),
            (None, None) => Cameras::default(),
        };
        let info_topic = info_topic.unwrap_or_else(|| "calibration".to_owned());
        let images = pass.images.get(&image_topic).map(Vec::as_slice).unwrap_or_default();
        let paired = pair(path, &info_topic, images, &cameras.messages)?;
        // CameraInfo may leave its size 0.
        let stated = |camera: usize| Some(image_size_px(&cameras.calibrations[camera])).filter(|size| *size != (0, 0));
        check_sizes(paired.iter().map(|(image, camera)| (path.to_owned(), image.size_px, stated(*camera))))?;
        let mut lens = LensCache::default();
        let mut frame = |(number, (image, camera)): (usize, &(&SeenImage, usize))| {
            let made = lens.lens(&cameras.calibrations[*camera], image.size_px, options.rectified);
            let intrinsics = made.map(|lens| lens.intrinsics()).map_err(|cause| PlayerError::Message {
                path: path.to_owned(),
                topic: info_topic.clone(),
                number,
                cause: cause.into(),
            })?;
            let poses = pass.poses.get(&image.stamp_ns).copied();
            let rectangles = pass.rectangles.get(&image.stamp_ns).copied();
            Ok(Frame { stamp_ns: image.stamp_ns, intrinsics, calibration: *camera, poses, rectangles })
        };
        let frames: Vec<Frame> = paired.iter().enumerate().map(&mut frame).collect::<Result<_, PlayerError>>()?;
        let number = reader.topic(&image_topic, &image_types)?;
        Ok(Self {
            images: (number, reader.topics()[number].type_name == compressed),
            bop_ids: bop_ids(&reader),
            objects: pass.objects.iter().map(|(id, stamp_ns)| (*id, frame_of(&frames, *stamp_ns))).collect(),
            frames,
            calibrations: cameras.calibrations,
            rectified: options.rectified,
            lens,
            scratch: Vec::new(),
            poses_topic,
            rectangles_topic,
            naming: options.naming.clone(),
            path: path.to_owned(),
            reader,
        })
    }

    fn decode(&mut self, number: usize) -> Result<(u32, u32, String, Vec<u8>), PlayerError> {
        let failed = |path: &Path, cause: String| PlayerError::Image { path: path.to_owned(), number, cause };
        let (topic, compressed) = self.images;
        if compressed {
            let message: CompressedImage = self.reader.read(topic, number)?;
            let mut rgb = Vec::new();
            let size = write_rgb_of_file(&message, &mut rgb).map_err(|error| failed(&self.path, error.to_string()))?;
            return Ok((size.0, size.1, message.header.frame_id, rgb));
        }
        let message: Image = self.reader.read(topic, number)?;
        let mut rgb = Vec::new();
        write_rgb(&message, &mut rgb).map_err(|error| failed(&self.path, error.to_string()))?;
        Ok((message.width, message.height, message.header.frame_id, rgb))
    }

    fn ids(&self, number: usize) -> (u32, u32) {
        self.bop_ids.get(number).copied().unwrap_or((0, number as u32))
    }

    fn rectangles_of(&mut self, frame: usize, size: (u32, u32)) -> Result<Vec<Rectangle>, PlayerError> {
        let (Some(topic), Some(number)) = (self.rectangles_topic, self.frames[frame].rectangles) else {
            return Ok(Vec::new());
        };
        let array: Detection2DArray = self.reader.read(topic, number)?;
        let read = |detection| rectangle_of(detection, size, &self.naming);
        array.detections.iter().map(read).collect::<Result<_, _>>().map_err(|cause| PlayerError::Message {
            path: self.path.clone(),
            topic: self.reader.topics()[topic].name.clone(),
            number,
            cause: cause.into(),
        })
    }

    fn poses_of(&mut self, frame: usize) -> Result<Vec<ObjectPose>, PlayerError> {
        let (Some(topic), Some(number)) = (self.poses_topic, self.frames[frame].poses) else { return Ok(Vec::new()) };
        let array: Detection3DArray = self.reader.read(topic, number)?;
        Ok(object_poses(&array, &self.naming).0)
    }
}

/// Ids that `bag from-bop` keeps in the bag; none in other bags.
fn bop_ids(reader: &BagReader) -> Vec<(u32, u32)> {
    let text = reader.custom_data().get(crate::from_bop::IDS_KEY);
    text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
}

fn frame_of(frames: &[Frame], stamp_ns: i64) -> usize {
    frames.iter().position(|frame| frame.stamp_ns == stamp_ns).unwrap_or_default()
}

/// The named topic, or the only one of the types.
fn choose(reader: &BagReader, named: Option<&str>, types: &[String], key: &'static str) -> Result<String, PlayerError> {
    if let Some(name) = named {
        reader.topic(name, types)?;
        return Ok(name.to_owned());
    }
    // An overlay that a recorder of ours drew is no camera.
    let fits = |t: &&TopicInfo| types.contains(&t.type_name) && !t.name.starts_with("/overlay");
    let fitting: Vec<_> = reader.topics().iter().filter(fits).collect();
    let (path, types, topics) = (reader.path().to_owned(), types.join(" or "), reader.described());
    match fitting.as_slice() {
        [only] => {
            reader.topic(&only.name, std::slice::from_ref(&only.type_name))?;
            Ok(only.name.clone())
        }
        [] => Err(PlayerError::NoTopic { path, types, key, topics }),
        several => Err(PlayerError::Topic { path, found: several.len(), types, key, topics }),
    }
}

/// Each image with the camera of its stamp, or the last one before it (drivers may send CameraInfo less often).
fn pair<'a>(
    path: &Path,
    topic: &str,
    images: &'a [SeenImage],
    cameras: &[(i64, usize)],
) -> Result<Vec<(&'a SeenImage, usize)>, PlayerError> {
    let by_stamp: BTreeMap<i64, usize> = cameras.iter().copied().collect();
    let with_camera = |(number, image): (usize, &'a SeenImage)| match by_stamp.range(..=image.stamp_ns).next_back() {
        Some((_, camera)) => Ok((image, *camera)),
        None => Err(PlayerError::NoCameraInfo {
            path: path.to_owned(),
            number,
            stamp_ns: image.stamp_ns,
            topic: topic.to_owned(),
        }),
    };
    images.iter().enumerate().map(with_camera).collect()
}

impl FrameSource for BagSource {
    fn count(&self) -> usize {
        self.frames.len()
    }

    fn objects(&self) -> BTreeMap<u32, usize> {
        self.objects.clone()
    }

    fn facts(&mut self, number: usize) -> Result<FrameFacts, PlayerError> {
        let (scene_id, image_id) = self.ids(number);
        let intrinsics = self.frames[number].intrinsics;
        Ok(FrameFacts { scene_id, image_id, intrinsics, initial_poses: self.poses_of(number)? })
    }

    fn load(&mut self, number: usize) -> Result<LoadedFrame, PlayerError> {
        let Frame { stamp_ns, intrinsics, calibration, .. } = self.frames[number];
        let (width, height, name, mut rgb) = self.decode(number)?;
        let lens = self.lens.lens(&self.calibrations[calibration], (width, height), self.rectified);
        let lens =
            lens.map_err(|cause| PlayerError::Image { path: self.path.clone(), number, cause: cause.to_string() })?;
        lens.rectify(&mut rgb, &mut self.scratch);
        let rectangles = self.rectangles_of(number, (width, height))?;
        let frame_id = CameraFrameHeader::frame_id_bytes(&name).unwrap_or([0; FRAME_ID_BYTES]); // checked on the pass
        let (scene_id, image_id) = self.ids(number);
        let header = CameraFrameHeader { width, height, scene_id, image_id, intrinsics, frame_id };
        Ok(LoadedFrame { stamp_ns, header, rgb, initial_poses: self.poses_of(number)?, rectangles })
    }
}
