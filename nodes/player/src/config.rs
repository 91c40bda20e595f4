//! What the player plays, and from where.

use crate::sampling::Sampling;
use pseudoflow_runtime::Stride;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the player node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlayerConfig {
    /// A rosbag2 folder, an .mcap file, a BOP scene folder, or a BOP split: a folder of scenes.
    pub source: PathBuf,
    /// More recordings, played behind the first.
    #[serde(default)]
    pub also: Vec<PathBuf>,
    /// Folder of the object set: poses of other objects are errors.
    #[serde(default)]
    pub objects: Option<PathBuf>,
    /// Where initial poses come from. BOP scenes bring their own (`init_poses.json`).
    #[serde(default)]
    pub initial_poses: InitialPoses,
    /// Topic of the images; without: the only one.
    #[serde(default)]
    pub image_topic: Option<String>,
    /// Topic of the CameraInfo; without: the only one.
    #[serde(default)]
    pub camera_info_topic: Option<String>,
    /// Topic of a detector's rectangles (vision_msgs/Detection2DArray).
    #[serde(default)]
    pub rectangles_topic: Option<String>,
    /// Whether the images of a bag are rectified, so that CameraInfo's P holds instead of K and D. Else they are rectified here.
    #[serde(default)]
    pub rectified: bool,
    /// Calibration of a bag's camera (YAML of camera_calibration) instead of a CameraInfo topic.
    #[serde(default)]
    pub calibration: Option<PathBuf>,
    /// BOP scenes: a target list such as `test_targets_bop19.json`. Only its images are played, and the scenes' initial poses
    /// only of the objects that it names in them.
    #[serde(default)]
    pub targets: Option<PathBuf>,
    /// Only initial poses of these objects; all without.
    #[serde(default)]
    pub only_objects: Option<Vec<u32>>,
    /// Stamps the frames as a camera of this rate would, from one second on, instead of as they were recorded. A live graph
    /// plays a recording at the pace of its stamps.
    #[serde(default)]
    pub hz: Option<f64>,
    /// Plays the recording so often, every second time backwards, so that nothing jumps where it turns. Needs `hz`.
    #[serde(default = "once")]
    pub passes: u32,
    /// Which frames are played: `{start: 4, step: 5}` begins with frame 4 and leaves four out after each.
    #[serde(default)]
    pub frames: Stride,
    /// Plays at most this many frames.
    #[serde(default)]
    pub max_frames: Option<u64>,
    /// Training: frames at random, one instance each, instead of the recording from its begin to its end.
    #[serde(default)]
    pub sampling: Option<Sampling>,
}

fn once() -> u32 {
    1
}

/// Where initial poses come from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InitialPoses {
    /// A topic of the bag (vision_msgs/Detection3DArray).
    #[serde(default)]
    pub topic: Option<String>,
    /// A BOP result file (.csv: scene and image of each pose), or a file as `init_poses.json` of BOP sets: poses by image
    /// id. A bag that no BOP scene became is scene 0, its image ids are the frames' count. They hold instead of the
    /// recording's own.
    #[serde(default)]
    pub file: Option<PathBuf>,
}

/// Place of the frame that is played at an index when `count` frames are played `passes` times, every second time backwards; the
/// frames where it turns come once. `None` behind the end.
fn there_and_back(index: u64, count: u64, passes: u32) -> Option<u64> {
    let span = count.checked_sub(1)?;
    if index > span * u64::from(passes) {
        return None;
    }
    let (pass, at) = (index.checked_div(span).unwrap_or(0), index.checked_rem(span).unwrap_or(0));
    Some(if pass % 2 == 0 { at } else { span - at })
}

impl PlayerConfig {
    /// Number in recordings of `count` frames of the frame that is played at an index; `None` behind the last, and of no use to
    /// a training, which draws its frames.
    #[must_use]
    pub fn number_at(&self, index: u64, count: u64) -> Option<u64> {
        let place = there_and_back(index, self.frames.count(count), self.passes)?;
        (index < self.max_frames.unwrap_or(u64::MAX)).then(|| self.frames.number(place))
    }

    /// Plays a recording with the defaults.
    #[must_use]
    pub fn new(source: PathBuf) -> Self {
        Self {
            source,
            also: Vec::new(),
            objects: None,
            initial_poses: InitialPoses::default(),
            image_topic: None,
            camera_info_topic: None,
            rectangles_topic: None,
            rectified: false,
            calibration: None,
            targets: None,
            only_objects: None,
            hz: None,
            passes: once(),
            frames: Stride::default(),
            max_frames: None,
            sampling: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_goes_there_and_back_without_a_jump() {
        let played = |count, passes| (0..).map_while(|i| there_and_back(i, count, passes)).collect::<Vec<u64>>();
        assert_eq!(played(4, 1), [0, 1, 2, 3]);
        assert_eq!(played(4, 2), [0, 1, 2, 3, 2, 1, 0]);
        assert_eq!(played(4, 3), [0, 1, 2, 3, 2, 1, 0, 1, 2, 3]);
        assert_eq!(played(1, 3), [0]);
        assert!(played(0, 1).is_empty());
    }

    #[test]
    fn frames_are_left_out_before_a_recording_is_turned() {
        let frames = serde_json::from_str(r#"{"start": 1, "step": 3}"#).unwrap();
        let config = PlayerConfig { frames, passes: 2, ..PlayerConfig::new("bag".into()) };
        let played = |config: &PlayerConfig| (0..).map_while(|i| config.number_at(i, 9)).collect::<Vec<u64>>();
        assert_eq!(played(&config), [1, 4, 7, 4, 1]);
        assert_eq!(played(&PlayerConfig { max_frames: Some(2), ..config }), [1, 4]);
    }
}
