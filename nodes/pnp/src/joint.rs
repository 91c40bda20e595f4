//! Poses from contour, flow and rough pose together.

use crate::PnpNodeConfig;
use crate::gate::{ContourScale, Features, Gate, Stage, StageModel};
use crate::node::{FLOW, FRAME, INITIAL_POSES, VIEWS};
use crate::node::{Look, Refinement, kept_pose};
use crate::views::{ViewPlanes, belong_together, evidence, planes};
use nalgebra::Point3;
use pseudoflow_contour::{ContourModel, Hider, Image, ModelSettings, RegionStatus, image_of_bytes, load_or_make};
use pseudoflow_geometry::{Intrinsics, Pose, pose_from_quaternion, quaternion_xyzw};
use pseudoflow_imaging::{ObjectSet, RgbImage};
use pseudoflow_msgs::{FlowFields, ObjectPose, PoseSource, PoseStatus, ReferenceViews};
use pseudoflow_runtime::{Inputs, NodeError, OrBadInput, bad_input};
use pseudoflow_solver::{FlowEvidence, JointResult, JointSolver, JointTask, PixelBuffer, PnpResult, PnpStatus};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What poses are solved from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stages {
    /// Flow alone.
    #[default]
    Flow,
    /// Contour and rough pose: no network at all.
    Region,
    /// Flow, contour and rough pose in one cost.
    Joint,
}

impl Stages {
    /// The part of the gate's model that was learnt for it.
    #[must_use]
    pub fn learnt(self) -> Stage {
        match self {
            Self::Flow => Stage::Flow,
            Self::Region => Stage::Region,
            Self::Joint => Stage::Joint,
        }
    }
}

/// What is known of an object.
struct Known {
    model: ContourModel,
    diameter_m: f64,
}

/// The joint solver with the contours of an object set.
pub(crate) struct Joint {
    stages: Stages,
    objects: BTreeMap<u32, Known>,
    config: PnpNodeConfig,
    /// With the size of the crops that its thresholds are for.
    solver: Option<(usize, JointSolver)>,
    buffer: PixelBuffer,
    gate: Gate,
    model: StageModel,
}

/// Side of the crops where there are none.
const NO_CROP_PX: usize = 256;

/// One pose to refine.
struct Instance<'a> {
    given: ObjectPose,
    rough: Pose,
    planes: Option<ViewPlanes<'a>>,
}

impl Joint {
    /// What `pseudoflow check` can say before anything starts.
    pub(crate) fn check(config: &PnpNodeConfig) -> Result<(), NodeError> {
        config.joint.region.validate()?;
        let Some(folder) = &config.objects else {
            return match config.stages {
                Stages::Flow => Ok(()),
                stages => Err(format!("`stages: {stages:?}` needs `objects`: give the BOP models folder").into()),
            };
        };
        Ok(ObjectSet::check(folder)?)
    }

    /// `None` for flow alone. Contour models are made where they are not kept yet.
    pub(crate) fn open(config: &PnpNodeConfig, model: &StageModel) -> Result<Option<Self>, NodeError> {
        let Some(folder) = config.objects.as_ref().filter(|_| config.stages != Stages::Flow) else { return Ok(None) };
        let cache = config.contours.clone().unwrap_or_else(|| std::env::temp_dir().join("pseudoflow-contours"));
        let mut objects = BTreeMap::new();
        for object in ObjectSet::load(folder)?.iter() {
            let contour = load_or_make(&object.mesh, &ModelSettings::default(), &cache)?;
            objects.insert(object.id, Known { model: contour, diameter_m: object.diameter_m });
        }
        log::info!("contours of {} objects; models are kept in {}", objects.len(), cache.display());
        Ok(Some(Self {
            stages: config.stages,
            objects,
            config: config.clone(),
            solver: None,
            buffer: PixelBuffer::default(),
            gate: Gate::new(),
            model: model.clone(),
        }))
    }

    /// What became of each pose of a frame; nearer objects first, since they hide those behind.
    pub(crate) fn looks(&mut self, inputs: &dyn Inputs, seed: u64) -> Result<Vec<Look>, NodeError> {
        let frame = FRAME.read(inputs)?;
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let rgb = image_of_bytes(frame.rgb, frame.header.width as usize, frame.header.height as usize)
            .or_bad_input(FRAME.name())?;
        let camera = Intrinsics { fx, fy, cx, cy };
        let mut looks = Vec::new();
        let mut instances = match self.stages {
            Stages::Region => of_poses(rough_poses(inputs)?, &mut looks),
            _ => {
                let views = VIEWS.read(inputs)?;
                let flow = FLOW.read(inputs)?;
                of_views(&views, &flow, &mut looks)?
            }
        };
        instances.sort_by(|a, b| a.rough.translation.z.total_cmp(&b.rough.translation.z));
        let mut found: Vec<(ObjectPose, Pose)> = instances.iter().map(|i| (i.given, i.rough)).collect();
        for (i, instance) in instances.iter().enumerate() {
            let (look, pose) = self.look(instance, &found, (&rgb, camera), seed)?;
            found[i].1 = pose;
            looks.push(look);
        }
        Ok(looks)
    }

    fn look(
        &mut self,
        instance: &Instance<'_>,
        all: &[(ObjectPose, Pose)],
        (rgb, intrinsics): (&RgbImage, Intrinsics),
        seed: u64,
    ) -> Result<(Look, Pose), NodeError> {
        let id = instance.given.object_id;
        let size_px = instance.planes.as_ref().map_or(NO_CROP_PX, |p| p.field.size_px);
        self.open_solver(size_px)?;
        let Self { objects, solver, buffer, .. } = self;
        let known = objects.get(&id).ok_or_else(|| unknown(id))?;
        let (_, solver) = solver.as_mut().ok_or("no solver")?;
        let hiders: Vec<Hider<'_>> = all
            .iter()
            .filter(|(given, _)| given.identity() != instance.given.identity())
            .filter_map(|(given, pose)| {
                objects.get(&given.object_id).map(|k| Hider { model: &k.model, camera_from_object: *pose })
            })
            .collect();
        let flow = match &instance.planes {
            Some(planes) => Some(FlowEvidence {
                correspondences: buffer.fill(&planes.field, usize::MAX)?,
                intrinsics: planes.field.intrinsics,
                size_px,
            }),
            None => None,
        };
        let task = JointTask {
            image: Image { rgb, intrinsics },
            model: &known.model,
            diameter_m: known.diameter_m,
            rough: instance.rough,
            hiders: &hiders,
            flow,
        };
        let result = solver.solve(&task, seed);
        log::debug!("object {id}: contour {}; cost {:.2}", result.region.status, result.cost);
        let look = match result.known {
            true => self.judged(instance, &result, intrinsics.fx)?,
            false => skipped(kept_pose(&instance.given, message_status(result.region.status), 0.0)),
        };
        // It hides others from where it goes out.
        let accepted = look.refinement.as_ref().is_some_and(|r| r.accepted);
        Ok((look, if accepted { result.camera_from_object } else { instance.rough }))
    }

    /// The pose that goes out, and how sure it is. Hypotheses of one instance are compared by how well flow and picture agree with them;
    /// without flow by their cost, which says less: it depends on how much of each is seen.
    fn judged(&mut self, instance: &Instance<'_>, result: &JointResult, focal_px: f64) -> Result<Look, NodeError> {
        let features = self.features(instance, result, focal_px)?;
        let verdict = self.model.verdict(&features);
        let given = &instance.given;
        let accepted = self.config.gate.as_ref().is_none_or(|gate| verdict.better >= gate.min_better);
        log::debug!("object {}: accepted {accepted}; {verdict:?}; {:?}", given.object_id, features.known());
        let tracked = given.source == PoseSource::Tracked as u32;
        let pose = match accepted {
            true => ObjectPose {
                status: PoseStatus::Ok as u32,
                source: PoseSource::Refined as u32,
                score: verdict.refined_right,
                rotation_xyzw: quaternion_xyzw(&result.camera_from_object),
                translation_m: result.camera_from_object.translation.vector.into(),
                covariance: self.model.covariance.apply(&result.covariance, verdict.refined_right),
                ..*given
            },
            false if tracked => kept_pose(given, PoseStatus::Ok, verdict.initial_right),
            false => kept_pose(given, PoseStatus::Rejected, verdict.initial_right),
        };
        let refinement = Refinement {
            before: instance.rough,
            after: result.camera_from_object,
            accepted,
            features,
            verdict,
            solver_covariance: result.covariance,
        };
        let merit = if instance.planes.is_some() { features.merit(accepted) } else { -result.cost };
        Ok(Look { pose, merit, refinement: Some(refinement) })
    }

    fn features(
        &mut self,
        instance: &Instance<'_>,
        result: &JointResult,
        focal_px: f64,
    ) -> Result<Features, NodeError> {
        let Self { objects, gate, config, .. } = self;
        let id = instance.given.object_id;
        let known = objects.get(&id).ok_or_else(|| unknown(id))?;
        let scale = ContourScale {
            rough: instance.rough,
            middle_m: known.model.centre_m(),
            diameter_m: known.diameter_m,
            focal_px,
            points: known.model.view(&result.camera_from_object).len(),
        };
        let pictures = match &instance.planes {
            Some(planes) => of_pictures(planes, result, config, gate)?,
            None => Features::default(),
        };
        Ok(pictures.with_contour(result, &scale))
    }

    /// A solver with the thresholds of a crop's size.
    fn open_solver(&mut self, size_px: usize) -> Result<(), NodeError> {
        if self.solver.as_ref().is_none_or(|(size, _)| *size != size_px) {
            let pnp = self.config.solver.clone().scaled_to(size_px);
            self.solver = Some((size_px, JointSolver::new(self.config.joint.clone(), pnp)?));
        }
        Ok(())
    }
}

/// What flow and pictures say of the joint pose.
fn of_pictures(
    planes: &ViewPlanes<'_>,
    result: &JointResult,
    config: &PnpNodeConfig,
    gate: &mut Gate,
) -> Result<Features, NodeError> {
    let solved = PnpResult {
        camera_from_object: result.camera_from_object,
        covariance: result.covariance,
        inlier_ratio: result.inlier_ratio.unwrap_or(0.0),
        inliers: result.pnp.as_ref().map_or(0, |pnp| pnp.inliers),
        rms_px: result.pnp.as_ref().map_or(0.0, |pnp| pnp.rms_px),
        status: PnpStatus::Ok,
    };
    let blocks_across = config.gate.clone().unwrap_or_default().blocks_across;
    let evidence = evidence(planes, &solved, blocks_across, gate)?;
    let threshold_px = config.solver.clone().scaled_to(planes.field.size_px).threshold_px;
    Ok(planes.features(&solved, &evidence, threshold_px))
}

fn message_status(status: RegionStatus) -> PoseStatus {
    match status {
        RegionStatus::Ok => PoseStatus::Ok,
        RegionStatus::NotFinite => PoseStatus::NotFinite,
        RegionStatus::NotInView => PoseStatus::NotVisible,
        RegionStatus::NoContour { .. } => PoseStatus::TooFewPoints,
        RegionStatus::OneColour { .. } => PoseStatus::Degenerate,
    }
}

/// The rough poses: those that came by their own port, else those that were rendered.
fn rough_poses(inputs: &dyn Inputs) -> Result<Vec<ObjectPose>, NodeError> {
    if INITIAL_POSES.has_come(inputs) || !VIEWS.has_come(inputs) {
        return Ok(INITIAL_POSES.read(inputs)?.poses.to_vec());
    }
    let views = VIEWS.read(inputs)?;
    let of_views = views.views.iter().step_by(views.header.views_per_instance as usize).map(|v| v.pose);
    Ok(of_views.chain(views.skipped.iter().copied()).collect())
}

fn skipped(pose: ObjectPose) -> Look {
    Look { pose, merit: f64::NEG_INFINITY, refinement: None }
}

fn unknown(id: u32) -> NodeError {
    bad_input("initial_poses", format!("object {id} is not in `objects`: give its set"))
}

/// What can be refined of rough poses; the others go to `looks` with their status.
fn of_poses(poses: Vec<ObjectPose>, looks: &mut Vec<Look>) -> Vec<Instance<'static>> {
    let mut instances = Vec::with_capacity(poses.len());
    for given in poses {
        match pose_from_quaternion(&given.rotation_xyzw, &given.translation_m) {
            Ok(rough) if (rough * Point3::origin()).z > 0.0 => {
                instances.push(Instance { given, rough, planes: None });
            }
            Ok(_) => looks.push(skipped(kept_pose(&given, PoseStatus::NotVisible, 0.0))),
            Err(_) => looks.push(skipped(kept_pose(&given, PoseStatus::NotFinite, 0.0))),
        }
    }
    instances
}

/// View 0 of each instance with its flow; what could not be rendered goes to `looks`.
fn of_views<'a>(
    views: &ReferenceViews<'a>,
    flow: &FlowFields<'a>,
    looks: &mut Vec<Look>,
) -> Result<Vec<Instance<'a>>, NodeError> {
    belong_together(views, flow).or_bad_input(FLOW.name())?;
    looks.extend(views.skipped.iter().copied().map(skipped));
    let instance = |i: usize| {
        let planes = planes(views, flow, i)?;
        Ok(Instance { given: planes.view.pose, rough: planes.field.camera_from_object, planes: Some(planes) })
    };
    (0..views.header.instances as usize).map(instance).collect()
}
