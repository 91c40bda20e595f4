//! `pseudoflow calibrate`: what the gate believes, from synthetic images. Objects are placed in synthetic scenes, whose truth
//! is lawful; rough poses are made of it; the pipeline refines them as it would those of a camera's image; and from what it
//! says about itself a model is fitted that tells how often that was right.

mod fit;
mod pipeline;
mod samples;
mod starts;

use anyhow::{Context as _, Result, bail, ensure};
use fit::{Fitted, fit_stage};
use pipeline::{Pipeline, PipelineConfig};
use pseudoflow_cli::progress::progress_bar;
use pseudoflow_flow::FlowConfig;
use pseudoflow_inference::EngineConfig;
use pseudoflow_network::ComputeDevice;
use pseudoflow_pnp::gate::{GateModel, Stage};
use pseudoflow_pnp::{PnpNodeConfig, Stages};
use pseudoflow_renderer::RendererConfig;
use samples::{Maker, Sample};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Meshes to calibrate with: BOP `models` folders.
    ///
    /// Plain and textured ones, and none of those that it will be tested with.
    #[arg(long, required = true, num_args = 1.., value_parser = pseudoflow_runtime::shipped::input)]
    objects: Vec<PathBuf>,
    /// Weights of the flow network; `--stages region` needs none.
    ///
    /// `.safetensors` or `.onnx`.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    weights: Option<PathBuf>,
    /// The network that the weights belong to: nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// What poses are solved from: flow, region (the contour alone) or joint.
    #[arg(long, default_value = "flow")]
    stages: String,
    /// Refinements to make and learn from.
    ///
    /// 0 to learn from `--samples` alone.
    #[arg(long, default_value_t = 3000)]
    pairs: usize,
    /// Width and height of the crops, pixels.
    ///
    /// Several share the refinements.
    #[arg(long, value_delimiter = ',', default_value = "256")]
    size: Vec<u32>,
    /// Iterations of the network.
    #[arg(long)]
    iterations: Option<u32>,
    /// Ridge of the models: how strongly weights are drawn to 0.
    #[arg(long, default_value_t = 3.0)]
    ridge: f64,
    /// Seed of the scenes and of the rough poses.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The model to write; `gate.model` of pnp names it.
    ///
    /// Other stages stay as they are in it, or as in the binary where there is no such file yet. The samples go beside
    /// it, `.STAGES.samples.jsonl`.
    #[arg(long)]
    out: PathBuf,
    /// Samples of earlier runs to fit with too.
    #[arg(long, num_args = 1..)]
    samples: Vec<PathBuf>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    ensure!(!args.size.is_empty() && args.ridge > 0.0, "give at least one `--size` and a `--ridge` over 0");
    let stages = super::eval::stages_named(&args.stages)?;
    ensure!(
        args.pairs == 0 || stages == Stages::Region || args.weights.is_some(),
        "`--stages {}` needs `--weights`: those of the flow network",
        args.stages
    );
    let mut all = Vec::new();
    for file in &args.samples {
        all.extend(samples::read(file)?);
    }
    if args.pairs > 0 {
        let made = make(args, stages)?;
        samples::write(&args.out.with_extension(format!("{}.samples.jsonl", args.stages)), &made)?;
        all.extend(made);
    }
    if let Some(other) = all.iter().find(|s| s.stage != stages.learnt()) {
        bail!(
            "`--samples`: there are samples of stage {:?} among them; `--stages {}` wants its own",
            other.stage,
            args.stages
        );
    }
    let fitted = fit_stage(&all, args.ridge).with_context(|| format!("{} refinements", all.len()))?;
    print!("{}", report(&all, &fitted));
    write(args, stages.learnt(), &all, fitted)?;
    println!("model: {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

/// As many refinements as asked for, an equal share of each folder and size.
fn make(args: &Args, stages: Stages) -> Result<Vec<Sample>> {
    let bar = progress_bar(args.pairs as u64, "refine");
    let shares = args.objects.len() * args.size.len();
    let mut made = Vec::with_capacity(args.pairs);
    for (i, (folder, size)) in args.objects.iter().flat_map(|f| args.size.iter().map(move |s| (f, *s))).enumerate() {
        let wanted = args.pairs * (i + 1) / shares - args.pairs * i / shares;
        let mut pipeline = pipeline(args, stages, folder, size)?;
        let maker = Maker::open(folder, args.seed + 1000 * i as u64, stages.learnt())?;
        let mut of_share = Vec::with_capacity(wanted);
        let mut scene = 0;
        while of_share.len() < wanted {
            of_share.extend(maker.scene(scene, &mut pipeline)?);
            scene += 1;
            bar.set_position((made.len() + of_share.len()).min(args.pairs) as u64);
            ensure!(scene < 100 + 20 * wanted as u64, "{}: its objects are hardly ever seen", folder.display());
        }
        of_share.truncate(wanted);
        made.extend(of_share);
    }
    bar.finish_and_clear();
    Ok(made)
}

fn pipeline(args: &Args, stages: Stages, objects: &Path, size_px: u32) -> Result<Pipeline> {
    let views = match &args.weights {
        Some(weights) if stages != Stages::Region => {
            Some((RendererConfig::new(objects.to_owned(), size_px), flow_config(args, weights, size_px)?))
        }
        _ => None,
    };
    Pipeline::open(PipelineConfig {
        views,
        // Without a gate every solution comes out, the bad ones too.
        pnp: PnpNodeConfig { gate: None, stages, objects: Some(objects.to_owned()), ..PnpNodeConfig::default() },
        seed: args.seed,
    })
}

fn flow_config(args: &Args, weights: &Path, size_px: u32) -> Result<FlowConfig> {
    Ok(FlowConfig {
        model: weights.to_owned(),
        network: pseudoflow_cli::graphs::network(&args.network)?,
        size_px,
        iterations: args.iterations,
        max_batch: 16,
        device: ComputeDevice::default(),
        engine: EngineConfig::default(),
        lockstep: None,
    })
}

fn report(samples: &[Sample], fitted: &Fitted) -> String {
    let right = |error: fn(&Sample) -> f64| samples.iter().filter(|s| error(s) < 0.1).count();
    let mut text = format!(
        "{} refinements of {} objects: right before {}, after {}; better after {}\n{:16} {:>7} {:>7} {:>10} {:>10} {:>10}\n",
        samples.len(),
        fitted.objects,
        right(|s| s.before),
        right(|s| s.after),
        samples.iter().filter(|s| s.is_better()).count(),
        "unseen objects",
        "share",
        "Brier",
        "chance's",
        "calib. err",
        "area (ROC)",
    );
    for (name, check) in &fitted.checks {
        text += &format!(
            "{name:16} {:>7.3} {:>7.3} {:>10.3} {:>10.3} {:>10.3}\n",
            check.share, check.brier, check.chance, check.calibration_error, check.area
        );
    }
    let [pose, translation, rotation] = fitted.coverage;
    text += &format!(
        "truth within the 95 % ellipsoid, unseen objects: {pose:.3} (translation {translation:.3}, rotation {rotation:.3}); \
         before the scaling {:.3}\n",
        fitted.coverage_before
    );
    text
}

fn write(args: &Args, stage: Stage, samples: &[Sample], fitted: Fitted) -> Result<()> {
    let mut model = GateModel::load(args.out.is_file().then_some(args.out.as_path()))?;
    model.learn(stage, fitted.model, &command(args, samples.len()));
    let text = format!(
        "# What pnp's gate believes (nodes/pnp/src/gate/model.rs says what the numbers mean).\n{}",
        serde_yaml::to_string(&model)?
    );
    std::fs::write(&args.out, text).with_context(|| format!("{}: cannot be written", args.out.display()))
}

/// The command again, for the file's head.
fn command(args: &Args, refinements: usize) -> String {
    let folders: Vec<String> = args.objects.iter().map(|f| f.display().to_string()).collect();
    let sizes: Vec<String> = args.size.iter().map(u32::to_string).collect();
    let weights = args.weights.as_ref().map_or(String::new(), |w| format!(" --weights {}", w.display()));
    format!(
        "pseudoflow calibrate --stages {} --objects {}{weights} --size {} --pairs {} --ridge {} --seed {} ({refinements} refinements)",
        args.stages,
        folders.join(" "),
        sizes.join(","),
        args.pairs,
        args.ridge,
        args.seed,
    )
}
