//! Initial poses from a file instead of the recording: what another program found.

use crate::PlayerError;
use crate::bop_source::given_poses;
use pseudoflow_geometry::{Pose, quaternion_xyzw};
use pseudoflow_imaging::read_initial_poses;
use pseudoflow_metrics::{Estimate, read_results};
use pseudoflow_msgs::{ObjectPose, PoseSource, PoseStatus};
use std::collections::BTreeMap;
use std::path::Path;

/// Poses by frame.
#[derive(Debug, Clone)]
pub(crate) enum GivenPoses {
    /// As `init_poses.json`: by image id, whatever the scene.
    OfImage(BTreeMap<u32, Vec<ObjectPose>>),
    /// A BOP result file: by scene and image.
    OfScene(BTreeMap<(u32, u32), Vec<ObjectPose>>),
}

impl GivenPoses {
    /// Reads a BOP result file (`.csv`) or a file as `init_poses.json`.
    ///
    /// # Errors
    /// The file cannot be read; all its wrong lines are named.
    pub(crate) fn read(path: &Path) -> Result<Self, PlayerError> {
        if !is_result_file(path) {
            let poses = read_initial_poses(path)?;
            return Ok(Self::OfImage(poses.iter().map(|(image, poses)| (*image, given_poses(poses))).collect()));
        }
        let mut poses = BTreeMap::<_, Vec<ObjectPose>>::new();
        for estimate in read_results(path, None)? {
            let frame = poses.entry((estimate.scene_id, estimate.image_id)).or_default();
            let instance = frame.iter().filter(|pose| pose.object_id == estimate.object_id).count() as u32;
            frame.push(given(&estimate, instance));
        }
        Ok(Self::OfScene(poses))
    }

    pub(crate) fn of(&self, scene_id: u32, image_id: u32) -> Vec<ObjectPose> {
        let found = match self {
            Self::OfImage(poses) => poses.get(&image_id),
            Self::OfScene(poses) => poses.get(&(scene_id, image_id)),
        };
        found.cloned().unwrap_or_default()
    }

    /// The objects, each with the first image that has one.
    pub(crate) fn objects(&self) -> BTreeMap<u32, usize> {
        let all: Box<dyn Iterator<Item = (u32, &Vec<ObjectPose>)>> = match self {
            Self::OfImage(poses) => Box::new(poses.iter().map(|(image, poses)| (*image, poses))),
            Self::OfScene(poses) => Box::new(poses.iter().map(|((_, image), poses)| (*image, poses))),
        };
        let mut objects = BTreeMap::new();
        for (image_id, poses) in all {
            for pose in poses {
                objects.entry(pose.object_id).or_insert(image_id as usize);
            }
        }
        objects
    }
}

/// Whether a file tells scenes apart.
pub(crate) fn is_result_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}

fn given(estimate: &Estimate, instance: u32) -> ObjectPose {
    let pose: Pose = estimate.camera_from_object.pose();
    ObjectPose {
        object_id: estimate.object_id,
        instance,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        // Only the order of a result file's scores has a meaning.
        score: estimate.score.clamp(0.0, 1.0),
        rotation_xyzw: quaternion_xyzw(&pose),
        translation_m: pose.translation.vector.into(),
        covariance: [0.0; 36],
    }
}
