//! How good the pseudo-labels are: compares them with the true flow, which training never sees.
//!
//! ```text
//! audit_labels SCENE MODELS SCENE_GT WEIGHTS SIZE_PX [EVERY] [PICTURES]
//! audit_labels data/tabletop/train/000001 data/tabletop/models data/tabletop/train_truth/000001/scene_gt.json W 256 4 out
//! ```
//!
//! For each tau: the share of the object's pixels that keep a label, and the share of these within 2 px (of a 256 px crop)
//! of the truth. With PICTURES, the labels of some instances are drawn there.

#![allow(clippy::print_stdout, reason = "a measurement for people")]

use nalgebra::{Matrix3, Point2, Rotation3, UnitQuaternion, Vector3};
use pseudoflow_consistency::{ConsistencyConfig, ConsistencyNode, label_panel};
use pseudoflow_flow::{EngineConfig, FlowConfig, FlowNode, Network};
use pseudoflow_geometry::{Intrinsics, Pose, pose_from_quaternion};
use pseudoflow_msgs::{FlowFields, Message, PseudoLabels, ReferenceViews};
use pseudoflow_player::{PlayerConfig, PlayerNode};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node, Outputs};
use serde_json::Value;
use std::path::{Path, PathBuf};

type Error = Box<dyn std::error::Error + Send + Sync>;

const TAUS_AT_256: [f32; 6] = [0.5, 1.0, 1.5, 2.0, 4.0, 8.0];

/// Pixels kept, within 2 px, and on the object.
#[derive(Default, Clone, Copy)]
struct Tally {
    kept: [usize; TAUS_AT_256.len()],
    right: [usize; TAUS_AT_256.len()],
    visible: usize,
    all_right: usize,
}

fn truth(gt: &Value, image_id: u32, object_id: u32) -> Option<Pose> {
    let list = gt.get(image_id.to_string())?.as_array()?;
    let entry = list.iter().find(|e| e["obj_id"].as_u64() == Some(u64::from(object_id)))?;
    let numbers = |key: &str| -> Option<Vec<f64>> { entry[key].as_array()?.iter().map(Value::as_f64).collect() };
    let (r, t) = (numbers("cam_R_m2c")?, numbers("cam_t_m2c")?);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&r));
    Some(Pose::from_parts(
        (Vector3::new(t[0], t[1], t[2]) / 1000.0).into(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

struct Nodes {
    player: PlayerNode,
    renderer: RendererNode,
    flow: FlowNode,
    consistency: ConsistencyNode,
    context: Context,
}

impl Nodes {
    fn open(scene: &Path, models: &Path, weights: &Path, size_px: u32) -> Result<Self, Error> {
        let context = Context { name: "audit".into(), seed: 1, out_dir: "/tmp".into(), restarts: 0, replay: true };
        let renderer = RendererConfig { views: 4, ..RendererConfig::new(models.to_owned(), size_px) };
        let flow = FlowConfig {
            model: weights.to_owned(),
            network: Network::Nano,
            size_px,
            iterations: 12,
            max_batch: 8,
            engine: EngineConfig::default(),
            lockstep: None,
        };
        let labels = ConsistencyConfig { tau_px_at_256: 64.0, ..ConsistencyConfig::default() };
        Ok(Self {
            player: PlayerNode::create(PlayerConfig::new(scene.to_owned()), &context)?,
            renderer: RendererNode::create(renderer, &context)?,
            flow: FlowNode::create(flow, &context)?,
            consistency: ConsistencyNode::create(labels, &context)?,
            context,
        })
    }

    fn frame(&mut self, number: u64) -> Result<InMemory, Error> {
        let mut messages = InMemory::default();
        self.player.produce(number, &mut messages, &self.context)?;
        messages.messages.retain(|(port, _)| port != "partners");
        step(&mut self.renderer, &mut messages, &self.context)?;
        step(&mut self.flow, &mut messages, &self.context)?;
        step(&mut self.consistency, &mut messages, &self.context)?;
        Ok(messages)
    }
}

fn step<N: Node>(node: &mut N, messages: &mut InMemory, context: &Context) -> Result<(), Error> {
    let mut out = InMemory { key: messages.key, ..InMemory::default() };
    node.process(messages, &mut out, context)?;
    debug_assert!(out.is_connected(""));
    messages.messages.append(&mut out.messages);
    Ok(())
}

fn bytes<'a>(messages: &'a InMemory, port: &str) -> Result<&'a [u8], Error> {
    let found = messages.messages.iter().find(|(name, _)| name == port);
    Ok(found.map(|(_, bytes)| &**bytes).ok_or("a message is missing")?)
}

fn count(views: &ReferenceViews<'_>, labels: &PseudoLabels<'_>, gt: &Value, tally: &mut Tally) -> Result<(), Error> {
    let size_px = views.header.size_px as usize;
    let (area, scale) = (size_px * size_px, size_px as f32 / 256.0);
    for (v, view) in views.views.iter().enumerate() {
        let Some(real) = truth(gt, views.header.image_id, view.pose.object_id) else { continue };
        let pose = pose_from_quaternion(&view.pose.rotation_xyzw, &view.pose.translation_m)?;
        let [fx, fy, cx, cy] = view.crop_intrinsics;
        let k = Intrinsics { fx, fy, cx, cy };
        for pixel in (0..area).filter(|pixel| views.mask[v * area + pixel] != 0) {
            tally.visible += 1;
            let at = v * area + pixel;
            let p = Point2::new((pixel % size_px) as f64, (pixel / size_px) as f64);
            let point = pose.inverse() * k.unproject(&p, f64::from(views.depth_m[at]));
            let Some(seen) = k.project(&(real * point)) else { continue };
            let label = [labels.label_px[2 * at], labels.label_px[2 * at + 1]];
            let error = (p.x + f64::from(label[0]) - seen.x).hypot(p.y + f64::from(label[1]) - seen.y) as f32 / scale;
            let right = error <= 2.0;
            tally.all_right += usize::from(right);
            for (i, tau) in TAUS_AT_256.iter().enumerate() {
                let kept = labels.valid[at] != 0 && labels.sigma_px[at] < tau * scale;
                tally.kept[i] += usize::from(kept);
                tally.right[i] += usize::from(kept && right);
            }
        }
    }
    Ok(())
}

fn draw(
    views: &ReferenceViews<'_>,
    flow: &FlowFields<'_>,
    labels: &PseudoLabels<'_>,
    folder: &Path,
) -> Result<(), Error> {
    for instance in 0..views.header.instances as usize {
        let Some(panel) = label_panel(views, flow, labels, instance) else { continue };
        let object_id = labels.info[instance].object_id;
        panel.save(folder.join(format!("{:06}_{object_id:02}.png", views.header.image_id)))?;
    }
    Ok(())
}

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, models, gt, weights, size_px, rest @ ..] = arguments.as_slice() else {
        return Err("usage: audit_labels SCENE MODELS SCENE_GT WEIGHTS SIZE_PX [EVERY] [PICTURES]".into());
    };
    let size_px: u32 = size_px.parse()?;
    let every: usize = rest.first().map_or(Ok(1), |text| text.parse())?;
    let pictures = rest.get(1).map(PathBuf::from);
    let gt: Value = serde_json::from_slice(&std::fs::read(gt)?)?;
    let mut nodes = Nodes::open(Path::new(scene), Path::new(models), Path::new(weights), size_px)?;
    let mut tally = Tally::default();
    for (i, number) in (0..nodes.player.count()).step_by(every).enumerate() {
        let messages = nodes.frame(number as u64)?;
        let views = ReferenceViews::view(bytes(&messages, "views")?)?;
        let flow = FlowFields::view(bytes(&messages, "flow")?)?;
        let labels = PseudoLabels::view(bytes(&messages, "labels")?)?;
        count(&views, &labels, &gt, &mut tally)?;
        if let Some(folder) = pictures.as_ref().filter(|_| i < 3) {
            std::fs::create_dir_all(folder)?;
            draw(&views, &flow, &labels, folder)?;
        }
    }
    println!("without a rule: {:.3} within 2 px", tally.all_right as f64 / tally.visible as f64);
    println!("{:>12} {:>10} {:>14}", "tau at 256", "kept", "within 2 px");
    for (i, tau) in TAUS_AT_256.iter().enumerate() {
        let kept = tally.kept[i] as f64 / tally.visible as f64;
        let right = tally.right[i] as f64 / tally.kept[i].max(1) as f64;
        println!("{tau:>12} {kept:>10.3} {right:>14.3}");
    }
    Ok(())
}
