//! Opens recordings of every kind.

use crate::concatenated::Concatenated;
use crate::targets::Targets;
use crate::{BagOptions, BagSource, BopSource, FrameSource, PlayerConfig, PlayerError};
use pseudoflow_edge::camera::read_calibration;
use pseudoflow_imaging::list_scenes;
use pseudoflow_msgs::ros::Naming;
use std::path::Path;

pub(crate) fn is_bop_scene(path: &Path) -> bool {
    path.join("scene_camera.json").is_file()
}

/// Whether a folder is no recording but holds scenes.
pub(crate) fn is_bop_split(path: &Path) -> bool {
    path.is_dir() && !is_bop_scene(path) && list_scenes(path).is_ok()
}

/// Opens the recordings of a player's settings, to look into them without playing.
///
/// # Errors
/// When one cannot be played.
pub fn open_recording(config: &PlayerConfig) -> Result<Box<dyn FrameSource>, PlayerError> {
    open_all(config, &Naming::default())
}

pub(crate) fn open_all(config: &PlayerConfig, naming: &Naming) -> Result<Box<dyn FrameSource>, PlayerError> {
    let targets = config.targets.as_deref().map(Targets::read).transpose()?;
    let mut all = Vec::new();
    for path in std::iter::once(&config.source).chain(&config.also) {
        let scenes = if is_bop_split(path) { list_scenes(path)? } else { vec![path.clone()] };
        for path in scenes {
            all.push(open(config, &path, targets.as_ref(), naming.clone())?);
        }
    }
    Ok(if all.len() == 1 { all.remove(0) } else { Box::new(Concatenated(all)) })
}

fn open(
    config: &PlayerConfig,
    path: &Path,
    targets: Option<&Targets>,
    naming: Naming,
) -> Result<Box<dyn FrameSource>, PlayerError> {
    if is_bop_scene(path) {
        let scene = targets.map_or_else(|| BopSource::open(path), |targets| BopSource::open_targets(path, targets));
        return Ok(Box::new(scene?));
    }
    if !path.exists() {
        return Err(PlayerError::NoRecording(path.to_owned()));
    }
    let options = BagOptions {
        image_topic: config.image_topic.clone(),
        camera_info_topic: config.camera_info_topic.clone(),
        poses_topic: config.initial_poses.topic.clone(),
        rectangles_topic: config.rectangles_topic.clone(),
        rectified: config.rectified,
        calibration: config.calibration.as_deref().map(read_calibration).transpose()?,
        naming,
    };
    Ok(Box::new(BagSource::open(path, &options)?))
}
