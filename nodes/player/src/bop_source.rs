use crate::source::{FrameFacts, check_sizes};
use crate::targets::Targets;
use crate::{FrameSource, LoadedFrame, PlayerError};
use pseudoflow_geometry::{Pose, quaternion_xyzw};
use pseudoflow_imaging::{BopFrame, BopScene, ImagingError, InitialPose, image_size};
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose, PoseSource, PoseStatus};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Optical frame of BOP images.
pub(crate) const FRAME_ID: &str = "camera_optical_frame";
/// BOP images have no time: they are stamped as a camera of this rate would, from one second after the epoch.
const PERIOD_NS: i64 = 33_333_333;

/// A BOP scene folder: images, cameras and `init_poses.json`. Ground truth is not looked at.
#[derive(Debug)]
pub struct BopSource {
    scene: BopScene,
}

/// The stamp of frame `number` of a BOP scene.
pub(crate) fn stamp_ns(number: usize) -> i64 {
    1_000_000_000 + number as i64 * PERIOD_NS
}

impl BopSource {
    /// Opens a scene folder.
    ///
    /// # Errors
    /// When its files are missing or malformed, or the images differ in size.
    pub fn open(folder: &Path) -> Result<Self, PlayerError> {
        let scene = BopScene::open(folder)?;
        check_frame_sizes(scene.frames.iter())?;
        Ok(Self { scene })
    }

    /// Opens what a target list names of a scene folder: those images, and poses of those objects alone. The images may differ
    /// in size, as those of a dataset do.
    pub(crate) fn open_targets(folder: &Path, targets: &Targets) -> Result<Self, PlayerError> {
        let scene_id = folder.file_name().and_then(|name| name.to_str()?.parse().ok()).unwrap_or(0);
        let mut scene = BopScene::open_where(folder, &|image_id| targets.names_image(scene_id, image_id))?;
        for frame in &mut scene.frames {
            targets.keep(scene_id, frame.image_id, &mut frame.initial_poses);
        }
        Ok(Self { scene })
    }
}

/// Checks that the images have one size; only their first bytes are read.
pub(crate) fn check_frame_sizes<'a>(frames: impl Iterator<Item = &'a BopFrame>) -> Result<(), PlayerError> {
    let sizes: Vec<_> = frames
        .map(|frame| Ok((frame.image_path.clone(), size_of_file(&frame.image_path)?, None)))
        .collect::<Result<_, ImagingError>>()?;
    check_sizes(sizes.into_iter())
}

fn size_of_file(path: &Path) -> Result<(u32, u32), ImagingError> {
    const HEAD_BYTES: u64 = 64 << 10; // metadata before the size rarely takes more
    let name = path.to_string_lossy();
    let io = |source| ImagingError::Io { path: path.to_owned(), source };
    let mut head = Vec::new();
    File::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head)).map_err(io)?;
    image_size(&head, &name).or_else(|_| image_size(&std::fs::read(path).map_err(io)?, &name))
}

/// Initial poses of a file; instances of an object are numbered in the order of the file.
pub(crate) fn object_poses(poses: &[InitialPose]) -> Vec<ObjectPose> {
    let mut given = Vec::<ObjectPose>::new();
    for InitialPose { object_id, camera_from_object } in poses {
        add_pose(&mut given, *object_id, 1.0, camera_from_object);
    }
    given
}

/// Adds a pose from outside to those of a frame: instances of an object are counted.
pub(crate) fn add_pose(given: &mut Vec<ObjectPose>, object_id: u32, score: f64, camera_from_object: &Pose) {
    given.push(ObjectPose {
        object_id,
        instance: given.iter().filter(|p| p.object_id == object_id).count() as u32,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score,
        rotation_xyzw: quaternion_xyzw(camera_from_object),
        translation_m: camera_from_object.translation.vector.into(),
        covariance: [0.0; 36],
    });
}

impl FrameSource for BopSource {
    fn count(&self) -> usize {
        self.scene.frames.len()
    }

    fn objects(&self) -> BTreeMap<u32, usize> {
        let mut objects = BTreeMap::new();
        for (number, frame) in self.scene.frames.iter().enumerate() {
            for pose in &frame.initial_poses {
                objects.entry(pose.object_id).or_insert(number);
            }
        }
        objects
    }

    fn facts(&mut self, number: usize) -> Result<FrameFacts, PlayerError> {
        let frame = &self.scene.frames[number];
        let k = &frame.intrinsics;
        Ok(FrameFacts {
            scene_id: self.scene.scene_id,
            image_id: frame.image_id,
            intrinsics: [k.fx, k.fy, k.cx, k.cy],
            initial_poses: object_poses(&frame.initial_poses),
        })
    }

    fn load(&mut self, number: usize) -> Result<LoadedFrame, PlayerError> {
        let frame = &self.scene.frames[number];
        let image = frame.load_image()?;
        let k = &frame.intrinsics;
        let header = CameraFrameHeader {
            width: image.width(),
            height: image.height(),
            scene_id: self.scene.scene_id,
            image_id: frame.image_id,
            intrinsics: [k.fx, k.fy, k.cx, k.cy],
            frame_id: CameraFrameHeader::frame_id_bytes(FRAME_ID).unwrap_or([0; pseudoflow_msgs::FRAME_ID_BYTES]),
        };
        let initial_poses = object_poses(&frame.initial_poses);
        Ok(LoadedFrame {
            stamp_ns: stamp_ns(number),
            header,
            rgb: image.into_raw(),
            initial_poses,
            rectangles: Vec::new(),
        })
    }
}
