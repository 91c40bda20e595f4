//! `pseudoflow bench-device`: how fast a device trains and looks. Random weights and images: times depend on neither.

use anyhow::{Context as _, Result, anyhow, ensure};
use pseudoflow_flow::{FlowConfig, FlowNode};
use pseudoflow_inference::EngineConfig;
use pseudoflow_learning::{Device, FlowBatch, OpenDevice, RefinerBatch, TrainConfig, TrainState};
use pseudoflow_msgs::{AlignedBytes, FrameKey, ReferenceViews, ReferenceViewsHeader};
use pseudoflow_network::{ComputeDevice, FlowNetwork, REFERENCE_CHANNELS, Weights};
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

#[derive(clap::Args)]
pub(crate) struct Args {
    /// What computes: auto, cpu, `vulkan[:N]` or `cuda[:N]`.
    #[arg(long, default_value = "auto")]
    device: ComputeDevice,
    /// Networks, by name.
    #[arg(long, value_delimiter = ',', default_value = "refiner,nano,small")]
    networks: Vec<String>,
    /// Pairs in a training step, at 128 px; larger crops get fewer, so that the pixels stay the same.
    #[arg(long, default_value_t = 16)]
    batch: usize,
    /// Width and height of the crops of a look, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Objects in a look.
    #[arg(long, value_delimiter = ',', default_value = "1,8")]
    objects: Vec<u32>,
    /// Iterations of a look; the network's own number where absent.
    #[arg(long)]
    iterations: Option<u32>,
    /// Seconds for each number, behind the first run, in which a GPU chooses its kernels.
    #[arg(long, default_value_t = 4.0)]
    seconds: f64,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    ensure!(args.batch > 0 && args.objects.iter().all(|n| *n > 0), "`--batch`, `--objects`: give at least 1");
    let open = OpenDevice::open(args.device)?;
    println!("device {open}");
    for name in &args.networks {
        let network = FlowNetwork::named(name)?;
        train(args, name, &network, &open.device)?;
        look(args, name, &network, open.choice)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Seconds of the first run, and the median of those that fit into the time.
struct Times {
    first_s: f64,
    median_s: f64,
}

fn time(seconds: f64, mut work: impl FnMut() -> Result<()>) -> Result<Times> {
    let mut once = || {
        let start = Instant::now();
        work().map(|()| start.elapsed().as_secs_f64())
    };
    let first_s = once()?;
    let end = Instant::now() + Duration::from_secs_f64(seconds);
    let mut times = Vec::new();
    while times.len() < 3 || Instant::now() < end {
        times.push(once()?);
    }
    times.sort_by(f64::total_cmp);
    Ok(Times { first_s, median_s: times[times.len() / 2] })
}

/// Values in [-1, 1] without a pattern that a network could use.
fn noise(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i as f32 * 12.9898).sin()).collect()
}

/// Pairs of one training step.
struct Pairs {
    n: usize,
    reference: Vec<f32>,
    real: Vec<f32>,
    flow: Vec<f32>,
    ones: Vec<f32>,
}

impl Pairs {
    fn new(n: usize, size_px: usize) -> Self {
        let area = size_px * size_px;
        let reference = noise(n * REFERENCE_CHANNELS * area);
        Self { n, reference, real: noise(n * 3 * area), flow: noise(n * 2 * area), ones: vec![1.0; n * area] }
    }

    fn of_raft(&self) -> FlowBatch<'_> {
        FlowBatch { reference: &self.real, real: &self.real, flow: &self.flow, mask: &self.ones, n: self.n }
    }

    fn of_refiner(&self) -> RefinerBatch<'_> {
        let Self { reference, real, flow, ones, n } = self;
        RefinerBatch { reference, real, flow, visible: ones, n: *n }
    }
}

fn train(args: &Args, name: &str, network: &FlowNetwork, device: &Device) -> Result<()> {
    let size = network.size_px();
    let n = (args.batch * 128 * 128 / (size * size)).max(1);
    let (pairs, config) = (Pairs::new(n, size), TrainConfig::new(1e-5, 1_000_000));
    let weights = random(network);
    let times = match network {
        FlowNetwork::Raft(raft) => {
            let mut state = TrainState::new(raft.clone(), config, weights, device)?;
            time(args.seconds, || Ok(state.train_step(&pairs.of_raft()).map(drop)?))?
        }
        FlowNetwork::Refiner(refiner) => {
            let mut state = TrainState::new(refiner.clone(), config, weights, device)?;
            time(args.seconds, || Ok(state.train_step(&pairs.of_refiner()).map(drop)?))?
        }
    };
    println!(
        "train {name} {size} px, batch {n}: {:.1} pairs/s ({:.1} ms a step; the first {:.1} s)",
        n as f64 / times.median_s,
        1e3 * times.median_s,
        times.first_s
    );
    Ok(())
}

fn random(network: &FlowNetwork) -> Weights {
    match network {
        FlowNetwork::Raft(raft) => Weights::random(raft, 1),
        FlowNetwork::Refiner(refiner) => Weights::random(refiner, 1),
    }
}

/// The flow node as graphs use it.
fn look(args: &Args, name: &str, network: &FlowNetwork, device: ComputeDevice) -> Result<()> {
    let folder = std::env::temp_dir().join(format!("pseudoflow-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let model = folder.join("random.safetensors");
    random(network).save(&model)?;
    let found = look_with(args, name, network, device, &model);
    std::fs::remove_dir_all(&folder).with_context(|| format!("{}: cannot be removed", folder.display()))?;
    found
}

fn look_with(args: &Args, name: &str, network: &FlowNetwork, device: ComputeDevice, model: &Path) -> Result<()> {
    let config = FlowConfig {
        model: model.to_owned(),
        network: pseudoflow_cli::graphs::network(name)?,
        size_px: args.size,
        iterations: args.iterations,
        max_batch: 16,
        device,
        engine: EngineConfig::default(),
        lockstep: None,
    };
    let iterations = args.iterations.map_or(network.iterations_infer(), |given| given as usize);
    let context = Context { name: "bench".into(), seed: 0, out_dir: "/".into(), restarts: 0, replay: true };
    let failed = |error| anyhow!("{error}");
    FlowNode::check(&config).map_err(failed)?;
    let mut node = FlowNode::create(config, &context).map_err(failed)?;
    for &objects in &args.objects {
        let mut inputs = InMemory::new(FrameKey { index: 0, stamp_ns: 0 });
        inputs.messages.push(("views".into(), views(objects, args.size)));
        let times = time(args.seconds, || {
            node.process(&inputs, &mut InMemory::default(), &context).map_err(|error| anyhow!("{error}"))
        })?;
        println!(
            "look {name} {} px, {iterations} iterations, {objects} objects: {:.2} ms an object (the first run {:.1} s)",
            args.size,
            1e3 * times.median_s / f64::from(objects),
            times.first_s
        );
    }
    Ok(())
}

fn views(instances: u32, size_px: u32) -> AlignedBytes {
    let header = ReferenceViewsHeader {
        instances,
        views_per_instance: 1,
        size_px,
        scene_id: 0,
        image_id: 0,
        skipped: 0,
        partners_per_instance: 0,
        reserved: 0,
    };
    let mut bytes = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
    let message = ReferenceViews::write(&mut bytes, header);
    for (i, value) in message.rgb.iter_mut().chain(message.real_rgb).enumerate() {
        *value = (i * 31 % 253) as u8;
    }
    bytes
}
