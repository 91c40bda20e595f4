//! Refinements of synthetic scenes with what became of them.

use super::scenes::{InstanceTruth, SceneTruth};
use anyhow::{Context as _, Result};
use nalgebra::Vector6;
use pseudoflow_evaluator::results::{ImageDetails, read_details};
use pseudoflow_evaluator::{EvalError, EvalModel, GateStep};
use pseudoflow_geometry::{Pose, pose_from_quaternion};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_metrics::{MatrixPose, add_m, adi_m, nearest_symmetric, pose_error};
use pseudoflow_pnp::gate::{Feature, Features, Stage};
use pseudoflow_runtime::read_lines;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// One refinement, and how wrong the poses before and after it were.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Sample {
    /// What was solved from.
    #[serde(default)]
    pub(super) stage: Stage,
    /// Folder and number of the object.
    pub(super) object: String,
    /// Visible share of the object.
    pub(super) visible: f64,
    /// ADD(-S) of the initial pose, diameters.
    pub(super) before: f64,
    /// ADD(-S) of the refined pose, diameters.
    pub(super) after: f64,
    /// From the refined pose to the truth: translation (m), rotation (rad), camera axes.
    pub(super) error: [f64; 6],
    /// The solver's covariance, row-major 6 x 6.
    pub(super) covariance: Vec<f64>,
    /// What the refinement says about itself.
    pub(super) features: BTreeMap<Feature, f64>,
}

impl Sample {
    pub(super) fn is_better(&self) -> bool {
        self.after < self.before
    }

    pub(super) fn features(&self) -> Features {
        self.features.iter().fold(Features::default(), |all, (feature, value)| all.with(*feature, *value))
    }

    pub(super) fn error(&self) -> Vector6<f64> {
        self.error.into()
    }

    /// 36 numbers; zeros where the file has another count, which no covariance test passes.
    pub(super) fn covariance(&self) -> [f64; 36] {
        self.covariance.as_slice().try_into().unwrap_or([0.0; 36])
    }
}

/// Compares what a run over scenes of an object set left with their truth.
pub(super) struct SampleReader {
    folder: String,
    models: BTreeMap<u32, EvalModel>,
    stage: Stage,
}

impl SampleReader {
    pub(super) fn open(folder: &Path, stage: Stage) -> Result<Self> {
        let objects = ObjectSet::load(folder)?;
        let models = objects.iter().map(|o| Ok((o.id, EvalModel::new(o)?))).collect::<Result<_>>()?;
        Ok(Self { folder: folder.display().to_string(), models, stage })
    }

    /// What became of each refinement; where nothing was solved there is nothing to decide.
    pub(super) fn samples(&self, truth: &Path, details: &Path) -> Result<Vec<Sample>> {
        let details = read_details(details)?;
        let truths: BTreeMap<u32, SceneTruth> =
            read_lines::<SceneTruth>(truth)?.into_iter().map(|scene| (scene.image_id, scene)).collect();
        let of_scene = |scene: &SceneTruth| {
            let found = details.get(&(0, scene.image_id)).context("its scene was not refined")?;
            self.of_scene(scene, found).with_context(|| format!("scene {}", scene.image_id))
        };
        let samples: Vec<Vec<Sample>> = truths.values().map(of_scene).collect::<Result<_>>()?;
        Ok(samples.concat())
    }

    fn of_scene(&self, scene: &SceneTruth, found: &ImageDetails) -> Result<Vec<Sample>> {
        let sample = |(ids, step): ((u32, u32), Result<GateStep, EvalError>)| {
            let truth = scene.instances.iter().find(|t| (t.object_id, t.instance) == ids);
            self.sample(truth.context("a pose came back that was not sent")?, &step?)
        };
        found.decisions().map(sample).collect()
    }

    fn sample(&self, truth: &InstanceTruth, step: &GateStep) -> Result<Sample> {
        let model = self.models.get(&truth.object_id).context("an object that the set does not have")?;
        let (rotation, translation) = &truth.camera_from_object;
        let true_pose = pose_from_quaternion(rotation, translation)?;
        let nearest = nearest_symmetric(&step.after.into(), &true_pose.into(), &model.symmetries);
        Ok(Sample {
            stage: self.stage,
            object: format!("{}/{}", self.folder, truth.object_id),
            visible: truth.visible,
            before: add_s_of_diameter(model, &step.before, &true_pose),
            after: add_s_of_diameter(model, &step.after, &true_pose),
            error: pose_error(&step.after.into(), &nearest).into(),
            covariance: step.solver_covariance.context("a decision has no covariance")?.to_vec(),
            features: step.evidence.iter().filter_map(|(name, value)| Some((Feature::named(name)?, *value))).collect(),
        })
    }
}

fn add_s_of_diameter(model: &EvalModel, est: &Pose, gt: &Pose) -> f64 {
    let (est, gt): (MatrixPose, MatrixPose) = ((*est).into(), (*gt).into());
    let error_m = if model.symmetric { adi_m(&model.points, &est, &gt) } else { add_m(&model.points, &est, &gt) };
    error_m / model.diameter_m
}

pub(super) fn write(path: &Path, samples: &[Sample]) -> Result<()> {
    let lines = samples.iter().map(|s| Ok(serde_json::to_string(s)? + "\n")).collect::<Result<String>>()?;
    pseudoflow_files::write(path, lines.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_survive_their_file() {
        let sample = Sample {
            stage: Stage::Joint,
            object: "pool/7".into(),
            visible: 0.7,
            before: 0.2,
            after: 0.05,
            error: [0.01, 0.0, -0.02, 0.1, 0.2, 0.3],
            covariance: (0..36).map(f64::from).collect(),
            features: [(Feature::InlierRatio, 0.8)].into(),
        };
        let file = tempfile::tempdir().unwrap().keep().join("a.samples.jsonl");
        write(&file, &[sample.clone(), sample.clone()]).unwrap();
        assert_eq!(read_lines::<Sample>(&file).unwrap(), [sample.clone(), sample.clone()]);
        assert!(sample.is_better() && sample.covariance()[35] == 35.0);
        assert!(sample.features().get(Feature::InlierRms).is_nan());
    }
}
