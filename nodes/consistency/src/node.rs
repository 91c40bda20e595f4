use crate::votes::{Label, Labels, Rule, View, label};
use crate::{ConsistencyError, label_panel, label_pictures};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion};
use pseudoflow_imaging::encode_jpeg;
use pseudoflow_msgs::{
    FlowFields, InstanceLabels, Message, Pictures, PseudoLabels, PseudoLabelsHeader, PseudoLabelsMut, ReferenceViews,
};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

const VIEWS: Port<ReferenceViews<'static>> = Port::required("views");
const FLOW: Port<FlowFields<'static>> = Port::required("flow");
const LABELS: Port<PseudoLabels<'static>> = Port::required("labels");
const PICTURES: Port<Pictures<'static>> = Port::optional("pictures");

const JPEG_QUALITY: u8 = 90;

/// Settings of the consistency node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ConsistencyConfig {
    /// Largest disagreement of a label, pixels of a 256 px crop; scales with the crop. 1 in the paper, 2 in its code.
    pub tau_px_at_256: f64,
    /// Fewest views that must see a point (all of them, when there are fewer).
    pub min_views: usize,
    /// What a label is.
    pub label: Label,
    /// Fewest valid pixels over all views of an instance to train with, at 128 px; scales with the crop's area.
    pub min_valid_px_at_128: u32,
    /// Accepts every flow of the teacher, whether or not the views agree: the paper's baseline.
    pub accept_all: bool,
    /// Writes pictures of the labels of every n-th frame (the first instance's view 0) into [`Self::pictures`].
    pub picture_every: Option<u64>,
    /// Folder of the pictures.
    pub pictures: PathBuf,
}

impl Default for ConsistencyConfig {
    fn default() -> Self {
        Self {
            tau_px_at_256: 1.0,
            min_views: 3,
            label: Label::TeacherFlow,
            min_valid_px_at_128: 200,
            accept_all: false,
            picture_every: None,
            pictures: PathBuf::from("out/labels"),
        }
    }
}

/// Views and the teacher's flow in, labels out.
pub struct ConsistencyNode {
    config: ConsistencyConfig,
}

fn together(views: &ReferenceViews<'_>, flow: &FlowFields<'_>) -> Result<(), ConsistencyError> {
    let (fields, wanted) = (flow.header.fields as usize, views.views.len() + views.partners.len());
    if fields != wanted || flow.header.size_px != views.header.size_px {
        return Err(ConsistencyError::Fields { fields, views: wanted });
    }
    Ok(())
}

/// The views of one instance.
fn views_of<'a>(
    views: &ReferenceViews<'a>,
    flow: &FlowFields<'a>,
    instance: usize,
) -> Result<Vec<View<'a>>, NodeError> {
    let (n, size_px) = (views.header.views_per_instance as usize, views.header.size_px as usize);
    let area = size_px * size_px;
    let view = |at: usize| {
        let pose = &views.views[at].pose;
        let [fx, fy, cx, cy] = views.views[at].crop_intrinsics;
        Ok(View {
            size_px,
            camera_from_object: pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m)?,
            intrinsics: Intrinsics { fx, fy, cx, cy },
            depth_m: &views.depth_m[at * area..(at + 1) * area],
            mask: &views.mask[at * area..(at + 1) * area],
            flow_px: &flow.flow_px[at * 2 * area..(at + 1) * 2 * area],
        })
    };
    (instance * n..(instance + 1) * n).map(view).collect()
}

impl ConsistencyNode {
    fn rule(&self, size_px: u32) -> Rule {
        Rule {
            tau_px: self.config.tau_px_at_256 * f64::from(size_px) / 256.0,
            min_views: self.config.min_views,
            label: self.config.label,
            accept_all: self.config.accept_all,
        }
    }

    fn summary(&self, views: &[View<'_>], labels: &[Labels], object_id: u32) -> InstanceLabels {
        let count = |f: &dyn Fn(&Labels) -> usize| labels.iter().map(f).sum::<usize>() as u32;
        let mut sigmas: Vec<f32> =
            labels.iter().flat_map(|l| &l.sigma_px).copied().filter(|sigma| sigma.is_finite()).collect();
        let middle = sigmas.len() / 2;
        let median_sigma_px = match sigmas.is_empty() {
            true => f32::NAN,
            false => *sigmas.select_nth_unstable_by(middle, f32::total_cmp).1,
        };
        let valid_px = count(&|l| l.valid.iter().filter(|v| **v != 0).count());
        let size_px = views.first().map_or(0, |view| view.size_px) as f64;
        let enough = f64::from(self.config.min_valid_px_at_128) * (size_px / 128.0).powi(2);
        InstanceLabels {
            object_id,
            usable: u32::from(valid_px > 0 && f64::from(valid_px) >= enough),
            visible_px: views.iter().map(|v| v.mask.iter().filter(|m| **m != 0).count()).sum::<usize>() as u32,
            voted_px: sigmas.len() as u32,
            valid_px,
            median_sigma_px,
        }
    }

    fn label(
        &self,
        views: &ReferenceViews<'_>,
        flow: &FlowFields<'_>,
        out: &mut PseudoLabelsMut<'_>,
    ) -> Result<(), NodeError> {
        let (n, area) = (views.header.views_per_instance as usize, (views.header.size_px as usize).pow(2));
        for instance in 0..views.header.instances as usize {
            let own = views_of(views, flow, instance)?;
            let first = &views.views[instance * n];
            let labels = label(&own, first.diameter_m, &self.rule(views.header.size_px))?;
            out.info[instance] = self.summary(&own, &labels, first.pose.object_id);
            for (view, labels) in labels.iter().enumerate() {
                let at = instance * n + view;
                out.sigma_px[at * area..(at + 1) * area].copy_from_slice(&labels.sigma_px);
                out.valid[at * area..(at + 1) * area].copy_from_slice(&labels.valid);
                out.label_px[at * 2 * area..(at + 1) * 2 * area].copy_from_slice(&labels.label_px);
            }
        }
        Ok(())
    }
}

impl Node for ConsistencyNode {
    const KIND: &'static str = "consistency";
    const ROLE: Role = Role::Transform;
    type Config = ConsistencyConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![VIEWS.spec(), FLOW.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![LABELS.spec(), PICTURES.spec()]
    }

    fn check(config: &ConsistencyConfig) -> Result<(), NodeError> {
        let bad = |name, got: String, must| Err(ConsistencyError::Setting { name, got, must }.into());
        if !(config.tau_px_at_256 > 0.0 && config.tau_px_at_256 <= 64.0) {
            return bad("tau_px_at_256", config.tau_px_at_256.to_string(), "0 < tau <= 64 pixels");
        }
        if config.picture_every == Some(0) {
            return bad("picture_every", "0".into(), "at least 1, or leave it out");
        }
        if !(1..=16).contains(&config.min_views) {
            return bad("min_views", config.min_views.to_string(), "1..=16");
        }
        Ok(())
    }

    fn create(config: ConsistencyConfig, _: &Context) -> Result<Self, NodeError> {
        if config.picture_every.is_some() {
            std::fs::create_dir_all(&config.pictures).map_err(|e| format!("{}: {e}", config.pictures.display()))?;
        }
        Ok(Self { config })
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let views = VIEWS.read(inputs)?;
        let flow = FLOW.read(inputs)?;
        together(&views, &flow)?;
        let header = PseudoLabelsHeader {
            weights_version: flow.header.weights_version,
            instances: views.header.instances,
            views_per_instance: views.header.views_per_instance,
            size_px: views.header.size_px,
            scene_id: views.header.scene_id,
            image_id: views.header.image_id,
            tau_px: self.rule(views.header.size_px).tau_px as f32,
        };
        let mut result = Ok(());
        let shows = outputs.is_connected(PICTURES.name());
        let drawn = self.config.picture_every.filter(|every| inputs.key().index.is_multiple_of(*every));
        let (mut panel, mut tiles) = (None, None);
        LABELS.send(outputs, inputs.key(), PseudoLabels::byte_len(&header), &mut |bytes| {
            result = self.label(&views, &flow, &mut PseudoLabels::write(bytes, header));
            let Ok(labels) = PseudoLabels::view(bytes) else { return };
            panel = drawn.and_then(|_| label_panel(&views, &flow, &labels, 0));
            tiles = shows.then(|| label_pictures(&views, &flow, &labels, 0)).flatten();
        })?;
        if let Some(panel) = panel {
            let path = self.config.pictures.join(format!("{:08}.jpg", inputs.key().index));
            std::fs::write(&path, encode_jpeg(&panel, JPEG_QUALITY)?)
                .map_err(|e| format!("{}: {e}", path.display()))?;
        }
        if shows {
            let encoded = tiles.into_iter().flatten().map(|(name, tile)| Ok((name, encode_jpeg(&tile, JPEG_QUALITY)?)));
            let pictures = encoded.collect::<Result<Vec<_>, NodeError>>()?;
            PICTURES.send(outputs, inputs.key(), Pictures::byte_len(&pictures), &mut |bytes| {
                Pictures::write(bytes, &pictures);
            })?;
        }
        result
    }
}
