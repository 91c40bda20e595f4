mod compare;
mod convert;
mod table;

use super::progress_bar;
use crate::pipeline::{Finder, Pipeline, PipelineConfig};
use anyhow::{Context as _, Result, bail, ensure};
pub(crate) use compare::{CompareArgs, compare};
use convert::{details, estimate, frame, given};
use pseudoflow_evaluator::{EstimateDetails, EvalDataset, EvalImage, NamedEstimates, evaluate, load_dataset, overlays};
use pseudoflow_flow::FlowConfig;
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_initializer::{CompareConfig, InitializerConfig};
use pseudoflow_metrics::{Estimate, ResultsWriter, read_results};
use pseudoflow_msgs::ObjectPose;
use pseudoflow_network::ComputeDevice;
use pseudoflow_pnp::gate::GateConfig;
use pseudoflow_pnp::{Look, PnpNodeConfig, Stages};
use pseudoflow_renderer::RendererConfig;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The dataset: a folder with `models/` and splits, as BOP lays them out.
    #[arg(long, required_unless_present = "compare")]
    dataset: Option<PathBuf>,
    /// The split: a folder of the dataset, e.g. `test`, or `test_primesense` of T-LESS.
    #[arg(long, default_value = "test")]
    split: String,
    /// Weights to refine with: `.safetensors` or `.onnx`. Without them, what the initializer finds, or else `--csv`, is scored.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Meshes to render, a BOP `models` folder; without: the dataset's with textures or colours.
    #[arg(long)]
    objects: Option<PathBuf>,
    /// Initial poses: a BOP result file (.csv), or the weights of an initializer (.safetensors), which is then run on every
    /// image. The default is each scene's `init_poses.json`.
    #[arg(long)]
    init: Option<PathBuf>,
    /// Weights of a flow network in whose feature space the initializer compares the objects, rendered from all sides, with
    /// the image.
    #[arg(long)]
    init_compare: Option<PathBuf>,
    /// The network that the initializer's weights belong to: nano, full or a YAML file.
    #[arg(long, default_value = "nano")]
    init_network: String,
    /// A target list such as `test_targets_bop19.json`.
    #[arg(long)]
    targets: Option<PathBuf>,
    /// The result file, METHOD_DATASET-SPLIT.csv: written when weights are given, else read.
    #[arg(long, required_unless_present = "compare")]
    csv: Option<PathBuf>,
    /// Folder for `report.json` and `report.html`.
    #[arg(long)]
    report: Option<PathBuf>,
    /// The network that the weights belong to: auto (as the weights say), refiner, nano, small or paper.
    #[arg(long, default_value = "auto")]
    network: String,
    /// Width and height of the crops, pixels; several, for one pass after the other (`128,256`): the last one goes on.
    #[arg(long, value_delimiter = ',', default_value = "128")]
    size: Vec<u32>,
    /// Iterations of the network.
    #[arg(long)]
    iterations: Option<u32>,
    /// Refinement passes.
    #[arg(long, default_value_t = 1)]
    passes: u32,
    /// What computes flow: auto, cpu, vulkan[:N] or cuda[:N].
    #[arg(long, default_value = "auto")]
    device: ComputeDevice,
    /// Engine of the flow network: auto, onnxruntime, rten or burn.
    #[arg(long, default_value = "auto")]
    backend: String,
    /// ONNX Runtime's library; else `ORT_DYLIB_PATH`, as everywhere.
    #[arg(long)]
    onnxruntime: Option<PathBuf>,
    /// The gate's model, a file that `pseudoflow calibrate` wrote; without it that of the binary.
    #[arg(long, conflicts_with = "no_gate")]
    gate: Option<PathBuf>,
    /// Smallest probability of being better for a refined pose to be accepted, 0..1.
    #[arg(long, conflicts_with = "no_gate")]
    min_better: Option<f64>,
    /// What poses are solved from: flow, region (the contour alone; needs no weights) or joint (flow, contour and rough pose).
    #[arg(long, default_value = "flow")]
    stages: String,
    /// Accept every refined pose, also those that the gate would refuse.
    #[arg(long)]
    no_gate: bool,
    /// Go on with the `.part` file of an interrupted evaluation.
    #[arg(long)]
    resume: bool,
    /// Seed of the run.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Objects to report without, too, `7` or `7,3`: those whose mesh is too coarse to judge by, say.
    #[arg(long, value_delimiter = ',', value_name = "ID")]
    exclude_objects: Vec<u32>,
    /// Only every n-th image of the split, for a quick look.
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// Instead of evaluating: shows the difference of two reports and writes `compare.html` into `--report`.
    #[arg(long, num_args = 2, value_names = ["BEFORE.json", "AFTER.json"])]
    compare: Option<Vec<PathBuf>>,
}

impl Args {
    /// The parser sees to it that there is one, but for `--compare`.
    fn dataset(&self) -> &Path {
        self.dataset.as_deref().unwrap_or(Path::new(""))
    }

    /// As [`Self::dataset`].
    fn csv(&self) -> &Path {
        self.csv.as_deref().unwrap_or(Path::new(""))
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    if let Some([before, after]) = args.compare.as_deref() {
        let folder = args.report.clone().unwrap_or_default();
        std::fs::create_dir_all(&folder).with_context(|| format!("`--report {}`: cannot be made", folder.display()))?;
        return compare(&CompareArgs {
            before: before.clone(),
            after: after.clone(),
            out: folder.join("compare.html"),
        });
    }
    let stages = stages(args)?;
    if args.weights.is_some() || initializer(args).is_some() || stages == Stages::Region {
        check_name(args)?;
    }
    let dataset = dataset(args)?;
    let sets = match (&args.weights, initializer(args)) {
        (weights, _) if weights.is_some() || stages == Stages::Region => {
            refine_dataset(args, weights.as_deref(), &dataset)?
        }
        (_, Some(initializer)) => {
            let estimates = first_of_each(&find_all(args, initializer, &dataset)?);
            let part = args.csv().with_extension("csv.part");
            let mut writer = ResultsWriter::create(&part)?;
            let image = |e: &Estimate| (e.scene_id, e.image_id);
            for of_image in estimates.chunk_by(|a, b| image(a) == image(b)) {
                writer.write_image(of_image)?;
            }
            std::fs::rename(&part, args.csv())
                .with_context(|| format!("{}: cannot be written", args.csv().display()))?;
            vec![NamedEstimates::new("init", estimates)]
        }
        (_, None) => {
            let estimates = read_results(args.csv(), Some(&dataset.known))?;
            vec![NamedEstimates::new("estimate", estimates)]
        }
    };
    let bar = progress_bar(dataset.images.len() as u64, "score");
    let mut report = evaluate(&dataset, &sets, &|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    if !args.exclude_objects.is_empty() {
        report.leave_out(&args.exclude_objects)?;
    }
    print!("{}", table::table(&report));
    if let Some(folder) = &args.report {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
        report.write_json(&folder.join("report.json"))?;
        report.write_html(&folder.join("report.html"), &overlays(&dataset, &sets, &report)?)?;
        println!("report: {}", folder.join("report.html").display());
    }
    Ok(ExitCode::SUCCESS)
}

/// The split, or every n-th image of it.
fn dataset(args: &Args) -> Result<EvalDataset> {
    ensure!(args.every > 0, "`--every 0`: give 1 for every image, 4 for every fourth");
    let mut dataset = load_dataset(args.dataset(), &args.split, args.targets.as_deref())?;
    if args.every > 1 {
        let all = dataset.images.len();
        dataset.images = dataset.images.into_iter().step_by(args.every).collect();
        dataset.notes.push(format!("Only {} of {all} images: every {}.", dataset.images.len(), args.every));
    }
    Ok(dataset)
}

/// A submission is named METHOD_DATASET-SPLIT.csv, and the benchmark reads dataset and split from there. The folder
/// `test_primesense` is split `test`, type `primesense`: METHOD_tless-test-primesense.csv.
fn check_name(args: &Args) -> Result<()> {
    let dataset = args.dataset().canonicalize().unwrap_or_else(|_| args.dataset().to_owned());
    let dataset = dataset.file_name().and_then(|name| name.to_str()).unwrap_or("DATASET").to_owned();
    let ending = format!("_{dataset}-{}.csv", args.split.replace('_', "-"));
    let name = args.csv().file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let method = name.strip_suffix(&ending).unwrap_or_default();
    if method.is_empty() || method.contains(['_', '-']) {
        bail!("`--csv {}`: a result file is named METHOD{ending}, METHOD without `_` and `-`", args.csv().display());
    }
    Ok(())
}

/// Refines every image; the CSV grows image by image beside its place and is renamed when whole.
fn refine_dataset(args: &Args, weights: Option<&Path>, dataset: &EvalDataset) -> Result<Vec<NamedEstimates>> {
    let initial = match &args.init {
        Some(path) if initializer(args).is_some() => find_all(args, path, dataset)?,
        Some(path) => numbered(read_results(path, Some(&dataset.known))?),
        None => numbered(dataset.initial_estimates()),
    };
    let mut passes = passes(args, weights, dataset)?;
    let part = args.csv().with_extension("csv.part");
    let (mut writer, mut refined) = match args.resume {
        true => ResultsWriter::resume(&part)?,
        false => (ResultsWriter::create(&part)?, Vec::new()),
    };
    // A result file has no place for what else is known of a pose.
    let mut details = vec![EstimateDetails::default(); refined.len()];
    let bar = progress_bar(dataset.images.len() as u64, "refine");
    for image in &dataset.images {
        let is_here = |e: &&Estimate| (e.scene_id, e.image_id) == (image.scene_id, image.frame.image_id);
        if !refined.iter().any(|e| is_here(&e)) {
            let here: Vec<&Initial> = initial.iter().filter(|i| is_here(&&i.estimate)).collect();
            let (estimates, of_them) = refine_image(&mut passes, image, &here)?;
            writer.write_image(&estimates)?;
            refined.extend(estimates);
            details.extend(of_them);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    std::fs::rename(&part, args.csv()).with_context(|| format!("{}: cannot be written", args.csv().display()))?;
    Ok(vec![
        NamedEstimates::new("init", first_of_each(&initial)),
        NamedEstimates { details, ..NamedEstimates::new("refined", refined) },
    ])
}

fn engine(args: &Args) -> Result<EngineConfig> {
    let backend = match args.backend.as_str() {
        "auto" => Backend::Auto,
        "onnxruntime" => Backend::OnnxRuntime,
        "rten" => Backend::Rten,
        "burn" => Backend::Burn,
        other => bail!("`--backend {other}`: write auto, onnxruntime, rten or burn"),
    };
    Ok(EngineConfig { backend, onnxruntime: args.onnxruntime.clone(), ..EngineConfig::default() })
}

/// The initializer's: it runs ONNX files on the processor.
fn finder_engine(args: &Args) -> Result<EngineConfig> {
    let engine = engine(args)?;
    let backend = if engine.backend == Backend::Burn { Backend::Auto } else { engine.backend };
    Ok(EngineConfig { backend, ..engine })
}

/// A pipeline for each size, with the passes that it makes.
fn passes(args: &Args, weights: Option<&Path>, dataset: &EvalDataset) -> Result<Vec<Pipeline>> {
    let (sizes, passes) = (args.size.len() as u32, args.passes);
    ensure!(sizes <= passes, "`--size` names {sizes} sizes for `--passes {passes}`: give a pass to each");
    let open = |(i, size): (usize, &u32)| {
        let passes = if i + 1 == args.size.len() { passes + 1 - sizes } else { 1 };
        Pipeline::open(pipeline_config(args, weights, dataset, (*size, passes))?)
    };
    args.size.iter().enumerate().map(open).collect()
}

fn pipeline_config(
    args: &Args,
    weights: Option<&Path>,
    dataset: &EvalDataset,
    (size_px, passes): (u32, u32),
) -> Result<PipelineConfig> {
    let default = GateConfig::default();
    let min_better = args.min_better.unwrap_or(default.min_better);
    let gate = GateConfig { model: args.gate.clone(), min_better, ..default };
    let stages = stages(args)?;
    let objects = args.objects.clone().unwrap_or_else(|| dataset.render_dir.clone());
    let pnp = PnpNodeConfig {
        gate: (!args.no_gate).then_some(gate),
        stages,
        objects: Some(objects.clone()),
        ..PnpNodeConfig::default()
    };
    let views = match weights.filter(|_| stages != Stages::Region) {
        Some(weights) => {
            let flow = FlowConfig {
                model: weights.to_owned(),
                network: super::export::network(&args.network)?,
                size_px,
                iterations: args.iterations,
                max_batch: 16,
                device: args.device,
                engine: engine(args)?,
                lockstep: None,
            };
            Some((RendererConfig::new(objects, size_px), flow))
        }
        None => None,
    };
    Ok(PipelineConfig { views, pnp, passes, seed: args.seed })
}

fn stages(args: &Args) -> Result<Stages> {
    stages_named(&args.stages)
}

pub(super) fn stages_named(name: &str) -> Result<Stages> {
    Ok(match name {
        "flow" => Stages::Flow,
        "region" => Stages::Region,
        "joint" => Stages::Joint,
        other => bail!("`--stages {other}`: write flow, region or joint"),
    })
}

/// The initializer's weights, if they are to give the initial poses.
fn initializer(args: &Args) -> Option<&Path> {
    args.init.as_deref().filter(|path| path.extension().is_some_and(|extension| extension == "safetensors"))
}

/// A pose to refine.
struct Initial {
    estimate: Estimate,
    /// Poses with one number are hypotheses of one instance.
    instance: u32,
}

/// Each pose an instance of its own.
fn numbered(estimates: Vec<Estimate>) -> Vec<Initial> {
    estimates.into_iter().zip(0..).map(|(estimate, instance)| Initial { estimate, instance }).collect()
}

/// The surest pose of each instance, which comes first.
fn first_of_each(initial: &[Initial]) -> Vec<Estimate> {
    let of = |i: &Initial| (i.estimate.scene_id, i.estimate.image_id, i.estimate.object_id, i.instance);
    initial.chunk_by(|a, b| of(a) == of(b)).map(|same| same[0].estimate.clone()).collect()
}

/// What the initializer finds in every image.
fn find_all(args: &Args, weights: &Path, dataset: &EvalDataset) -> Result<Vec<Initial>> {
    let objects = args.objects.clone().unwrap_or_else(|| dataset.render_dir.clone());
    let config = InitializerConfig {
        network: args.init_network.clone(),
        compare: args.init_compare.clone().map(CompareConfig::new),
        engine: finder_engine(args)?,
        ..InitializerConfig::new(weights.to_owned(), objects)
    };
    let mut finder = Finder::open(config, args.seed)?;
    let bar = progress_bar(dataset.images.len() as u64, "find");
    let mut found = Vec::new();
    for image in &dataset.images {
        let rgb = image.frame.load_image()?;
        let start = std::time::Instant::now();
        let poses = finder.find(&frame(image, &rgb))?;
        let image_time_s = Some(start.elapsed().as_secs_f64());
        for pose in &poses {
            let estimate = Estimate { image_time_s, ..estimate(image, pose)? };
            found.push(Initial { estimate, instance: pose.instance });
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(found)
}

/// The refined poses of an image, and what else is known of each.
fn refine_image(
    passes: &mut [Pipeline],
    image: &EvalImage,
    initial: &[&Initial],
) -> Result<(Vec<Estimate>, Vec<EstimateDetails>)> {
    let rgb = image.frame.load_image()?;
    let mut poses: Vec<ObjectPose> = initial.iter().map(|i| given(&i.estimate, i.instance)).collect();
    let mut took = std::time::Duration::ZERO;
    let mut looks: Vec<Vec<Look>> = Vec::new();
    for pipeline in passes {
        let refined = pipeline.refine(&frame(image, &rgb), &poses)?;
        took += refined.stages.iter().sum::<std::time::Duration>();
        looks.extend(refined.passes);
        poses = looks.last().context("a pipeline makes a pass")?.iter().map(|look| look.pose).collect();
    }
    let image_time_s = Some(took.as_secs_f64());
    let estimates: Result<_> = poses.iter().map(|p| Ok(Estimate { image_time_s, ..estimate(image, p)? })).collect();
    Ok((estimates?, poses.iter().map(|pose| details(pose, &looks)).collect()))
}
