use super::expectation::is_visible;
use super::{Arrival, ArrivedPose, Expectation, LiveRun};
use crate::EvalError;
use pseudoflow_geometry::pose_from_quaternion;
use pseudoflow_imaging::Object;
use pseudoflow_metrics::{MatrixPose, ModelPoints, TruthInstance, add_m, adi_m, match_greedy};
use std::collections::BTreeMap;

/// What ADD(-S) of an object is measured with.
pub(crate) struct Yardstick {
    pub(crate) points: ModelPoints,
    pub(crate) diameter_m: f64,
    /// Whether ADD(-S) means ADI.
    pub(crate) symmetric: bool,
}

impl Yardstick {
    pub(crate) fn new(object: &Object) -> Result<Self, EvalError> {
        let points = ModelPoints::new(&object.mesh.points());
        Ok(Self {
            points: points.map_err(|source| EvalError::Points { object_id: object.id, source })?,
            diameter_m: object.diameter_m,
            symmetric: !object.symmetries.is_trivial(),
        })
    }
}

/// What became of one expected instance in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Verdict {
    pub(crate) frame: usize,
    pub(crate) object_id: u32,
    /// Visible share, where it is known.
    pub(crate) visible: Option<f64>,
    /// Whether it is visible enough to be expected.
    pub(crate) expected: bool,
    /// Whether any answer came for the frame.
    pub(crate) answered: bool,
    /// ADD(-S) of its pose in diameters; `None` without one.
    pub(crate) error: Option<f64>,
    /// Whether a pose was published that claims to be measured.
    pub(crate) claimed: bool,
    /// From when the frame was due to when its poses were here, milliseconds.
    pub(crate) age_ms: Option<f64>,
}

impl Verdict {
    /// Whether the pose is within so many diameters.
    pub(crate) fn is_right(&self, limit: f64) -> bool {
        self.error.is_some_and(|error| error < limit)
    }
}

/// Judges every expected instance of every frame that was played, hidden ones too.
pub(crate) fn verdicts(
    run: &LiveRun,
    expectation: &Expectation,
    models: &BTreeMap<u32, Yardstick>,
) -> Result<Vec<Verdict>, EvalError> {
    let arrivals: BTreeMap<u64, &Arrival> = run.arrivals.iter().map(|arrival| (arrival.index, arrival)).collect();
    let mut verdicts = Vec::new();
    for (frame, (scene_id, image_id)) in run.frames.iter().enumerate() {
        let arrival = arrivals.get(&(frame as u64)).copied();
        let instances = expectation.of(*scene_id, *image_id);
        for (object_id, model) in models {
            let of_object: Vec<&TruthInstance> = instances.iter().filter(|i| i.object_id == *object_id).collect();
            judge(frame, arrival, *object_id, model, &of_object, &mut verdicts)?;
        }
    }
    Ok(verdicts)
}

fn judge(
    frame: usize,
    arrival: Option<&Arrival>,
    object_id: u32,
    model: &Yardstick,
    instances: &[&TruthInstance],
    verdicts: &mut Vec<Verdict>,
) -> Result<(), EvalError> {
    let published = |pose: &&ArrivedPose| pose.object_id == object_id && pose.published;
    let poses: Vec<&ArrivedPose> = arrival.iter().flat_map(|a| &a.poses).filter(published).collect();
    let errors: Vec<Vec<f64>> = poses.iter().map(|pose| errors(model, pose, instances)).collect::<Result<_, _>>()?;
    let scores: Vec<f64> = poses.iter().map(|pose| pose.score).collect();
    let found = match_greedy(&errors, &scores, &vec![true; instances.len()], f64::INFINITY, poses.len());
    for (g, instance) in instances.iter().enumerate() {
        verdicts.push(Verdict {
            frame,
            object_id,
            visible: instance.visible_fraction,
            expected: is_visible(instance),
            answered: arrival.is_some(),
            error: found[g].map(|e| errors[e][g]),
            claimed: found[g].is_some_and(|e| !poses[e].predicted),
            age_ms: found[g].and(arrival).map(|arrival| arrival.age_ms),
        });
    }
    Ok(())
}

/// ADD(-S) of a pose against each instance, diameters.
fn errors(model: &Yardstick, pose: &ArrivedPose, instances: &[&TruthInstance]) -> Result<Vec<f64>, EvalError> {
    let measured = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m);
    let estimate: MatrixPose = measured.map_err(|error| EvalError::Arrival(error.to_string()))?.into();
    let of = |instance: &&TruthInstance| {
        let error_m = if model.symmetric { adi_m } else { add_m };
        error_m(&model.points, &estimate, &instance.camera_from_object) / model.diameter_m
    };
    Ok(instances.iter().map(of).collect())
}
