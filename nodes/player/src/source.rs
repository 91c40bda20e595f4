use crate::PlayerError;
use pseudoflow_msgs::{CameraFrameHeader, ObjectPose, Rectangle};
use std::collections::BTreeMap;

/// One frame of a recording.
#[derive(Debug, Clone)]
pub struct LoadedFrame {
    /// The image's stamp, nanoseconds.
    pub stamp_ns: i64,
    /// Size, camera, names.
    pub header: CameraFrameHeader,
    /// `height x width x 3`, RGB.
    pub rgb: Vec<u8>,
    /// Initial poses that the recording holds for the frame.
    pub initial_poses: Vec<ObjectPose>,
    /// What a detector saw in it.
    pub rectangles: Vec<Rectangle>,
}

/// What is known of a frame without its image.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFacts {
    /// BOP scene; 0 where there is none.
    pub scene_id: u32,
    /// BOP image; the frame's number where there is none.
    pub image_id: u32,
    /// fx, fy, cx, cy, pixels.
    pub intrinsics: [f64; 4],
    /// Initial poses that the recording holds for the frame.
    pub initial_poses: Vec<ObjectPose>,
}

/// A recording that gives any of its frames.
pub trait FrameSource: Send {
    /// How many frames there are.
    fn count(&self) -> usize;

    /// The objects of all initial poses, each with the first frame that has one.
    fn objects(&self) -> BTreeMap<u32, usize>;

    /// Frame `number` without its image.
    ///
    /// # Errors
    /// When its poses cannot be read.
    fn facts(&mut self, number: usize) -> Result<FrameFacts, PlayerError>;

    /// Frame `number`, below [`Self::count`].
    ///
    /// # Errors
    /// When it cannot be read or decoded.
    fn load(&mut self, number: usize) -> Result<LoadedFrame, PlayerError>;
}

/// Checks that all images have one size, that of their camera. `images`: file or topic and size of each, with the size
/// that its camera states, if any.
pub(crate) fn check_sizes(
    images: impl Iterator<Item = (std::path::PathBuf, (u32, u32), Option<(u32, u32)>)>,
) -> Result<(), PlayerError> {
    let mut first = None;
    for (number, (path, found, camera)) in images.enumerate() {
        let expected = [(*first.get_or_insert(found), "the first image")];
        let expected = expected.into_iter().chain(camera.map(|size| (size, "its CameraInfo")));
        for (expected, what) in expected {
            if found != expected {
                return Err(PlayerError::Size { path, number, found, expected, what });
            }
        }
    }
    Ok(())
}
