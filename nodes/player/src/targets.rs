//! A list of images to play, as BOP's target lists name them.

use pseudoflow_imaging::InitialPose;
use pseudoflow_metrics::{Target, TruthError, read_targets};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The images to play and the objects to look for in each, by scene and image.
#[derive(Debug, Clone)]
pub(crate) struct Targets(BTreeMap<(u32, u32), BTreeSet<u32>>);

impl Targets {
    /// Reads a list such as `test_targets_bop19.json`; its instance counts are not looked at.
    ///
    /// # Errors
    /// The file cannot be read or is no such list.
    pub(crate) fn read(path: &Path) -> Result<Self, TruthError> {
        let mut targets = BTreeMap::<_, BTreeSet<u32>>::new();
        for Target { scene_id, image_id, object_id, .. } in read_targets(path)? {
            targets.entry((scene_id, image_id)).or_default().insert(object_id);
        }
        Ok(Self(targets))
    }

    pub(crate) fn names_image(&self, scene_id: u32, image_id: u32) -> bool {
        self.0.contains_key(&(scene_id, image_id))
    }

    /// Keeps the poses of objects that are looked for in an image.
    pub(crate) fn keep(&self, scene_id: u32, image_id: u32, poses: &mut Vec<InitialPose>) {
        let objects = self.0.get(&(scene_id, image_id));
        poses.retain(|pose| objects.is_some_and(|objects| objects.contains(&pose.object_id)));
    }
}
