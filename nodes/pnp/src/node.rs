use crate::gate::{Evidence, Gate, GateConfig, GateView};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion, quaternion_xyzw};
use pseudoflow_msgs::{FlowFields, ObjectPose, ObjectPoses, PoseSource, PoseStatus, ReferenceView, ReferenceViews};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use pseudoflow_solver::{FlowField, PixelBuffer, PnpConfig, PnpResult, PnpStatus, Solver};
use rand::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the pnp node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PnpNodeConfig {
    /// The solver. Pixel thresholds are those of a crop of 256 px and scale with the crop.
    pub solver: PnpConfig,
    /// When a refined pose replaces the initial one; `null` accepts every solution.
    pub gate: Option<GateConfig>,
    /// Smallest agreement of flow and picture with a pose for the object to count as seen there, -1 to 3: inlier ratio,
    /// correlation of the rendering with the crop and contrast across its contour. Below it the status is `NotSeen`.
    pub min_seen: f64,
    /// Frames of a training that went before this run: they decide what is drawn at random.
    pub first_frame: u64,
}

impl Default for PnpNodeConfig {
    fn default() -> Self {
        Self { solver: PnpConfig::default(), gate: Some(GateConfig::default()), min_seen: MIN_SEEN, first_frame: 0 }
    }
}

/// Between right poses and poses at places where other things are: on data/tabletop's test images (273 and 268 of them) one in
/// twenty of the former lies below, one in twenty of the latter above.
const MIN_SEEN: f64 = 1.1;

/// Views and flow in, refined poses out.
pub struct PnpNode {
    config: PnpNodeConfig,
    solver: Option<(usize, Solver)>,
    buffer: PixelBuffer,
    gate: Gate,
}

/// The planes of one view.
struct ViewPlanes<'a> {
    view: &'a ReferenceView,
    field: FlowField<'a>,
    reference_rgb: &'a [u8],
    real_rgb: &'a [u8],
}

impl PnpNode {
    /// The solver for crops of a size; made anew only when the size changes.
    fn solver(&mut self, size_px: usize) -> Result<&mut Solver, NodeError> {
        if self.solver.as_ref().is_none_or(|(size, _)| *size != size_px) {
            self.solver = Some((size_px, Solver::new(self.config.solver.clone().scaled_to(size_px))?));
        }
        Ok(&mut self.solver.as_mut().ok_or("no solver")?.1)
    }

    /// The refined pose, and how well flow and picture agree with it.
    fn refine(&mut self, planes: &ViewPlanes<'_>, seed: u64) -> Result<(ObjectPose, f64), NodeError> {
        let found = self.solve(planes, seed)?;
        let (status, seen) = match found.status {
            PnpStatus::Ok => self.looked_at(planes, &found)?,
            failed => ((message_status(failed), false), f64::NEG_INFINITY),
        };
        Ok((refined_pose(&planes.view.pose, &found, status), seen))
    }

    /// Whether the object is seen at all, whether the solution replaces the initial pose, and how well flow and picture agree
    /// with what is kept.
    fn looked_at(
        &mut self,
        planes: &ViewPlanes<'_>,
        found: &PnpResult,
    ) -> Result<((PoseStatus, bool), f64), NodeError> {
        let config = self.config.gate.clone().unwrap_or_default();
        let evidence = evidence(planes, found, config.blocks_across, &mut self.gate)?;
        let decision = config.decide(found, &evidence, planes.field.size_px);
        let refused = self.config.gate.is_some() && !decision.accept;
        let [photometric, silhouette] = match refused {
            true => [evidence.photometric_initial, evidence.silhouette_initial],
            false => [evidence.photometric_refined, evidence.silhouette_refined],
        };
        let (object, seen) = (planes.view.pose.object_id, found.inlier_ratio + photometric + silhouette);
        log::debug!("object {object}: gate {}; seen {seen:.3}; {evidence:?}", decision.reason);
        // A prediction from the frames before that the picture likes better than its refinement is a pose by itself.
        let tracked = planes.view.pose.source == PoseSource::Tracked as u32;
        let status = match (seen >= self.config.min_seen, refused) {
            (false, _) => PoseStatus::NotSeen,
            (true, true) if !tracked => PoseStatus::Rejected,
            (true, _) => PoseStatus::Ok,
        };
        Ok(((status, !refused), seen))
    }

    fn solve(&mut self, planes: &ViewPlanes<'_>, seed: u64) -> Result<PnpResult, NodeError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        let correspondences = buffer.fill(&planes.field, usize::MAX)?;
        let camera = planes.field.intrinsics;
        let initial = planes.field.camera_from_object;
        let found = self.solver(planes.field.size_px)?.solve(&correspondences, &camera, &initial, seed);
        self.buffer = buffer;
        Ok(found)
    }

    /// Refines the instances of a frame and says how well the pictures agree with each pose, without any truth. `seed`
    /// is that of RANSAC.
    ///
    /// # Errors
    /// When views and flow do not belong together.
    pub fn judge(
        &mut self,
        views: &ReferenceViews<'_>,
        flow: &FlowFields<'_>,
        seed: u64,
    ) -> Result<Vec<Judgement>, NodeError> {
        let blocks_across = self.config.gate.clone().unwrap_or_default().blocks_across;
        let judge = |instance: usize| {
            let planes = planes(views, flow, instance)?;
            let found = self.solve(&planes, seed)?;
            let status = message_status(found.status);
            let evidence = match found.status {
                PnpStatus::Ok => Some(evidence(&planes, &found, blocks_across, &mut self.gate)?),
                _ => None,
            };
            Ok(Judgement {
                pose: refined_pose(&planes.view.pose, &found, (status, status == PoseStatus::Ok)),
                evidence,
            })
        };
        (0..views.header.instances as usize).map(judge).collect()
    }
}

/// A refined pose with what the pictures say about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The pose, its score the inlier ratio.
    pub pose: ObjectPose,
    /// `None` when PnP failed.
    pub evidence: Option<Evidence>,
}

impl Judgement {
    /// Agreement of flow and pictures, from -1 to 3: the inlier ratio, the correlation of the rendering with the crop and the
    /// contrast across the contour, each at the refined pose. 0 when PnP failed. For comparing networks on the same crops.
    #[must_use]
    pub fn agreement(&self) -> f64 {
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        self.evidence.as_ref().map_or(0.0, |evidence| {
            self.pose.score + finite(evidence.photometric_refined) + finite(evidence.silhouette_refined)
        })
    }
}

fn evidence(
    planes: &ViewPlanes<'_>,
    found: &PnpResult,
    blocks_across: usize,
    gate: &mut Gate,
) -> Result<Evidence, NodeError> {
    let view = GateView {
        size_px: planes.field.size_px,
        reference_rgb: planes.reference_rgb,
        reference_depth_m: planes.field.depth_m,
        crop_rgb: planes.real_rgb,
        intrinsics: planes.field.intrinsics,
        initial: planes.field.camera_from_object,
    };
    Ok(gate.evidence(&view, &found.camera_from_object, blocks_across)?)
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

/// The pose of the message: the solution where it replaces the initial pose, else what it began from.
fn refined_pose(initial: &ObjectPose, found: &PnpResult, (status, replaces): (PoseStatus, bool)) -> ObjectPose {
    let score = found.inlier_ratio;
    if !replaces {
        return ObjectPose { status: status as u32, score, ..*initial };
    }
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

/// Of several poses of one instance (an initializer may send them) the one that flow and picture agree with best, the first of
/// equals; ordered by object and instance.
fn best_of_each(mut refined: Vec<(ObjectPose, f64)>) -> Vec<ObjectPose> {
    let agreement = |seen: f64| if seen.is_nan() { f64::NEG_INFINITY } else { seen };
    refined.sort_by(|a, b| a.0.identity().cmp(&b.0.identity()).then(agreement(b.1).total_cmp(&agreement(a.1))));
    refined.dedup_by_key(|(pose, _)| pose.identity());
    refined.into_iter().map(|(pose, _)| pose).collect()
}

/// View 0 of each instance: the one at the initial pose.
fn planes<'a>(views: &ReferenceViews<'a>, flow: &FlowFields<'a>, instance: usize) -> Result<ViewPlanes<'a>, NodeError> {
    let at = instance * views.header.views_per_instance as usize;
    let (size_px, view) = (views.header.size_px as usize, &views.views[at]);
    let area = size_px * size_px;
    let [fx, fy, cx, cy] = view.crop_intrinsics;
    let field = FlowField {
        size_px,
        depth_m: &views.depth_m[at * area..(at + 1) * area],
        mask: &views.mask[at * area..(at + 1) * area],
        flow_px: &flow.flow_px[at * 2 * area..(at + 1) * 2 * area],
        intrinsics: Intrinsics { fx, fy, cx, cy },
        camera_from_object: pose_from_quaternion(&view.pose.rotation_xyzw, &view.pose.translation_m)?,
    };
    let reference_rgb = &views.rgb[at * 3 * area..(at + 1) * 3 * area];
    let real_rgb = &views.real_rgb[instance * 3 * area..(instance + 1) * 3 * area];
    Ok(ViewPlanes { view, field, reference_rgb, real_rgb })
}

impl Node for PnpNode {
    const KIND: &'static str = "pnp";
    const ROLE: Role = Role::Transform;
    type Config = PnpNodeConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<ReferenceViews<'static>>("views"), PortSpec::required::<FlowFields<'static>>("flow")]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<ObjectPoses<'static>>("poses")]
    }

    fn check(config: &PnpNodeConfig) -> Result<(), NodeError> {
        config.solver.validate()?;
        if !(-1.0..=3.0).contains(&config.min_seen) {
            return Err(format!("`min_seen: {}`: give -1 to 3", config.min_seen).into());
        }
        if let Some(gate) = &config.gate {
            gate.validate()?;
        }
        Ok(())
    }

    fn create(config: PnpNodeConfig, _: &Context) -> Result<Self, NodeError> {
        Ok(Self { config, solver: None, buffer: PixelBuffer::default(), gate: Gate::new() })
    }

    fn objects(inputs: &dyn Inputs) -> Option<usize> {
        Some(read::<ReferenceViews<'static>>(inputs, "views").ok()?.objects())
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let views = read::<ReferenceViews<'static>>(inputs, "views")?;
        let flow = read::<FlowFields<'static>>(inputs, "flow")?;
        if flow.header.fields as usize != views.views.len() + views.partners.len()
            || flow.header.size_px != views.header.size_px
        {
            return Err(
                "views and flow do not belong together: connect `flow` to the node that took the same `views`".into()
            );
        }
        let mut rng = context.rng(self.config.first_frame + inputs.key().index, "ransac");
        let mut refined: Vec<(ObjectPose, f64)> = views.skipped.iter().map(|pose| (*pose, f64::NEG_INFINITY)).collect();
        for instance in 0..views.header.instances as usize {
            refined.push(self.refine(&planes(&views, &flow, instance)?, rng.random())?);
        }
        let poses = best_of_each(refined);
        let (scene_id, image_id) = (views.header.scene_id, views.header.image_id);
        outputs.send("poses", inputs.key(), ObjectPoses::byte_len(poses.len()), &mut |bytes| {
            ObjectPoses::write(bytes, scene_id, image_id, &poses);
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_several_poses_of_an_instance_the_one_that_is_seen_best_stays() {
        let pose = |object_id, instance, score, seen| {
            let zeroed: ObjectPose = bytemuck::Zeroable::zeroed();
            (ObjectPose { object_id, instance, score, ..zeroed }, seen)
        };
        let refined = vec![
            pose(2, 0, 0.1, f64::NEG_INFINITY),
            pose(1, 1, 0.2, 0.7),
            pose(1, 0, 0.3, f64::NAN),
            pose(1, 1, 0.4, 1.9),
            pose(1, 0, 0.5, -0.2),
            pose(1, 1, 0.6, 1.9),
        ];
        let kept: Vec<_> = best_of_each(refined).iter().map(|p| (p.object_id, p.instance, p.score)).collect();
        assert_eq!(kept, [(1, 0, 0.5), (1, 1, 0.4), (2, 0, 0.1)]);
    }
}
