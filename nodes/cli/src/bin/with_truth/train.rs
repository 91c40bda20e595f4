use crate::truth::Truth;
use crate::{Failure, Source, bytes, context, step};
use indicatif::{ProgressBar, ProgressStyle};
use pseudoflow_msgs::{
    AlignedBytes, FlowFields, FlowFieldsHeader, Message, PseudoLabels, PseudoLabelsHeader, ReferenceViews,
};
use pseudoflow_player::{PlayerConfig, PlayerNode, Sampling};
use pseudoflow_renderer::{RendererConfig, RendererNode};
use pseudoflow_runtime::{Context, InMemory, Node, Produced};
use pseudoflow_trainer::adapt::{AdaptState, Sample, SampleForm, TrainerConfig, label_px};
use std::fmt::Write as _;
use std::path::PathBuf;

#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,
    /// Weights to begin with.
    #[arg(long)]
    weights: PathBuf,
    /// The weights to write.
    #[arg(long)]
    out: PathBuf,
    /// The network that the weights belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Training steps.
    #[arg(long, default_value_t = 100)]
    steps: u64,
    /// Instances in a step.
    #[arg(long, default_value_t = 4)]
    batch: u64,
    /// Updates of the student with the labels of a step, each with other colours.
    #[arg(long, default_value_t = 4)]
    repeats: u64,
    /// Rendered views of each instance.
    #[arg(long, default_value_t = 4)]
    views: u32,
    /// Width and height of the crops that the network sees, pixels.
    #[arg(long, default_value_t = 128)]
    size: u32,
    /// Width and height of the crops in which the truth is drawn, pixels: `--size` times 1, 2 or 4. [default: as in
    /// `pseudoflow adapt`]
    #[arg(long)]
    label_size: Option<u32>,
    /// Peak of the one-cycle learning rate.
    #[arg(long, default_value_t = 2e-4)]
    max_lr: f64,
    /// Share of the old teacher in the new one after a step. [default: as in `pseudoflow adapt`]
    #[arg(long)]
    ema: Option<f64>,
    /// Every n-th frame is left out, as `pseudoflow adapt` does.
    #[arg(long, default_value_t = 5)]
    held_out_every: u64,
    /// Uses this many frames only.
    #[arg(long)]
    budget_frames: Option<u64>,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Args {
    /// As in `pseudoflow adapt`: the bound differs from it by its labels alone.
    fn label_px(&self) -> u32 {
        label_px(self.label_size, self.size)
    }
}

/// The nodes that make samples, with truth in the place of the teacher.
struct Samples {
    player: PlayerNode,
    renderer: RendererNode,
    truth: Truth,
    context: Context,
    seed: u64,
    form: SampleForm,
}

impl Samples {
    fn open(args: &Args, form: SampleForm) -> Result<Self, Failure> {
        let sampling = Sampling {
            samples: args.steps * args.batch,
            partners: 0,
            budget_frames: args.budget_frames,
            ..Sampling::holding_out(args.held_out_every)
        };
        let player = PlayerConfig { sampling: Some(sampling), ..args.source.player() };
        let renderer =
            RendererConfig { views: args.views, ..RendererConfig::new(args.source.objects.clone(), args.label_px()) };
        // The names of the nodes are those of the graph, so that what they draw is the same.
        let named = |name: &str| Context { name: name.into(), ..context(args.seed) };
        Ok(Self {
            player: PlayerNode::create(player, &named("player"))?,
            renderer: RendererNode::create(renderer, &named("renderer"))?,
            truth: args.source.truth()?,
            context: named("player"),
            seed: args.seed,
            form,
        })
    }

    fn sample(&mut self, number: u64) -> Result<Option<Sample>, Failure> {
        let mut messages = InMemory::default();
        let Produced::Frame(key) = self.player.produce(number, &mut messages, &self.context)? else {
            return Err("the recordings have no frame to train with".into());
        };
        messages.key = Some(key);
        messages.messages.retain(|(port, _)| port != "partners");
        let context = Context { name: "renderer".into(), ..context(self.seed) };
        step(&mut self.renderer, &mut messages, &context)?;
        let views = ReferenceViews::view(bytes(&messages, "views")?)?;
        let Some((flow, labels)) = self.labels(&views)? else { return Ok(None) };
        let (flow, labels) = (FlowFields::view(&flow)?, PseudoLabels::view(&labels)?);
        let colours = Context { name: "trainer".into(), ..context }.rng(number, "augment 0");
        Ok(Some(Sample::of(&views, &flow, &labels, 0, self.form, Some(colours))))
    }

    /// Truth in the form of labels; none when nothing of the object is seen.
    fn labels(&self, views: &ReferenceViews<'_>) -> Result<Option<(AlignedBytes, AlignedBytes)>, Failure> {
        let header = views.header;
        let flow_header = FlowFieldsHeader {
            fields: views.views.len() as u32,
            size_px: header.size_px,
            weights_version: 0,
            has_certainty: 0,
            reserved: 0,
        };
        let mut flow = AlignedBytes::zeroed(FlowFields::byte_len(&flow_header));
        FlowFields::write(&mut flow, flow_header);
        let labels_header = PseudoLabelsHeader {
            weights_version: 0,
            instances: header.instances,
            views_per_instance: header.views_per_instance,
            size_px: header.size_px,
            scene_id: header.scene_id,
            image_id: header.image_id,
            tau_px: 0.0,
        };
        let mut labels = AlignedBytes::zeroed(PseudoLabels::byte_len(&labels_header));
        let message = PseudoLabels::write(&mut labels, labels_header);
        let area = (header.size_px * header.size_px) as usize;
        let mut seen = 0;
        for number in 0..views.views.len() {
            let Some(truth) = self.truth.flow(views, number)? else { continue };
            seen += truth.seen.iter().filter(|v| **v != 0).count();
            message.valid[number * area..(number + 1) * area].copy_from_slice(&truth.seen);
            message.label_px[2 * number * area..2 * (number + 1) * area].copy_from_slice(&truth.flow_px);
        }
        Ok((seen > 0).then_some((flow, labels)))
    }
}

pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let config = TrainerConfig {
        network: args.network.clone(),
        size_px: args.label_px(),
        student_px: Some(args.size),
        frames_per_step: args.batch,
        repeats: args.repeats,
        max_lr: args.max_lr,
        ema_alpha: args.ema,
        photo_weight: 0.0,
        ..TrainerConfig::new(args.weights.clone(), args.out.clone(), args.steps)
    };
    config.check()?;
    let mut state = AdaptState::new(&config)?;
    let mut source = Samples::open(args, SampleForm { by: config.shrink(), geometry: state.network().is_refiner() })?;
    let style = ProgressStyle::with_template("{bar:30} step {pos}/{len} {msg} {eta}")?;
    let bar = ProgressBar::new(args.steps).with_style(style);
    let mut log = String::from("step,loss_flow,epe_px,grad_norm\n");
    for step in 0..args.steps {
        let numbers = step * args.batch..(step + 1) * args.batch;
        let samples = numbers.map(|n| source.sample(n)).collect::<Result<Vec<_>, Failure>>()?;
        let result = state.train(&mut samples.into_iter().flatten().collect::<Vec<_>>(), &config)?;
        bar.set_message(format!("loss {:.3} EPE {:.2} px", result.loss_flow, result.epe_px));
        bar.inc(1);
        writeln!(log, "{},{},{},{}", result.step, result.loss_flow, result.epe_px, result.grad_norm)?;
        std::fs::write(args.out.with_extension("csv"), &log)?;
    }
    bar.finish();
    state.teacher().save(&args.out)?;
    println!("{}", args.out.display());
    Ok(())
}
