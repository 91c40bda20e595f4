use crate::truth::Truth;
use crate::{Failure, Source, bytes, context, network, step};
use pseudoflow_consistency::{ConsistencyConfig, ConsistencyNode, Label, label_panel};
use pseudoflow_flow::{FlowConfig, FlowNode};
use pseudoflow_inference::EngineConfig;
use pseudoflow_msgs::{FlowFields, Message, PseudoLabels, ReferenceViews};
use pseudoflow_network::ComputeDevice;
use pseudoflow_player::PlayerNode;
use pseudoflow_pnp::{PnpNode, PnpNodeConfig};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node};
use serde_json::json;
use std::path::{Path, PathBuf};

const TAUS_AT_256: [f32; 6] = [0.5, 1.0, 1.5, 2.0, 4.0, 8.0];

/// Prints, for each tau, the share of the object's pixels that keep a label, and the share of these within 2 px (of a
/// 256 px crop) of the truth.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,
    /// The teacher's weights.
    #[arg(long)]
    weights: PathBuf,
    /// The network that the weights belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Width and height of the crops, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Looks at every n-th frame.
    #[arg(long, default_value_t = 4)]
    every: usize,
    /// Fewest views that must see a point.
    #[arg(long, default_value_t = 3)]
    min_views: usize,
    /// What a label is: `teacher_flow`, `mean_vote` or `rigid`, as for `pseudoflow adapt`.
    #[arg(long, default_value = "teacher_flow")]
    label: String,
    /// Looks twice: the views are rendered around the pose that the teacher finds from the initial one.
    #[arg(long)]
    refine_first: bool,
    /// Draws the labels of the first frames into this folder.
    #[arg(long)]
    pictures: Option<PathBuf>,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Pixels kept, within 2 px, and on the object.
#[derive(Default, Clone, Copy)]
struct Tally {
    kept: [usize; TAUS_AT_256.len()],
    right: [usize; TAUS_AT_256.len()],
    visible: usize,
    all_right: usize,
}

struct Nodes {
    player: PlayerNode,
    /// Renderer of one view, and who makes a pose of its flow.
    first_look: Option<(RendererNode, PnpNode)>,
    renderer: RendererNode,
    flow: FlowNode,
    consistency: ConsistencyNode,
    context: Context,
}

impl Nodes {
    fn open(args: &Args) -> Result<Self, Failure> {
        let context = context(args.seed);
        let renderer = RendererConfig { views: 4, ..RendererConfig::new(args.source.objects.clone(), args.size) };
        let flow = FlowConfig {
            model: args.weights.clone(),
            network: network(&args.network)?,
            size_px: args.size,
            iterations: Some(12),
            max_batch: 8,
            device: ComputeDevice::default(),
            engine: EngineConfig::default(),
            lockstep: None,
        };
        let labels = ConsistencyConfig {
            tau_px_at_256: 64.0,
            min_views: args.min_views,
            label: serde_json::from_value::<Label>(json!(args.label))?,
            ..ConsistencyConfig::default()
        };
        let first_look = match args.refine_first {
            true => Some((
                RendererNode::create(RendererConfig::new(args.source.objects.clone(), args.size), &context)?,
                PnpNode::create(PnpNodeConfig::default(), &context)?,
            )),
            false => None,
        };
        Ok(Self {
            first_look,
            player: PlayerNode::create(args.source.player(), &context)?,
            renderer: RendererNode::create(renderer, &context)?,
            flow: FlowNode::create(flow, &context)?,
            consistency: ConsistencyNode::create(labels, &context)?,
            context,
        })
    }

    fn frame(&mut self, number: u64) -> Result<InMemory, Failure> {
        let mut messages = InMemory::default();
        self.player.produce(number, &mut messages, &self.context)?;
        messages.messages.retain(|(port, _)| port != "partners");
        if let Some((renderer, pnp)) = &mut self.first_look {
            step(renderer, &mut messages, &self.context)?;
            step(&mut self.flow, &mut messages, &self.context)?;
            step(pnp, &mut messages, &self.context)?;
            messages.messages.retain(|(port, _)| ["frame", "initial_poses", "poses"].contains(&port.as_str()));
            messages
                .messages
                .iter_mut()
                .filter(|(port, _)| port == "poses")
                .for_each(|(port, _)| *port = "around".into());
        }
        step(&mut self.renderer, &mut messages, &self.context)?;
        step(&mut self.flow, &mut messages, &self.context)?;
        step(&mut self.consistency, &mut messages, &self.context)?;
        Ok(messages)
    }
}

fn count(
    views: &ReferenceViews<'_>,
    labels: &PseudoLabels<'_>,
    truth: &Truth,
    tally: &mut Tally,
) -> Result<(), Failure> {
    let size_px = views.header.size_px as usize;
    let (area, scale) = (size_px * size_px, size_px as f32 / 256.0);
    for number in 0..views.views.len() {
        let Some(real) = truth.flow(views, number)? else { continue };
        for pixel in (0..area).filter(|pixel| views.mask[number * area + pixel] != 0) {
            tally.visible += 1;
            let at = number * area + pixel;
            let off = |axis: usize| labels.label_px[2 * at + axis] - real.flow_px[2 * pixel + axis];
            let right = off(0).hypot(off(1)) <= 2.0 * scale;
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
) -> Result<(), Failure> {
    for instance in 0..views.header.instances as usize {
        let Some(panel) = label_panel(views, flow, labels, instance) else { continue };
        let object_id = labels.info[instance].object_id;
        panel.save(folder.join(format!("{:06}_{object_id:02}.png", views.header.image_id)))?;
    }
    Ok(())
}

pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let truth = args.source.truth()?;
    let mut nodes = Nodes::open(args)?;
    let mut tally = Tally::default();
    for (i, number) in (0..nodes.player.count()).step_by(args.every.max(1)).enumerate() {
        let messages = nodes.frame(number as u64)?;
        let views = ReferenceViews::view(bytes(&messages, "views")?)?;
        let flow = FlowFields::view(bytes(&messages, "flow")?)?;
        let labels = PseudoLabels::view(bytes(&messages, "labels")?)?;
        count(&views, &labels, &truth, &mut tally)?;
        if let Some(folder) = args.pictures.as_ref().filter(|_| i < 3) {
            std::fs::create_dir_all(folder)?;
            draw(&views, &flow, &labels, folder)?;
        }
    }
    print(&tally);
    Ok(())
}

fn print(tally: &Tally) {
    println!("without a rule: {:.3} within 2 px", tally.all_right as f64 / tally.visible as f64);
    println!("{:>12} {:>10} {:>14}", "tau at 256", "kept", "within 2 px");
    for (i, tau) in TAUS_AT_256.iter().enumerate() {
        let kept = tally.kept[i] as f64 / tally.visible as f64;
        let right = tally.right[i] as f64 / tally.kept[i].max(1) as f64;
        println!("{tau:>12} {kept:>10.3} {right:>14.3}");
    }
}
