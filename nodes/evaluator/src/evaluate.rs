use crate::score::{Indexed, score_image};
use crate::{EvalDataset, EvalError, InstanceErrors, ObjectInfo, Report, Scores, VsdDepth};
use pseudoflow_geometry::Pose;
use pseudoflow_metrics::Estimate;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Estimates under the name that their block in the report has: `init` and `refined`, or `estimate`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NamedEstimates {
    /// Name.
    pub name: String,
    /// Estimates.
    pub estimates: Vec<Estimate>,
    /// What is known of each estimate beside its pose: as many as there are estimates, or none.
    pub details: Vec<EstimateDetails>,
}

/// What a refiner says of an estimate beside its pose. Nothing of it changes a score.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EstimateDetails {
    /// Probability that ADD(-S) is below a tenth of the diameter, 0..1.
    pub confidence: Option<f64>,
    /// Row-major 6 x 6: x, y, z (m), rotation (rad), camera axes.
    pub covariance: Option<[f64; 36]>,
    /// The gate's decisions, pass after pass.
    pub gate: Vec<GateStep>,
}

/// One decision of the gate, `camera_from_object`.
#[derive(Debug, Clone, PartialEq)]
pub struct GateStep {
    /// The pose that the refinement began from.
    pub before: Pose,
    /// The refined pose, taken or not.
    pub after: Pose,
    /// Whether it was taken.
    pub accepted: bool,
    /// The solver's own covariance of the refined pose, row-major 6 x 6, not scaled by what was learnt; `None` in files of
    /// earlier versions.
    pub solver_covariance: Option<[f64; 36]>,
    /// What the decision was made from, and the claimed probability that it is better (`better`).
    pub evidence: BTreeMap<String, f64>,
}

impl NamedEstimates {
    /// Estimates of which nothing more is known.
    #[must_use]
    pub fn new(name: &str, estimates: Vec<Estimate>) -> Self {
        Self { name: name.to_owned(), estimates, details: Vec::new() }
    }
}

/// Scores sets of estimates on a dataset, in parallel over images. `progress` is told the images done and their total,
/// from any thread. The report depends on the input only.
///
/// # Errors
/// When names repeat, details and estimates of a set differ in number, or a depth image cannot be read.
pub fn evaluate(
    dataset: &EvalDataset,
    sets: &[NamedEstimates],
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Report, EvalError> {
    let names: Vec<String> = sets.iter().map(|s| s.name.clone()).collect();
    if names.is_empty() || names.iter().enumerate().any(|(i, name)| names[..i].contains(name)) {
        return Err(EvalError::SetNames { names });
    }
    if let Some(set) = sets.iter().find(|s| !s.details.is_empty() && s.details.len() != s.estimates.len()) {
        let (estimates, details) = (set.estimates.len(), set.details.len());
        return Err(EvalError::Details { set: set.name.clone(), estimates, details });
    }
    let indices: Vec<Indexed> = sets.iter().map(Indexed::new).collect();
    let done = AtomicUsize::new(0);
    let of_image = |image| {
        let scored = score_image(dataset, image, &indices);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, dataset.images.len());
        scored
    };
    let by_image: Vec<Vec<Vec<InstanceErrors>>> = dataset.images.par_iter().map(of_image).collect::<Result<_, _>>()?;
    let mut instances: BTreeMap<String, Vec<InstanceErrors>> = BTreeMap::new();
    for (name, errors) in by_image.into_iter().flat_map(|image| names.iter().cloned().zip(image)) {
        instances.entry(name).or_default().extend(errors);
    }
    let mut report = Report {
        dataset: dataset.name.clone(),
        split: dataset.split.clone(),
        vsd_depth: vsd_depth(dataset),
        notes: dataset.notes.clone(),
        overall: BTreeMap::new(),
        per_object: BTreeMap::new(),
        objects: objects(dataset, &instances),
        instances,
        sets: names,
        diagnosis: BTreeMap::new(),
        object_diagnosis: BTreeMap::new(),
        without: None,
    };
    for set in sets {
        add_scores(&mut report, dataset, set);
        add_diagnosis(&mut report, &set.name);
    }
    report.notes.extend(vsd_note(report.vsd_depth));
    Ok(report)
}

fn vsd_depth(dataset: &EvalDataset) -> VsdDepth {
    let with_depth = dataset.images.iter().filter(|image| image.frame.depth_path.is_some()).count();
    match with_depth {
        0 => VsdDepth::Rendered,
        n if n == dataset.images.len() => VsdDepth::Sensor,
        _ => VsdDepth::Mixed,
    }
}

fn vsd_note(depth: VsdDepth) -> Option<String> {
    let images = match depth {
        VsdDepth::Sensor => return None,
        VsdDepth::Rendered => "The dataset has no depth images",
        VsdDepth::Mixed => "Some images have no depth",
    };
    Some(format!(
        "{images}: there VSD compares with rendered depth of the visible surface (all true instances, the nearest \
         surface at each pixel). Such VSD is not comparable to the benchmark's."
    ))
}

fn objects(dataset: &EvalDataset, instances: &BTreeMap<String, Vec<InstanceErrors>>) -> BTreeMap<u32, ObjectInfo> {
    let ids = instances.values().flatten().map(|i| i.object_id);
    let info = |id: u32| {
        let (object, model) = (dataset.objects.get(id).ok()?, dataset.models.get(&id)?);
        let name = object.name.clone();
        Some((id, ObjectInfo { name, diameter_m: object.diameter_m, symmetric: model.symmetric }))
    };
    ids.filter_map(info).collect()
}

fn add_scores(report: &mut Report, dataset: &EvalDataset, set: &NamedEstimates) {
    let instances: Vec<&InstanceErrors> = report.instances.get(&set.name).into_iter().flatten().collect();
    let scored: BTreeMap<(u32, u32), &BTreeMap<u32, u32>> =
        dataset.images.iter().map(|image| ((image.scene_id, image.frame.image_id), &image.targets)).collect();
    let is_target =
        |e: &&Estimate| scored.get(&(e.scene_id, e.image_id)).is_some_and(|targets| targets.contains_key(&e.object_id));
    let unused = set.estimates.iter().filter(|e| !is_target(e)).count();
    if unused > 0 {
        let text = format!(
            "{unused} of {} estimates of `{}` are of no target and were not scored.",
            set.estimates.len(),
            set.name
        );
        report.notes.push(text);
    }
    let times = times_ms(&set.estimates);
    let all_times: Option<Vec<f64>> = times.as_ref().map(|times| times.iter().map(|(_, ms)| *ms).collect());
    report.overall.insert(set.name.clone(), Scores::of(&instances, all_times.as_deref()));
    for object_id in report.objects.keys() {
        let of_object: Vec<&InstanceErrors> = instances.iter().filter(|i| i.object_id == *object_id).copied().collect();
        let its_times: Option<Vec<f64>> =
            times.as_ref().map(|times| times.iter().filter(|(id, _)| id == object_id).map(|(_, ms)| *ms).collect());
        let scores = Scores::of(&of_object, its_times.as_deref());
        report.per_object.entry(*object_id).or_default().insert(set.name.clone(), scores);
    }
}

fn add_diagnosis(report: &mut Report, set: &str) {
    let all = report.diagnose(set, &|_| true);
    report.diagnosis.insert(set.to_owned(), all);
    for id in report.objects.keys().copied().collect::<Vec<_>>() {
        let of_object = report.diagnose(set, &|i| i.object_id == id);
        report.object_diagnosis.entry(id).or_default().insert(set.to_owned(), of_object);
    }
}

/// Object and milliseconds of each estimate: its share of the image's time. `None` when any time is missing, as in
/// bop_toolkit.
fn times_ms(estimates: &[Estimate]) -> Option<Vec<(u32, f64)>> {
    let mut counts: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for e in estimates {
        *counts.entry((e.scene_id, e.image_id)).or_insert(0.0) += 1.0;
    }
    let share = |e: &Estimate| Some((e.object_id, e.image_time_s? * 1e3 / counts[&(e.scene_id, e.image_id)]));
    estimates.iter().map(share).collect()
}
