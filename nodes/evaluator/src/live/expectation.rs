use crate::EvalError;
#[cfg(test)]
use pseudoflow_metrics::MatrixPose;
use pseudoflow_metrics::{SceneTruth, TruthInstance, VISIB_GT_MIN, read_results};
use std::collections::BTreeMap;
use std::path::Path;

/// What should be found in each frame.
#[derive(Debug, Clone, Default)]
pub struct Expectation {
    /// By scene and image; scene `None`: of any scene.
    images: BTreeMap<(Option<u32>, u32), Vec<TruthInstance>>,
}

impl Expectation {
    /// The ground truth of a BOP scene folder.
    ///
    /// # Errors
    /// When its files cannot be read.
    pub fn of_truth(scene: &Path) -> Result<Self, EvalError> {
        let truth = SceneTruth::read(scene)?;
        Ok(Self { images: truth.images.into_iter().map(|(image, instances)| ((None, image), instances)).collect() })
    }

    /// A BOP result file of a method that is believed, as far as it was as sure as `least_score`.
    ///
    /// # Errors
    /// When the file cannot be read; its wrong lines are named.
    pub fn of_reference(results: &Path, least_score: f64) -> Result<Self, EvalError> {
        let mut images = BTreeMap::<_, Vec<TruthInstance>>::new();
        let found = read_results(results, None).map_err(|error| EvalError::Reference(error.to_string()))?;
        for estimate in found.into_iter().filter(|estimate| estimate.score >= least_score) {
            let instance = TruthInstance {
                object_id: estimate.object_id,
                camera_from_object: estimate.camera_from_object,
                visible_fraction: None,
            };
            images.entry((Some(estimate.scene_id), estimate.image_id)).or_default().push(instance);
        }
        Ok(Self { images })
    }

    /// Everything known of a frame, hidden instances included.
    pub(crate) fn of(&self, scene_id: u32, image_id: u32) -> &[TruthInstance] {
        let exact = self.images.get(&(Some(scene_id), image_id));
        exact.or_else(|| self.images.get(&(None, image_id))).map_or(&[], Vec::as_slice)
    }

    /// For tests: one frame's instances.
    #[cfg(test)]
    pub(crate) fn insert(&mut self, image_id: u32, object_id: u32, pose: MatrixPose, visible: f64) {
        let instance = TruthInstance { object_id, camera_from_object: pose, visible_fraction: Some(visible) };
        self.images.entry((None, image_id)).or_default().push(instance);
    }
}

/// Whether enough of an instance is visible to be found.
pub(crate) fn is_visible(instance: &TruthInstance) -> bool {
    instance.visible_fraction.is_none_or(|visible| visible >= VISIB_GT_MIN)
}
