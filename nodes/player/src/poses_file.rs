//! Initial poses from a file instead of the recording: what another program found.

use crate::PlayerError;
use crate::bop_source::{add_pose, object_poses};
use pseudoflow_imaging::read_initial_poses;
use pseudoflow_metrics::read_results;
use pseudoflow_msgs::ObjectPose;
use std::collections::BTreeMap;
use std::path::Path;

/// Poses by frame.
#[derive(Debug, Clone)]
pub(crate) struct PosesFile {
    /// By scene and image; one scene for all where the file does not tell scenes apart.
    poses: BTreeMap<(Option<u32>, u32), Vec<ObjectPose>>,
    tells_scenes: bool,
}

impl PosesFile {
    /// Reads a BOP result file (`.csv`) or a file as `init_poses.json`.
    ///
    /// # Errors
    /// The file cannot be read; all its wrong lines are named.
    pub(crate) fn read(path: &Path) -> Result<Self, PlayerError> {
        let tells_scenes = is_result_file(path);
        let mut poses = BTreeMap::<_, Vec<ObjectPose>>::new();
        if tells_scenes {
            for found in read_results(path, None)? {
                let frame = poses.entry((Some(found.scene_id), found.image_id)).or_default();
                // Only the order of a result file's scores has a meaning.
                add_pose(frame, found.object_id, found.score.clamp(0.0, 1.0), &found.camera_from_object.pose());
            }
        } else {
            let images = read_initial_poses(path)?;
            poses.extend(images.iter().map(|(image, poses)| ((None, *image), object_poses(poses))));
        }
        Ok(Self { poses, tells_scenes })
    }

    pub(crate) fn of(&self, scene_id: u32, image_id: u32) -> Vec<ObjectPose> {
        let scene = self.tells_scenes.then_some(scene_id);
        self.poses.get(&(scene, image_id)).cloned().unwrap_or_default()
    }

    /// The objects, each with the first image that has one.
    pub(crate) fn objects(&self) -> BTreeMap<u32, usize> {
        let mut objects = BTreeMap::new();
        for ((_, image_id), poses) in &self.poses {
            for pose in poses {
                objects.entry(pose.object_id).or_insert(*image_id as usize);
            }
        }
        objects
    }
}

/// Whether a file tells scenes apart.
pub(crate) fn is_result_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}
