use crate::{EstimateDetails, EvalError, GateStep};
use pseudoflow_geometry::pose_from_quaternion;
use pseudoflow_metrics::Estimate;
use pseudoflow_msgs::{GateDecision, ObjectPose, PoseSource};
use pseudoflow_runtime::read_lines;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What is known of the poses of an image beside them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageDetails {
    scene_id: u32,
    image_id: u32,
    /// In the order of the result file.
    poses: Vec<PoseDetails>,
    gate: Vec<Decision>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseDetails {
    object_id: u32,
    instance: u32,
    /// Row-major 6 x 6 of a refined pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    covariance: Option<Vec<f64>>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Decision {
    object_id: u32,
    instance: u32,
    accepted: bool,
    /// Unit quaternion x, y, z, w and metres.
    before: ([f64; 4], [f64; 3]),
    after: ([f64; 4], [f64; 3]),
    /// Row-major 6 x 6.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    solver_covariance: Option<Vec<f64>>,
    evidence: BTreeMap<String, f64>,
}

impl ImageDetails {
    pub(super) fn new((scene_id, image_id): (u32, u32), poses: &[ObjectPose], decisions: &[GateDecision]) -> Self {
        let poses = poses.iter().map(|pose| PoseDetails {
            object_id: pose.object_id,
            instance: pose.instance,
            covariance: (pose.source == PoseSource::Refined as u32).then(|| pose.covariance.to_vec()),
        });
        Self { scene_id, image_id, poses: poses.collect(), gate: decisions.iter().map(Decision::new).collect() }
    }

    /// All decisions of the gate, each with the ids of its object and of its instance; an error where a pose of the file is none.
    pub fn decisions(&self) -> impl Iterator<Item = ((u32, u32), Result<GateStep, EvalError>)> {
        self.gate.iter().map(|d| ((d.object_id, d.instance), d.step()))
    }

    /// The gate's decisions on one instance.
    fn steps(&self, pose: &PoseDetails) -> Result<Vec<GateStep>, EvalError> {
        let is_its = |d: &&Decision| (d.object_id, d.instance) == (pose.object_id, pose.instance);
        self.gate.iter().filter(is_its).map(Decision::step).collect()
    }
}

impl Decision {
    fn new(decision: &GateDecision) -> Self {
        let named = GateDecision::EVIDENCE.into_iter().zip(decision.evidence);
        Self {
            object_id: decision.object_id,
            instance: decision.instance,
            accepted: decision.accepted != 0,
            before: (decision.before_rotation_xyzw, decision.before_translation_m),
            after: (decision.after_rotation_xyzw, decision.after_translation_m),
            solver_covariance: Some(decision.solver_covariance.to_vec()),
            evidence: named.filter(|(_, v)| v.is_finite()).map(|(name, v)| (name.to_owned(), v)).collect(),
        }
    }

    fn step(&self) -> Result<GateStep, EvalError> {
        let pose = |(rotation, translation): &([f64; 4], [f64; 3])| {
            let read = pose_from_quaternion(rotation, translation);
            read.map_err(|error| EvalError::DetailsFile { what: format!("object {}: {error}", self.object_id) })
        };
        Ok(GateStep {
            before: pose(&self.before)?,
            after: pose(&self.after)?,
            accepted: self.accepted,
            solver_covariance: self.solver_covariance.as_deref().and_then(|values| values.try_into().ok()),
            evidence: self.evidence.clone(),
        })
    }
}

/// Reads the details that a results node wrote, by scene and image; of an image that comes twice (after an interruption) the
/// last line holds.
///
/// # Errors
/// When the file cannot be read, or a line is no such details.
pub fn read_details(path: &Path) -> Result<BTreeMap<(u32, u32), ImageDetails>, EvalError> {
    let lines = read_lines::<ImageDetails>(path).map_err(|error| EvalError::DetailsFile { what: error.to_string() })?;
    Ok(lines.into_iter().map(|details| ((details.scene_id, details.image_id), details)).collect())
}

/// What is known of each estimate of a result file, from the details of each pass; the last are those of the file itself.
///
/// # Errors
/// When details and file do not belong together.
pub fn details_of_estimates(
    estimates: &[Estimate],
    passes: &[BTreeMap<(u32, u32), ImageDetails>],
) -> Result<Vec<EstimateDetails>, EvalError> {
    let mut all = Vec::with_capacity(estimates.len());
    let image = |e: &Estimate| (e.scene_id, e.image_id);
    for of_image in estimates.chunk_by(|a, b| image(a) == image(b)) {
        let steps: Vec<&ImageDetails> = passes.iter().filter_map(|pass| pass.get(&image(&of_image[0]))).collect();
        let Some(last) = steps.last().filter(|_| steps.len() == passes.len()) else {
            all.resize(all.len() + of_image.len(), EstimateDetails::default());
            continue;
        };
        let objects = last.poses.iter().map(|pose| pose.object_id);
        if !objects.eq(of_image.iter().map(|e| e.object_id)) {
            let (scene, image) = image(&of_image[0]);
            return Err(EvalError::DetailsFile {
                what: format!("scene {scene}, image {image}: details of other poses"),
            });
        }
        for (estimate, pose) in of_image.iter().zip(&last.poses) {
            let gate: Vec<Vec<GateStep>> = steps.iter().map(|step| step.steps(pose)).collect::<Result<_, _>>()?;
            all.push(EstimateDetails {
                confidence: Some(estimate.score),
                covariance: pose.covariance.as_deref().and_then(|values| values.try_into().ok()),
                gate: gate.concat(),
            });
        }
    }
    Ok(all)
}
