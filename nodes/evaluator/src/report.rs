use crate::{Diagnosis, EvalError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What an evaluation found: the content of `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Dataset, e.g. `ycbv`.
    pub dataset: String,
    /// Split, e.g. `test`.
    pub split: String,
    /// Where the scene's depth came from that VSD compares with.
    pub vsd_depth: VsdDepth,
    /// What a reader of the scores should know.
    pub notes: Vec<String>,
    /// Names of the sets of estimates, in their order (`init`, `refined`; or `estimate`).
    pub sets: Vec<String>,
    /// Scores over all instances, by set.
    pub overall: BTreeMap<String, Scores>,
    /// Scores by object id and set.
    pub per_object: BTreeMap<u32, BTreeMap<String, Scores>>,
    /// What the objects are.
    pub objects: BTreeMap<u32, ObjectInfo>,
    /// Errors of every true instance, by set; the same instances in the same order in each.
    pub instances: BTreeMap<String, Vec<InstanceErrors>>,
    /// What is wrong, over all instances, by set.
    #[serde(default)]
    pub diagnosis: BTreeMap<String, Diagnosis>,
    /// What is wrong, by object id and set.
    #[serde(default)]
    pub object_diagnosis: BTreeMap<u32, BTreeMap<String, Diagnosis>>,
    /// The same once more without some objects ([`Report::leave_out`]).
    #[serde(default)]
    pub without: Option<Without>,
}

/// What a report says without some objects, whose meshes, say, are too coarse to judge by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Without {
    /// The objects that are left out.
    pub objects: Vec<u32>,
    /// Scores by set.
    pub overall: BTreeMap<String, Scores>,
    /// What is wrong, by set.
    pub diagnosis: BTreeMap<String, Diagnosis>,
}

impl Without {
    /// E.g. `all but 7`.
    #[must_use]
    pub fn name(&self) -> String {
        let ids: Vec<String> = self.objects.iter().map(u32::to_string).collect();
        format!("all but {}", ids.join(", "))
    }
}

/// An object of a report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectInfo {
    /// Name.
    pub name: String,
    /// Diameter, metres.
    pub diameter_m: f64,
    /// Whether ADD(-S) means ADI.
    pub symmetric: bool,
}

/// Where VSD's depth of the scene came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VsdDepth {
    /// The depth images of the dataset.
    Sensor,
    /// There are none: all true instances were rendered, and the nearest surface taken.
    Rendered,
    /// Some images have depth, some not.
    Mixed,
}

/// Scores of one set of estimates; shares are fractions in 0..1. What was not found counts as wrong.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// True instances.
    pub n: usize,
    /// Instances with an estimate at all.
    pub with_estimate: usize,
    /// Share with ADD (ADI for symmetric objects) below a tenth of the diameter.
    #[serde(rename = "add_s_recall_0.1d")]
    pub add_s_recall: f64,
    /// Area under the accuracy curve of ADD(-S) to 10 cm.
    pub auc_add_s: f64,
    /// Mean recall over the thresholds of MSSD.
    pub mssd_recall: f64,
    /// Mean recall over the thresholds of MSPD.
    pub mspd_recall: f64,
    /// Mean recall over the tolerances and thresholds of VSD.
    pub vsd_recall: f64,
    /// Average recall: mean of the three above.
    pub ar: f64,
    /// Share within 5 cm and 5 degrees.
    pub recall_5cm_5deg: f64,
    /// Share with a mean projection error below 5 pixels.
    pub projection_recall_5px: f64,
    /// Median rotation error of what has an estimate (nearest symmetric truth), degrees.
    pub median_rotation_deg: Option<f64>,
    /// Median translation error of what has an estimate, metres.
    pub median_translation_m: Option<f64>,
    /// Recall at each threshold of MSSD (0.05 to 0.5 diameters).
    pub mssd_recalls: [f64; 10],
    /// Recall at each threshold of MSPD (5 to 50 pixels at 640 width).
    pub mspd_recalls: [f64; 10],
    /// Recall at each threshold of VSD (0.05 to 0.5), mean over the tolerances.
    pub vsd_recalls: [f64; 10],
    /// Share of the instances that are at least 60 % visible whose estimate lies on them: the boxes around both projections
    /// overlap by half or more (intersection over union). None where no visibility is known.
    #[serde(default)]
    pub detection_recall: Option<f64>,
    /// Mean time of an estimate, milliseconds: its share of the image's time.
    pub ms_per_object: Option<f64>,
}

/// The errors of one true instance. Without an estimate the numbers are missing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct InstanceErrors {
    /// Scene.
    pub scene_id: u32,
    /// Image.
    pub image_id: u32,
    /// Object.
    pub object_id: u32,
    /// Index of the instance in the image's list of `scene_gt.json`.
    pub instance: u32,
    /// Index of the matched estimate in its set: the one that took this instance as its nearest by ADD(-S).
    pub estimate: Option<usize>,
    /// ADD, or ADI for a symmetric object, metres.
    pub add_s_m: Option<f64>,
    /// The same in diameters.
    pub add_s_of_diameter: Option<f64>,
    /// MSSD in diameters.
    pub mssd_of_diameter: Option<f64>,
    /// MSPD in pixels of an image 640 wide.
    pub mspd_px: Option<f64>,
    /// VSD, mean over the tolerances.
    pub vsd: Option<f64>,
    /// Rotation error against the nearest symmetric truth, degrees.
    pub rotation_deg: Option<f64>,
    /// Translation error, metres.
    pub translation_m: Option<f64>,
    /// Mean projection error, pixels of the image.
    pub projection_px: Option<f64>,
    /// Whether within 5 cm and 5 degrees.
    pub within_5cm_5deg: bool,
    /// Visible share of the instance, where the dataset says it.
    #[serde(default)]
    pub visible_fraction: Option<f64>,
    /// Intersection over union of the boxes around the projections of estimate and truth.
    #[serde(default)]
    pub box_overlap: Option<f64>,
    /// Depth of the middle of the estimated bounding box minus that of the true one, diameters: positive is too far.
    #[serde(default)]
    pub depth_of_diameter: Option<f64>,
    /// ADD(-S) with the estimate moved along the viewing ray of that middle to its true depth, diameters.
    #[serde(default)]
    pub add_s_true_depth_of_diameter: Option<f64>,
    /// The estimate's own confidence, 0..1.
    #[serde(default)]
    pub confidence: Option<f64>,
    /// Squared Mahalanobis distance of the truth under the estimate's covariance: of the pose, its translation, its rotation.
    #[serde(default)]
    pub mahalanobis2: Option<[f64; 3]>,
    /// The gate's decisions on the way to the estimate, pass after pass.
    #[serde(default)]
    pub gate: Vec<GateErrors>,
    /// Whether found with ADD(-S) below a tenth of the diameter.
    pub add_s_correct: bool,
    /// Whether found at each threshold of MSSD.
    pub mssd_met: [bool; 10],
    /// Whether found at each threshold of MSPD.
    pub mspd_met: [bool; 10],
    /// For each threshold of VSD, at how many of the 10 tolerances it was found.
    pub vsd_met: [u32; 10],
}

/// A decision of the gate and what hung on it: ADD(-S) in diameters.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GateErrors {
    /// Of the pose that the refinement began from.
    pub before_of_diameter: f64,
    /// Of the refined pose, taken or not.
    pub after_of_diameter: f64,
    /// Whether it was taken.
    pub accepted: bool,
    /// What the decision was made from, and the claimed probability that it is better (`better`).
    #[serde(default)]
    pub evidence: BTreeMap<String, f64>,
}

impl InstanceErrors {
    /// What makes it the same instance in another report: scene, image, object, index.
    #[must_use]
    pub fn key(&self) -> (u32, u32, u32, u32) {
        (self.scene_id, self.image_id, self.object_id, self.instance)
    }

    /// Its part of the mean recall of MSSD, in 0..1.
    #[must_use]
    pub fn mssd_share(&self) -> f64 {
        self.mssd_met.iter().filter(|met| **met).count() as f64 / 10.0
    }

    /// Its part of the mean recall of MSPD, in 0..1.
    #[must_use]
    pub fn mspd_share(&self) -> f64 {
        self.mspd_met.iter().filter(|met| **met).count() as f64 / 10.0
    }

    /// Its part of the mean recall of VSD, in 0..1.
    #[must_use]
    pub fn vsd_share(&self) -> f64 {
        f64::from(self.vsd_met.iter().sum::<u32>()) / 100.0
    }

    /// Its part of the average recall, in 0..1.
    #[must_use]
    pub fn ar_share(&self) -> f64 {
        (self.mssd_share() + self.mspd_share() + self.vsd_share()) / 3.0
    }

    /// Its part of the area under the ADD(-S) curve, in 0..1.
    #[must_use]
    pub fn auc_share(&self) -> f64 {
        pseudoflow_metrics::auc_to_10cm(&[self.add_s_m.unwrap_or(f64::INFINITY)])
    }
}

impl Scores {
    /// The scores of some instances; `times_ms` are the times of their estimates.
    #[must_use]
    pub fn of(instances: &[&InstanceErrors], times_ms: Option<&[f64]>) -> Self {
        let n = instances.len();
        let mean = |f: &dyn Fn(&InstanceErrors) -> f64| match n {
            0 => 0.0,
            _ => instances.iter().map(|i| f(i)).sum::<f64>() / n as f64,
        };
        let share = |f: &dyn Fn(&InstanceErrors) -> bool| mean(&|i| f64::from(u8::from(f(i))));
        let [mssd_recall, mspd_recall, vsd_recall] =
            [mean(&InstanceErrors::mssd_share), mean(&InstanceErrors::mspd_share), mean(&InstanceErrors::vsd_share)];
        let visible: Vec<&&InstanceErrors> =
            instances.iter().filter(|i| i.visible_fraction.is_some_and(|v| v >= WELL_VISIBLE)).collect();
        let on_it = visible.iter().filter(|i| i.box_overlap.is_some_and(|v| v >= 0.5)).count();
        Self {
            n,
            detection_recall: (!visible.is_empty()).then(|| on_it as f64 / visible.len() as f64),
            with_estimate: instances.iter().filter(|i| i.estimate.is_some()).count(),
            add_s_recall: share(&|i| i.add_s_correct),
            auc_add_s: mean(&InstanceErrors::auc_share),
            mssd_recall,
            mspd_recall,
            vsd_recall,
            ar: (mssd_recall + mspd_recall + vsd_recall) / 3.0,
            recall_5cm_5deg: share(&|i| i.within_5cm_5deg),
            projection_recall_5px: share(&|i| i.projection_px.is_some_and(|p| p < 5.0)),
            median_rotation_deg: median(instances.iter().filter_map(|i| i.rotation_deg)),
            median_translation_m: median(instances.iter().filter_map(|i| i.translation_m)),
            mssd_recalls: std::array::from_fn(|t| share(&|i| i.mssd_met[t])),
            mspd_recalls: std::array::from_fn(|t| share(&|i| i.mspd_met[t])),
            vsd_recalls: std::array::from_fn(|t| mean(&|i| f64::from(i.vsd_met[t]) / 10.0)),
            ms_per_object: times_ms.filter(|t| !t.is_empty()).map(|t| t.iter().sum::<f64>() / t.len() as f64),
        }
    }
}

/// What a detector must find.
const WELL_VISIBLE: f64 = 0.6;

pub(crate) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[middle]),
        _ => Some((sorted[middle - 1] + sorted[middle]) / 2.0),
    }
}

impl Report {
    /// Reads `report.json`.
    ///
    /// # Errors
    /// When the file cannot be read or is no report.
    pub fn read_json(path: &Path) -> Result<Self, EvalError> {
        let text = std::fs::read_to_string(path).map_err(EvalError::io(path))?;
        serde_json::from_str(&text).map_err(|source| EvalError::Json { path: path.to_owned(), source })
    }

    /// Writes `report.json`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_json(&self, path: &Path) -> Result<(), EvalError> {
        let text = serde_json::to_string(self).map_err(|source| EvalError::Json { path: path.to_owned(), source })?;
        pseudoflow_files::write_private(path, (text + "\n").as_bytes()).map_err(EvalError::io(path))
    }

    /// Adds what the report says without some objects: [`Report::without`].
    ///
    /// # Errors
    /// [`EvalError::NotScored`] when an object has no instance here, or nothing would be left.
    pub fn leave_out(&mut self, objects: &[u32]) -> Result<(), EvalError> {
        let known: Vec<u32> = self.objects.keys().copied().collect();
        if let Some(id) = objects.iter().find(|id| !known.contains(id)) {
            return Err(EvalError::NotScored { object_id: *id, known });
        }
        if known.iter().all(|id| objects.contains(id)) {
            return Err(EvalError::NothingLeft { known });
        }
        let stays = |i: &InstanceErrors| !objects.contains(&i.object_id);
        let (mut overall, mut diagnosis) = (BTreeMap::new(), BTreeMap::new());
        for set in &self.sets {
            let these: Vec<&InstanceErrors> = self.instances_of(set).filter(|i| stays(i)).collect();
            overall.insert(set.clone(), Scores::of(&these, None));
            diagnosis.insert(set.clone(), self.diagnose(set, &stays));
        }
        self.without = Some(Without { objects: objects.to_vec(), overall, diagnosis });
        Ok(())
    }

    fn instances_of(&self, set: &str) -> impl Iterator<Item = &InstanceErrors> {
        self.instances.get(set).into_iter().flatten()
    }

    /// What is wrong with some instances of a set.
    pub(crate) fn diagnose(&self, set: &str, which: &dyn Fn(&InstanceErrors) -> bool) -> Diagnosis {
        let of = |set: &str| self.instances_of(set).filter(|i| which(i)).collect::<Vec<_>>();
        let first = self.sets.first().filter(|first| *first != set);
        Diagnosis::of(&of(set), &first.map(|first| of(first)).unwrap_or_default())
    }

    /// Dataset and split, e.g. `ycbv-test`.
    #[must_use]
    pub fn title(&self) -> String {
        format!("{}-{}", self.dataset, self.split)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_an_even_count_is_between_the_middle_two() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median([4.0, 1.0, 2.0, 3.0].into_iter()), Some(2.5));
        assert_eq!(median(std::iter::empty()), None);
    }

    #[test]
    fn what_was_not_found_counts_as_wrong() {
        let found = InstanceErrors {
            estimate: Some(0),
            add_s_m: Some(0.0),
            add_s_correct: true,
            mssd_met: [true; 10],
            mspd_met: [true; 10],
            vsd_met: [10; 10],
            ..InstanceErrors::default()
        };
        let scores = Scores::of(&[&found, &InstanceErrors::default()], Some(&[10.0, 30.0]));
        assert_eq!((scores.n, scores.with_estimate), (2, 1));
        for share in [scores.add_s_recall, scores.auc_add_s, scores.mssd_recall, scores.vsd_recall, scores.ar] {
            assert!((share - 0.5).abs() < 1e-12);
        }
        assert_eq!(scores.ms_per_object, Some(20.0));
    }
}
