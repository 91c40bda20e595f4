//! The planes of a rendered view with its flow and the real crop, as solver and gate take them.

use crate::gate::{Evidence, Feature, Features, Gate, GateView, Scale};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion};
use pseudoflow_msgs::{FlowFields, ReferenceView, ReferenceViews};
use pseudoflow_runtime::NodeError;
use pseudoflow_solver::{FlowField, PnpResult};

/// The planes of one view.
pub(crate) struct ViewPlanes<'a> {
    pub(crate) view: &'a ReferenceView,
    pub(crate) field: FlowField<'a>,
    reference_rgb: &'a [u8],
    real_rgb: &'a [u8],
}

impl ViewPlanes<'_> {
    /// The sizes that evidence and solution are measured by; `threshold_px` is the solver's.
    pub(crate) fn scale(&self, threshold_px: f64) -> Scale {
        Scale {
            size_px: self.field.size_px,
            crop_side_px: self.view.crop[2],
            threshold_px,
            diameter_m: self.view.diameter_m,
            initial_depth_m: self.field.camera_from_object.translation.z,
        }
    }
}

impl ViewPlanes<'_> {
    /// What a solution and the pictures say, and how sure the network is of its flow.
    pub(crate) fn features(&self, found: &PnpResult, evidence: &Evidence, threshold_px: f64) -> Features {
        let certainty = self.field.mean_certainty().unwrap_or(f64::NAN);
        Features::of(found, evidence, &self.scale(threshold_px)).with(Feature::Certainty, certainty)
    }
}

/// Refuses flow of other views.
pub(crate) fn belong_together(views: &ReferenceViews<'_>, flow: &FlowFields<'_>) -> Result<(), NodeError> {
    let fields = views.views.len() + views.partners.len();
    if flow.header.fields as usize != fields || flow.header.size_px != views.header.size_px {
        return Err(
            "views and flow do not belong together: connect `flow` to the node that took the same `views`".into()
        );
    }
    Ok(())
}

/// View 0 of each instance: the one at the initial pose.
pub(crate) fn planes<'a>(
    views: &ReferenceViews<'a>,
    flow: &FlowFields<'a>,
    instance: usize,
) -> Result<ViewPlanes<'a>, NodeError> {
    let at = instance * views.header.views_per_instance as usize;
    let (size_px, view) = (views.header.size_px as usize, &views.views[at]);
    let area = size_px * size_px;
    let [fx, fy, cx, cy] = view.crop_intrinsics;
    let field = FlowField {
        size_px,
        depth_m: &views.depth_m[at * area..(at + 1) * area],
        mask: &views.mask[at * area..(at + 1) * area],
        flow_px: &flow.flow_px[at * 2 * area..(at + 1) * 2 * area],
        certainty: (flow.header.has_certainty == 1)
            .then(|| [0, 1].map(|plane| &flow.certainty[(2 * at + plane) * area..(2 * at + plane + 1) * area])),
        intrinsics: Intrinsics { fx, fy, cx, cy },
        camera_from_object: pose_from_quaternion(&view.pose.rotation_xyzw, &view.pose.translation_m)?,
    };
    let reference_rgb = &views.rgb[at * 3 * area..(at + 1) * 3 * area];
    let real_rgb = &views.real_rgb[instance * 3 * area..(instance + 1) * 3 * area];
    Ok(ViewPlanes { view, field, reference_rgb, real_rgb })
}

/// What the pictures say of a solution beside the pose that was rendered.
pub(crate) fn evidence(
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
