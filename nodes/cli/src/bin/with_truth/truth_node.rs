//! Labels from the truth, in the place of a teacher's.

use crate::truth::{Truth, TruthFiles};
use pseudoflow_msgs::{FlowFields, FlowFieldsHeader, PseudoLabels, PseudoLabelsHeader, ReferenceViews};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};

const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
const FLOW: Port<FlowFields<'static>> = Port::required("flow");
const LABELS: Port<PseudoLabels<'static>> = Port::required("labels");

/// Views in, their true flow as labels out. `flow` is zero: only the photometric loss, which has no use here, would look at it.
pub(crate) struct TruthNode(Truth);

impl Node for TruthNode {
    const KIND: &'static str = "truth";
    const ROLE: Role = Role::Transform;
    type Config = TruthFiles;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![FLOW.spec(), LABELS.spec()]
    }

    fn check(files: &TruthFiles) -> Result<(), NodeError> {
        Ok(files.check()?)
    }

    fn create(files: TruthFiles, _: &Context) -> Result<Self, NodeError> {
        Ok(Self(Truth::read(&files)?))
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let views = VIEWS.read(inputs)?;
        send_no_flow(&views, inputs, outputs)?;
        let truths = (0..views.views.len()).map(|number| self.0.flow(&views, number)).collect::<Result<Vec<_>, _>>()?;
        let header = PseudoLabelsHeader {
            weights_version: 0,
            instances: views.header.instances,
            views_per_instance: views.header.views_per_instance,
            size_px: views.header.size_px,
            scene_id: views.header.scene_id,
            image_id: views.header.image_id,
            tau_px: 0.0,
        };
        let (n, area) = (header.views_per_instance as usize, (header.size_px as usize).pow(2));
        LABELS.send(outputs, inputs.key(), PseudoLabels::byte_len(&header), &mut |bytes| {
            bytes.fill(0);
            let labels = PseudoLabels::write(bytes, header);
            for (number, truth) in truths.iter().enumerate() {
                let info = &mut labels.info[number / n];
                info.object_id = views.views[number].pose.object_id;
                let own = number * area..(number + 1) * area;
                info.visible_px += views.mask[own.clone()].iter().filter(|m| **m != 0).count() as u32;
                let Some(truth) = truth else { continue };
                info.valid_px += truth.seen.iter().filter(|v| **v != 0).count() as u32;
                info.usable = u32::from(info.valid_px > 0);
                labels.valid[own.clone()].copy_from_slice(&truth.seen);
                labels.label_px[2 * own.start..2 * own.end].copy_from_slice(&truth.flow_px);
            }
        })
    }
}

fn send_no_flow(views: &ReferenceViews<'_>, inputs: &dyn Inputs, outputs: &mut dyn Outputs) -> Result<(), NodeError> {
    let header = FlowFieldsHeader {
        fields: (views.views.len() + views.partners.len()) as u32,
        size_px: views.header.size_px,
        weights_version: 0,
        has_certainty: 0,
        reserved: 0,
    };
    FLOW.send(outputs, inputs.key(), FlowFields::byte_len(&header), &mut |bytes| {
        bytes.fill(0);
        FlowFields::write(bytes, header);
    })
}
