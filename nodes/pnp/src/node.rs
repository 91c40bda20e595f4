use crate::PnpNodeConfig;
use crate::crop_solver::CropSolver;
use crate::gate::{Feature, Features, Gate, StageModel, Verdict, merit};
use crate::joint::{Joint, Stages};
use crate::views::{ViewPlanes, belong_together, evidence, planes};
use pseudoflow_geometry::{Pose, quaternion_xyzw};
use pseudoflow_msgs::{
    CameraFrame, FlowFields, GateDecision, GateDecisions, ObjectPose, ObjectPoses, PoseSource, PoseStatus,
    ReferenceViews,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, OrBadInput, Outputs, Port, PortSpec, Role};
use pseudoflow_solver::{PnpResult, PnpStatus};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

pub(crate) const VIEWS: Port<ReferenceViews<'static>> = Port::optional("views");
pub(crate) const FLOW: Port<FlowFields<'static>> = Port::optional("flow");
pub(crate) const FRAME: Port<CameraFrame<'static>> = Port::optional("frame");
pub(crate) const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::optional("initial_poses");
pub(crate) const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
pub(crate) const DECISIONS: Port<GateDecisions<'static>> = Port::optional("decisions");

/// Views and flow in, refined poses out.
pub struct PnpNode {
    config: PnpNodeConfig,
    solver: CropSolver,
    gate: Gate,
    model: StageModel,
    joint: Option<Joint>,
}

/// What became of one instance (or one hypothesis of it).
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// The pose as it goes out.
    pub pose: ObjectPose,
    /// By which the hypotheses of one instance are ranked; -infinity where nothing was solved.
    pub merit: f64,
    /// What the gate decided on; `None` where nothing was solved.
    pub refinement: Option<Refinement>,
}

/// A solution and the gate's decision on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The pose that it began from, `camera_from_object`.
    pub before: Pose,
    /// The refined pose, taken or not.
    pub after: Pose,
    /// Whether it was taken.
    pub accepted: bool,
    /// What the decision was made from.
    pub features: Features,
    /// What the model made of it.
    pub verdict: Verdict,
    /// The solver's covariance, not yet scaled by what was learnt.
    pub solver_covariance: [f64; 36],
}

impl Look {
    /// The gate's decision as a message; `None` where there was nothing to decide.
    fn decision(&self) -> Option<GateDecision> {
        let refinement = self.refinement.as_ref()?;
        let mut evidence = [f64::NAN; GateDecision::EVIDENCE.len()];
        for (value, feature) in evidence.iter_mut().zip(Feature::ALL) {
            *value = refinement.features.get(feature);
        }
        evidence[Feature::ALL.len()] = refinement.verdict.better;
        Some(GateDecision {
            object_id: self.pose.object_id,
            instance: self.pose.instance,
            accepted: u32::from(refinement.accepted),
            reserved: 0,
            before_rotation_xyzw: quaternion_xyzw(&refinement.before),
            before_translation_m: refinement.before.translation.vector.into(),
            after_rotation_xyzw: quaternion_xyzw(&refinement.after),
            after_translation_m: refinement.after.translation.vector.into(),
            solver_covariance: refinement.solver_covariance,
            evidence,
        })
    }
}

impl PnpNode {
    /// The refined pose of a view.
    fn refine(&mut self, planes: &ViewPlanes<'_>, seed: u64) -> Result<Look, NodeError> {
        let found = self.solver.solve(&planes.field, seed)?;
        match found.status {
            PnpStatus::Ok => self.looked_at(planes, &found),
            failed => {
                let pose = kept_pose(&planes.view.pose, message_status(failed), 0.0);
                Ok(Look { pose, merit: f64::NEG_INFINITY, refinement: None })
            }
        }
    }

    /// Whether the object is seen at all, whether the solution replaces the initial pose, and how sure that is.
    fn looked_at(&mut self, planes: &ViewPlanes<'_>, found: &PnpResult) -> Result<Look, NodeError> {
        let config = self.config.gate.clone().unwrap_or_default();
        let evidence = evidence(planes, found, config.blocks_across, &mut self.gate)?;
        let threshold_px = self.solver.of(planes.field.size_px)?.config().threshold_px;
        let features = planes.features(found, &evidence, threshold_px);
        let verdict = self.model.verdict(&features);
        let decision = config.decide(found, &evidence, &verdict, planes.field.size_px);
        let refused = self.config.gate.is_some() && !decision.accept;
        let [photometric, silhouette] = match refused {
            true => [evidence.photometric_initial, evidence.silhouette_initial],
            false => [evidence.photometric_refined, evidence.silhouette_refined],
        };
        let initial = &planes.view.pose;
        let seen = found.inlier_ratio + photometric + silhouette;
        let merit = merit(seen, planes.field.mean_certainty());
        log::debug!(
            "object {}: gate {}; seen {seen:.3}; {verdict:?}; {evidence:?}",
            initial.object_id,
            decision.reason
        );
        // A prediction from the frames before that the picture likes better than its refinement is a pose by itself.
        let tracked = initial.source == PoseSource::Tracked as u32;
        let status = match (seen >= self.config.min_seen, refused) {
            (false, _) => PoseStatus::NotSeen,
            (true, true) if !tracked => PoseStatus::Rejected,
            (true, _) => PoseStatus::Ok,
        };
        let pose = match refused {
            true => kept_pose(initial, status, verdict.initial_right),
            false => {
                let covariance = self.model.covariance.apply(&found.covariance, verdict.refined_right);
                ObjectPose { covariance, ..refined_pose(initial, found, status, verdict.refined_right) }
            }
        };
        let refinement = Refinement {
            before: planes.field.camera_from_object,
            after: found.camera_from_object,
            accepted: !refused,
            features,
            verdict,
            solver_covariance: found.covariance,
        };
        Ok(Look { pose, merit, refinement: Some(refinement) })
    }

    /// What became of each instance of a frame, of several hypotheses the best; ordered by object and instance. This is all
    /// that [`Node::process`] does but for sending.
    ///
    /// # Errors
    /// When views and flow are missing or do not belong together.
    pub fn looks(&mut self, inputs: &dyn Inputs, context: &Context) -> Result<Vec<Look>, NodeError> {
        if let Some(joint) = &mut self.joint {
            let mut rng = draws(&self.config, inputs, context)?;
            return Ok(best_of_each(joint.looks(inputs, rng.random())?));
        }
        let views = VIEWS.read(inputs)?;
        let flow = FLOW.read(inputs)?;
        belong_together(&views, &flow).or_bad_input(FLOW.name())?;
        let mut rng = draws(&self.config, inputs, context)?;
        let skipped = |pose: &ObjectPose| Look { pose: *pose, merit: f64::NEG_INFINITY, refinement: None };
        let mut looks: Vec<Look> = views.skipped.iter().map(skipped).collect();
        for instance in 0..views.header.instances as usize {
            looks.push(self.refine(&planes(&views, &flow, instance)?, rng.random())?);
        }
        Ok(best_of_each(looks))
    }
}

fn message_status(status: PnpStatus) -> PoseStatus {
    match status {
        PnpStatus::Ok => PoseStatus::Ok,
        PnpStatus::TooFewPoints { .. } => PoseStatus::TooFewPoints,
        PnpStatus::TooFewInliers { .. } => PoseStatus::TooFewInliers,
        PnpStatus::NotFinite => PoseStatus::NotFinite,
        PnpStatus::Degenerate { .. } => PoseStatus::Degenerate,
        PnpStatus::BehindCamera { .. } => PoseStatus::BehindCamera,
    }
}

/// The initial pose with what became of its refinement.
pub(crate) fn kept_pose(initial: &ObjectPose, status: PoseStatus, score: f64) -> ObjectPose {
    ObjectPose { status: status as u32, score, ..*initial }
}

/// The solution in place of the initial pose.
fn refined_pose(initial: &ObjectPose, found: &PnpResult, status: PoseStatus, score: f64) -> ObjectPose {
    ObjectPose {
        status: status as u32,
        source: PoseSource::Refined as u32,
        score,
        rotation_xyzw: quaternion_xyzw(&found.camera_from_object),
        translation_m: found.camera_from_object.translation.vector.into(),
        covariance: found.covariance,
        ..*initial
    }
}

/// Of several poses of one instance (an initializer may send them) the one with the most merit, the first of equals; ordered by object and instance.
fn best_of_each(mut looks: Vec<Look>) -> Vec<Look> {
    let merit = |look: &Look| if look.merit.is_nan() { f64::NEG_INFINITY } else { look.merit };
    looks.sort_by(|a, b| a.pose.identity().cmp(&b.pose.identity()).then(merit(b).total_cmp(&merit(a))));
    looks.dedup_by_key(|look| look.pose.identity());
    looks
}

/// BOP scene and image of a frame.
fn image(inputs: &dyn Inputs) -> Result<(u32, u32), NodeError> {
    if VIEWS.has_come(inputs) {
        let header = VIEWS.read(inputs)?.header;
        return Ok((header.scene_id, header.image_id));
    }
    let header = INITIAL_POSES.read(inputs)?.header;
    Ok((header.scene_id, header.image_id))
}

/// The random source of RANSAC for a frame.
fn draws(config: &PnpNodeConfig, inputs: &dyn Inputs, context: &Context) -> Result<ChaCha8Rng, NodeError> {
    let frame = config.first_frame + inputs.key().index;
    Ok(config.draws.rng(context, frame, image(inputs)?, "ransac"))
}

impl Node for PnpNode {
    const KIND: &'static str = "pnp";
    const ROLE: Role = Role::Transform;
    type Config = PnpNodeConfig;

    fn inputs() -> Vec<PortSpec> {
        // Which of them are needed depends on `stages`: see `needs`.
        vec![VIEWS.spec(), FLOW.spec(), FRAME.spec(), INITIAL_POSES.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![POSES.spec(), DECISIONS.spec()]
    }

    fn check(config: &PnpNodeConfig) -> Result<(), NodeError> {
        config.solver.validate()?;
        if !(-1.0..=3.0).contains(&config.min_seen) {
            return Err(format!("`min_seen: {}`: give -1 to 3", config.min_seen).into());
        }
        config.gate.clone().unwrap_or_default().stage_model(config.stages.learnt())?;
        Joint::check(config)
    }

    fn needs(config: &PnpNodeConfig) -> Vec<&'static str> {
        match config.stages {
            Stages::Flow => vec![VIEWS.name(), FLOW.name()],
            // Rough poses come by `initial_poses` or in `views`.
            Stages::Region => vec![FRAME.name()],
            Stages::Joint => vec![VIEWS.name(), FLOW.name(), FRAME.name()],
        }
    }

    fn create(config: PnpNodeConfig, _: &Context) -> Result<Self, NodeError> {
        let model = config.gate.clone().unwrap_or_default().stage_model(config.stages.learnt())?;
        let joint = Joint::open(&config, &model)?;
        let solver = CropSolver::new(config.solver.clone());
        Ok(Self { config, solver, gate: Gate::new(), model, joint })
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        match VIEWS.given(inputs).ok()? {
            Some(views) => Some(views.objects()),
            None => Some(INITIAL_POSES.read(inputs).ok()?.poses.len()),
        }
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let looks = self.looks(inputs, context)?;
        if outputs.is_connected(DECISIONS.name()) {
            let decisions: Vec<GateDecision> = looks.iter().filter_map(Look::decision).collect();
            DECISIONS.send(outputs, inputs.key(), GateDecisions::byte_len(decisions.len()), &mut |bytes| {
                GateDecisions::write(bytes, &decisions);
            })?;
        }
        let poses: Vec<ObjectPose> = looks.into_iter().map(|look| look.pose).collect();
        let (scene_id, image_id) = image(inputs)?;
        POSES.send(outputs, inputs.key(), ObjectPoses::byte_len(poses.len()), &mut |bytes| {
            ObjectPoses::write(bytes, scene_id, image_id, &poses);
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_names_the_gates_features() {
        let names = Feature::ALL.map(|feature| serde_json::to_value(feature).unwrap());
        let features = &GateDecision::EVIDENCE[..Feature::ALL.len()];
        assert_eq!(features, names.map(|name| name.as_str().unwrap().to_owned()));
        assert_eq!(GateDecision::EVIDENCE[Feature::ALL.len()..], ["better"]);
    }

    #[test]
    fn of_several_poses_of_an_instance_the_one_that_is_seen_best_stays() {
        let pose = |object_id, instance, score, seen| {
            let zeroed: ObjectPose = bytemuck::Zeroable::zeroed();
            Look { pose: ObjectPose { object_id, instance, score, ..zeroed }, merit: seen, refinement: None }
        };
        let refined = vec![
            pose(2, 0, 0.1, f64::NEG_INFINITY),
            pose(1, 1, 0.2, 0.7),
            pose(1, 0, 0.3, f64::NAN),
            pose(1, 1, 0.4, 1.9),
            pose(1, 0, 0.5, -0.2),
            pose(1, 1, 0.6, 1.9),
        ];
        let kept: Vec<_> =
            best_of_each(refined).iter().map(|l| (l.pose.object_id, l.pose.instance, l.pose.score)).collect();
        assert_eq!(kept, [(1, 0, 0.5), (1, 1, 0.4), (2, 0, 0.1)]);
    }
}
