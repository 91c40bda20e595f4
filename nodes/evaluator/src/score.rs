use crate::depth::{Depths, TestDepth};
use crate::evaluate::GateStep;
use crate::{
    EstimateDetails, EvalDataset, EvalError, EvalImage, EvalModel, GateErrors, InstanceErrors, NamedEstimates,
};
use nalgebra::Point3;
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_metrics::{
    Estimate, MatrixPose, add_m, add_threshold_m, adi_m, mahalanobis2, match_greedy, mspd_px, mspd_scale,
    mspd_thresholds, mssd_m, mssd_thresholds, nearest_symmetric, pose_error, projection_px, rotation_error_rad,
    translation_error_m, vsd_thresholds, within_5cm_5deg,
};
use std::collections::BTreeMap;

/// Estimates of one image and object, each with its index in the set.
type Candidates<'a> = Vec<(usize, &'a Estimate)>;

/// The estimates of a set by scene, image and object.
pub(crate) struct Indexed<'a> {
    by_object: BTreeMap<(u32, u32, u32), Candidates<'a>>,
    details: &'a [EstimateDetails],
}

impl<'a> Indexed<'a> {
    pub(crate) fn new(set: &'a NamedEstimates) -> Self {
        let mut by_object: BTreeMap<_, Candidates> = BTreeMap::new();
        for (i, e) in set.estimates.iter().enumerate() {
            by_object.entry((e.scene_id, e.image_id, e.object_id)).or_default().push((i, e));
        }
        Self { by_object, details: &set.details }
    }
}

/// The errors of one estimate against one true instance, in the units of their thresholds.
struct PairErrors {
    /// ADD, or ADI for a symmetric object, metres.
    add_s_m: f64,
    /// MSSD in diameters.
    mssd: f64,
    /// MSPD in pixels of an image 640 wide.
    mspd: f64,
    /// VSD for each tau.
    vsd: [f64; 10],
}

/// The errors of all instances that are to be found in an image, for each set of estimates.
pub(crate) fn score_image(
    dataset: &EvalDataset,
    image: &EvalImage,
    sets: &[Indexed<'_>],
) -> Result<Vec<Vec<InstanceErrors>>, EvalError> {
    let test = TestDepth::of(dataset, image)?;
    let mut by_set = vec![Vec::new(); sets.len()];
    for object_id in image.targets.keys() {
        let truth: Vec<usize> =
            (0..image.truth.len()).filter(|i| image.valid[*i] && image.truth[*i].object_id == *object_id).collect();
        for (set, out) in sets.iter().zip(&mut by_set) {
            let empty = Candidates::new();
            let candidates = set.by_object.get(&(image.scene_id, image.frame.image_id, *object_id)).unwrap_or(&empty);
            let (object_id, truth, details) = (*object_id, truth.as_slice(), set.details);
            let object = Object { dataset, image, test: &test, object_id, truth, details };
            out.extend(object.score(candidates)?);
        }
    }
    Ok(by_set)
}

/// VSD of one pose pair in an image, for each of the benchmark's tolerances: against the image's depth, or rendered
/// depth where it has none.
///
/// # Errors
/// When the depth image cannot be read or the object is unknown.
pub fn vsd_of_pair(
    dataset: &EvalDataset,
    image: &EvalImage,
    object_id: u32,
    est: &MatrixPose,
    gt: &MatrixPose,
) -> Result<[f64; 10], EvalError> {
    let test = TestDepth::of(dataset, image)?;
    let object = dataset.objects.get(object_id)?;
    let model = &dataset.models[&object_id];
    let depths = Depths::render(image, &test, (object, model), std::slice::from_ref(est), std::slice::from_ref(gt));
    Ok(depths.vsd(0, 0, object.diameter_m))
}

/// One object in one image.
struct Object<'a> {
    dataset: &'a EvalDataset,
    image: &'a EvalImage,
    test: &'a TestDepth,
    object_id: u32,
    /// The instances to be found, as indices of the image's truth.
    truth: &'a [usize],
    /// What is known of the set's estimates beside their poses, or nothing.
    details: &'a [EstimateDetails],
}

impl Object<'_> {
    fn score(&self, candidates: &Candidates) -> Result<Vec<InstanceErrors>, EvalError> {
        let top = self.image.targets.get(&self.object_id).copied().unwrap_or(0) as usize;
        let mut best: Candidates = candidates.clone();
        best.sort_by(|a, b| b.1.score.total_cmp(&a.1.score));
        best.truncate(top);
        let pairs = self.pairs(&best)?;
        let model = &self.dataset.models[&self.object_id];
        let scores: Vec<f64> = best.iter().map(|(_, e)| e.score).collect();
        let matched = |threshold: f64, error: &dyn Fn(&PairErrors) -> f64| {
            let errors: Vec<Vec<f64>> = pairs.iter().map(|row| row.iter().map(error).collect()).collect();
            match_greedy(&errors, &scores, &vec![true; self.truth.len()], threshold, top)
        };
        let nearest = matched(f64::INFINITY, &|p| p.add_s_m);
        let add_s = matched(add_threshold_m(model.diameter_m), &|p| p.add_s_m);
        let mssd = mssd_thresholds().map(|t| matched(t, &|p| p.mssd));
        let mspd = mspd_thresholds().map(|t| matched(t, &|p| p.mspd));
        let vsd: Vec<[Vec<Option<usize>>; 10]> =
            (0..10).map(|tau| vsd_thresholds().map(|t| matched(t, &|p| p.vsd[tau]))).collect();
        let record = |g: usize| {
            let mut errors = match nearest[g] {
                Some(e) => self.matched_errors(best[e], g, &pairs[e][g], model),
                None => self.unmatched(g),
            };
            errors.add_s_correct = add_s[g].is_some();
            errors.mssd_met = std::array::from_fn(|i| mssd[i][g].is_some());
            errors.mspd_met = std::array::from_fn(|i| mspd[i][g].is_some());
            errors.vsd_met = std::array::from_fn(|i| vsd.iter().filter(|of_tau| of_tau[i][g].is_some()).count() as u32);
            errors
        };
        Ok((0..self.truth.len()).map(record).collect())
    }

    /// `[estimate][instance]`.
    fn pairs(&self, candidates: &Candidates) -> Result<Vec<Vec<PairErrors>>, EvalError> {
        let model = &self.dataset.models[&self.object_id];
        let object = self.dataset.objects.get(self.object_id)?;
        let est: Vec<MatrixPose> = candidates.iter().map(|(_, e)| e.camera_from_object).collect();
        let gt: Vec<MatrixPose> = self.truth.iter().map(|i| self.image.truth[*i].camera_from_object).collect();
        let depths = Depths::render(self.image, self.test, (object, model), &est, &gt);
        let intrinsics = &self.image.frame.intrinsics;
        let pair = |e: usize, g: usize| PairErrors {
            add_s_m: add_s_m(model, &est[e], &gt[g]),
            mssd: mssd_m(&model.points, &est[e], &gt[g], &model.symmetries) / model.diameter_m,
            mspd: mspd_px(&model.points, &est[e], &gt[g], intrinsics, &model.symmetries)
                * mspd_scale(self.image.size_px.0),
            vsd: depths.vsd(e, g, model.diameter_m),
        };
        Ok((0..est.len()).map(|e| (0..gt.len()).map(|g| pair(e, g)).collect()).collect())
    }

    fn unmatched(&self, g: usize) -> InstanceErrors {
        InstanceErrors {
            scene_id: self.image.scene_id,
            image_id: self.image.frame.image_id,
            object_id: self.object_id,
            instance: self.truth[g] as u32,
            visible_fraction: self.image.truth[self.truth[g]].visible_fraction,
            ..InstanceErrors::default()
        }
    }

    fn matched_errors(
        &self,
        found: (usize, &Estimate),
        g: usize,
        pair: &PairErrors,
        model: &EvalModel,
    ) -> InstanceErrors {
        let (row, est) = (found.0, &found.1.camera_from_object);
        let gt = self.image.truth[self.truth[g]].camera_from_object;
        let hull = self.dataset.objects.get(self.object_id).map_or(&[][..], |object| &object.hull_m);
        let boxes = [est, &gt].map(|pose| projected_box(hull, pose, &self.image.frame.intrinsics));
        let gt = nearest_symmetric(est, &gt, &model.symmetries);
        let finite = |v: f64| Some(v).filter(|v| v.is_finite());
        let middle = self.dataset.objects.get(self.object_id).map(|object| object.box_centre_m());
        let depth = middle.map_or(None, |middle| Depth::between(est, &gt, middle));
        let details = self.details.get(row);
        let distances = details.and_then(|d| mahalanobis2(&pose_error(est, &gt), d.covariance.as_ref()?));
        InstanceErrors {
            depth_of_diameter: depth.as_ref().map(|d| d.error_m / model.diameter_m),
            add_s_true_depth_of_diameter: depth.map(|d| add_s_m(model, &d.corrected, &gt) / model.diameter_m),
            confidence: details.and_then(|d| d.confidence),
            mahalanobis2: distances.map(|d| [d.pose, d.translation, d.rotation]),
            gate: details.map_or_else(Vec::new, |d| d.gate.iter().map(|step| gate_errors(model, step, &gt)).collect()),
            estimate: Some(row),
            add_s_m: finite(pair.add_s_m),
            add_s_of_diameter: finite(pair.add_s_m / model.diameter_m),
            mssd_of_diameter: finite(pair.mssd),
            mspd_px: finite(pair.mspd),
            vsd: Some(pair.vsd.iter().sum::<f64>() / 10.0),
            rotation_deg: Some(rotation_error_rad(est, &gt).to_degrees()),
            translation_m: Some(translation_error_m(est, &gt)),
            projection_px: finite(projection_px(&model.points, est, &gt, &self.image.frame.intrinsics)),
            box_overlap: overlap(&boxes[0], &boxes[1]),
            within_5cm_5deg: within_5cm_5deg(est, &gt, &[Pose::identity()]),
            ..self.unmatched(g)
        }
    }
}

/// ADD, or ADI for a symmetric object, metres.
fn add_s_m(model: &EvalModel, est: &MatrixPose, gt: &MatrixPose) -> f64 {
    if model.symmetric { adi_m(&model.points, est, gt) } else { add_m(&model.points, est, gt) }
}

fn gate_errors(model: &EvalModel, step: &GateStep, gt: &MatrixPose) -> GateErrors {
    let of = |pose: Pose| add_s_m(model, &pose.into(), gt) / model.diameter_m;
    GateErrors {
        before_of_diameter: of(step.before),
        after_of_diameter: of(step.after),
        accepted: step.accepted,
        evidence: step.evidence.clone(),
    }
}

/// What is wrong with an estimate along the viewing ray.
struct Depth {
    /// Estimated minus true depth of a point, metres.
    error_m: f64,
    /// The estimate with that point moved along its viewing ray to the true depth.
    corrected: MatrixPose,
}

impl Depth {
    /// Of a point of the object's frame; `None` when one of its depths is not before the camera.
    fn between(est: &MatrixPose, gt: &MatrixPose, point: Point3<f64>) -> Option<Self> {
        let (at, truth) = (est.pose() * point, gt.pose() * point);
        if !(at.z > 0.0 && truth.z > 0.0) {
            return None;
        }
        let shift = at.coords * (truth.z / at.z - 1.0);
        let corrected = Pose::from_parts((est.translation_m() + shift).into(), est.pose().rotation);
        Some(Self { error_m: at.z - truth.z, corrected: corrected.into() })
    }
}

/// Lowest and highest x and y of the projected points, pixels; `None` when one is behind the camera.
fn projected_box(hull_m: &[Point3<f64>], pose: &MatrixPose, camera: &Intrinsics) -> Option<[[f64; 2]; 2]> {
    let pose = pose.pose();
    let mut range = [[f64::MAX; 2], [f64::MIN; 2]];
    for point in hull_m {
        let pixel = camera.project(&(pose * point))?;
        for k in 0..2 {
            (range[0][k], range[1][k]) = (range[0][k].min(pixel[k]), range[1][k].max(pixel[k]));
        }
    }
    Some(range)
}

/// Intersection over union of two boxes.
fn overlap(a: &Option<[[f64; 2]; 2]>, b: &Option<[[f64; 2]; 2]>) -> Option<f64> {
    let (a, b) = ((*a)?, (*b)?);
    let area = |low: [f64; 2], high: [f64; 2]| (high[0] - low[0]).max(0.0) * (high[1] - low[1]).max(0.0);
    let low = [0, 1].map(|k| a[0][k].max(b[0][k]));
    let high = [0, 1].map(|k| a[1][k].min(b[1][k]));
    let shared = area(low, high);
    Some(shared / (area(a[0], a[1]) + area(b[0], b[1]) - shared))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_true_depth_keeps_the_projection() {
        let k = Intrinsics { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0 };
        let middle = Point3::new(0.02, -0.01, 0.03);
        let gt: Pose = Pose::new([0.1, -0.2, 0.9].into(), [0.3, 0.2, -0.1].into());
        let est = Pose::new([0.11, -0.19, 1.05].into(), [0.35, 0.2, -0.1].into());
        let depth = Depth::between(&est.into(), &gt.into(), middle).unwrap();
        let corrected = depth.corrected.pose();
        assert!((depth.error_m - ((est * middle).z - (gt * middle).z)).abs() < 1e-12);
        assert!(((corrected * middle).z - (gt * middle).z).abs() < 1e-12);
        let pixel = |pose: &Pose| k.project(&(pose * middle)).unwrap();
        assert!((pixel(&corrected) - pixel(&est)).norm() < 1e-9);
        assert!(corrected.rotation.angle_to(&est.rotation) < 1e-12);
        let behind = Pose::translation(0.0, 0.0, -1.0);
        assert!(Depth::between(&behind.into(), &gt.into(), middle).is_none());
    }
}
