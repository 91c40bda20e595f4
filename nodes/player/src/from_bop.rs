use crate::PlayerError;
use crate::bop_source::{FRAME_ID, check_frame_sizes, object_poses, stamp_ns};
use pseudoflow_bag::{BagError, BagWriter, Packing, Partial, Qos, TopicId};
use pseudoflow_imaging::{BopFrame, BopScene, ImagingError};
use pseudoflow_msgs::ros::{CameraInfo, CompressedImage, Detection3DArray, Header, Naming, Time, detections};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Key under which the bag keeps `[scene, image]` of each frame.
pub(crate) const IDS_KEY: &str = "bop_ids";

/// What to make a recording from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FromBop {
    /// Scene folder.
    pub scene: PathBuf,
    /// Folder of the recording; must not exist.
    pub out: PathBuf,
    /// Takes every n-th image.
    pub every: usize,
    /// Takes at most this many.
    pub max_frames: Option<usize>,
}

/// Makes a rosbag2 recording of a BOP scene: the image files' bytes untouched, CameraInfo, and the initial poses on
/// `/initial_poses`. Ground truth is not looked at. Returns the number of frames. The recording appears whole or not at all.
///
/// # Errors
/// When the scene cannot be read, an image is neither JPEG nor PNG, or the recording cannot be written.
pub fn from_bop(options: &FromBop) -> Result<usize, PlayerError> {
    let scene = BopScene::open(&options.scene)?;
    let frames: Vec<&BopFrame> =
        scene.frames.iter().step_by(options.every.max(1)).take(options.max_frames.unwrap_or(usize::MAX)).collect();
    if options.every == 0 || frames.is_empty() {
        return Err(PlayerError::NothingSelected { path: options.scene.clone() });
    }
    check_frame_sizes(frames.iter().copied())?;
    let partial = Partial::directory(&options.out)?;
    let name = options.out.file_name().ok_or_else(|| BagError::Name { path: options.out.clone() })?;
    let inside = partial.path().join(name);
    let mut bag = BagWriter::create(&inside, Packing::default())?;
    let ids: Vec<(u32, u32)> = frames.iter().map(|f| (scene.scene_id, f.image_id)).collect();
    let ids = serde_json::to_string(&ids).unwrap_or_default();
    bag.set_custom_data(BTreeMap::from([(IDS_KEY.to_owned(), ids)]))?;
    let topics = Topics {
        image: bag.add_topic::<CompressedImage>("/camera/image/compressed", Qos::SENSOR_DATA)?,
        info: bag.add_topic::<CameraInfo>("/camera/camera_info", Qos::SENSOR_DATA)?,
        poses: bag.add_topic::<Detection3DArray>("/initial_poses", Qos::RELIABLE)?,
    };
    for (number, frame) in frames.iter().enumerate() {
        write_frame(&mut bag, &topics, number, frame)?;
    }
    bag.finish()?;
    partial.keep_inner(&inside)?;
    Ok(frames.len())
}

struct Topics {
    image: TopicId,
    info: TopicId,
    poses: TopicId,
}

fn write_frame(bag: &mut BagWriter, topics: &Topics, number: usize, frame: &BopFrame) -> Result<(), PlayerError> {
    let (stamp_ns, sequence) = (stamp_ns(number), number as u32);
    let header = Header { stamp: Time::from_ns(stamp_ns).unwrap_or_default(), frame_id: FRAME_ID.into() };
    let data = std::fs::read(&frame.image_path)
        .map_err(|source| ImagingError::Io { path: frame.image_path.clone(), source })?;
    let image = frame.load_image()?;
    let format = if data.starts_with(&[0xff, 0xd8]) { "jpeg" } else { "png" };
    let k = &frame.intrinsics;
    let info = CameraInfo::pinhole(header.clone(), image.dimensions(), [k.fx, k.fy, k.cx, k.cy]);
    let poses = detections(&header, &object_poses(&frame.initial_poses), &Naming::default());
    bag.write(topics.image, stamp_ns, sequence, &CompressedImage { header, format: format.into(), data })?;
    bag.write(topics.info, stamp_ns, sequence, &info)?;
    bag.write(topics.poses, stamp_ns, sequence, &poses)?;
    Ok(bag.end_frame()?)
}
