//! `pseudoflow eval`: writes a graph, runs it in this process, scores the files that it left.

mod compare;
mod graph;
mod table;

use anyhow::{Context as _, Result, bail, ensure};
pub(crate) use compare::{CompareArgs, compare};
use graph::Files;
use pseudoflow_cli::RARE;
use pseudoflow_cli::in_process::Written;
use pseudoflow_cli::progress::progress_bar;
use pseudoflow_evaluator::results::{details_of_estimates, read_details};
use pseudoflow_evaluator::{EvalDataset, NamedEstimates, evaluate, load_dataset, overlays};
use pseudoflow_metrics::{Estimate, ResultsWriter, Target, read_results};
use pseudoflow_network::ComputeDevice;
use pseudoflow_pnp::Stages;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The dataset: a folder with `models/` and splits, as BOP lays them out.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    dataset: PathBuf,
    /// The split: a folder of the dataset.
    ///
    /// E.g. `test`, or `test_primesense` of T-LESS.
    #[arg(long, default_value = "test")]
    split: String,
    /// Weights to refine with: `.safetensors` or `.onnx`.
    ///
    /// Without them, what the initializer finds, or else `--csv`, is scored.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    weights: Option<PathBuf>,
    /// Meshes to render, a BOP `models` folder.
    ///
    /// Without: the dataset's with textures or colours.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_parser = pseudoflow_runtime::shipped::input)]
    objects: Option<PathBuf>,
    /// Initial poses: a BOP result file, or the weights of an initializer.
    ///
    /// An initializer (.safetensors) is run on every image. The default is each scene's `init_poses.json`.
    #[arg(long, value_parser = pseudoflow_runtime::shipped::input)]
    init: Option<PathBuf>,
    /// Weights of a flow network in whose features the initializer compares.
    ///
    /// The objects, rendered from all sides, are compared with the image.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_parser = pseudoflow_runtime::shipped::input)]
    init_compare: Option<PathBuf>,
    /// The network that the initializer's weights belong to: nano, full or a YAML file.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value = "nano")]
    init_network: String,
    /// A target list such as `test_targets_bop19.json`.
    #[arg(long)]
    targets: Option<PathBuf>,
    /// The result file, METHOD_DATASET-SPLIT.csv.
    ///
    /// Written when weights are given, else read.
    #[arg(long)]
    csv: PathBuf,
    /// Folder for `report.json` and `report.html`.
    #[arg(long)]
    report: Option<PathBuf>,
    /// The network that the weights belong to: auto, refiner, nano, small or paper.
    ///
    /// `auto`: as the weights say.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value = "auto")]
    network: String,
    /// Width and height of the crops, pixels.
    ///
    /// Several, for one pass after the other (`128,256`): the last one goes on.
    #[arg(long, value_delimiter = ',', default_value = "128")]
    size: Vec<u32>,
    /// Iterations of the network.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    iterations: Option<u32>,
    /// Refinement passes.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 1)]
    passes: u32,
    /// What computes flow: auto, cpu, `vulkan[:N]` or `cuda[:N]`.
    #[arg(long, default_value = "auto")]
    device: ComputeDevice,
    /// Engine of the flow network: auto, onnxruntime, rten or burn.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value = "auto")]
    backend: String,
    /// ONNX Runtime's library; else `ORT_DYLIB_PATH`, as everywhere.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    onnxruntime: Option<PathBuf>,
    /// The gate's model, a file that `pseudoflow calibrate` wrote.
    ///
    /// Without it that of the binary.
    #[arg(long, help_heading = RARE, hide_short_help = true, conflicts_with = "no_gate", value_parser = pseudoflow_runtime::shipped::input)]
    gate: Option<PathBuf>,
    /// Smallest probability of being better for a refined pose to be accepted.
    ///
    /// 0..1.
    #[arg(long, help_heading = RARE, hide_short_help = true, conflicts_with = "no_gate")]
    min_better: Option<f64>,
    /// What poses are solved from: flow, region or joint.
    ///
    /// `region`: the contour alone, needs no weights. `joint`: flow, contour and rough pose.
    #[arg(long, default_value = "flow")]
    stages: String,
    /// Accept every refined pose, also those that the gate would refuse.
    #[arg(long, help_heading = RARE, hide_short_help = true)]
    no_gate: bool,
    /// Go on with the `.part` file of an interrupted evaluation.
    #[arg(long)]
    resume: bool,
    /// Seed of the run.
    #[arg(long, help_heading = RARE, hide_short_help = true, default_value_t = 1)]
    seed: u64,
    /// Objects to report without, too, `7` or `7,3`.
    ///
    /// Those whose mesh is too coarse to judge by, say.
    #[arg(long, help_heading = RARE, hide_short_help = true, value_delimiter = ',', value_name = "ID")]
    exclude_objects: Vec<u32>,
    /// Only every n-th image of the split, for a quick look.
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// What `pseudoflow compare` does now.
    #[arg(long, num_args = 2, hide = true, value_parser = moved)]
    compare: Option<Vec<String>>,
}

fn moved(_: &str) -> Result<String, &'static str> {
    Err("write `pseudoflow compare BEFORE.json AFTER.json`")
}

impl Args {
    /// Whether poses are refined here.
    fn refines(&self) -> Result<bool> {
        Ok(self.weights.is_some() || stages_named(&self.stages)? == Stages::Region)
    }

    /// The initializer's weights, if they are to give the initial poses.
    fn initializer(&self) -> Option<&Path> {
        self.init.as_deref().filter(|path| path.extension().is_some_and(|extension| extension == "safetensors"))
    }

    /// The meshes to render.
    fn objects(&self, dataset: &EvalDataset) -> PathBuf {
        self.objects.clone().unwrap_or_else(|| dataset.render_dir.clone())
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let runs = args.refines()? || args.initializer().is_some();
    if runs {
        check_name(args)?;
    }
    let dataset = dataset(args)?;
    let sets = match runs {
        true => run_graph(args, &dataset)?,
        false => vec![NamedEstimates::new("estimate", read_results(&args.csv, Some(&dataset.known))?)],
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
    let mut dataset = load_dataset(&args.dataset, &args.split, args.targets.as_deref())?;
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
    let dataset = args.dataset.canonicalize().unwrap_or_else(|_| args.dataset.clone());
    let dataset = dataset.file_name().and_then(|name| name.to_str()).unwrap_or("DATASET").to_owned();
    let ending = format!("_{dataset}-{}.csv", args.split.replace('_', "-"));
    let name = args.csv.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let method = name.strip_suffix(&ending).unwrap_or_default();
    if method.is_empty() || method.contains(['_', '-']) {
        bail!("`--csv {}`: a result file is named METHOD{ending}, METHOD without `_` and `-`", args.csv.display());
    }
    Ok(())
}

/// Runs the graph over the images that an interrupted run has not done, and reads what it left.
fn run_graph(args: &Args, dataset: &EvalDataset) -> Result<Vec<NamedEstimates>> {
    let files = Files::beside(&args.csv);
    files.make_folder()?;
    let done = images_done(args)?;
    let is_left = |image: &(u32, u32)| !done.contains(image);
    files.write_targets(
        &targets(dataset).into_iter().filter(|t| is_left(&(t.scene_id, t.image_id))).collect::<Vec<_>>(),
    )?;
    let graph = graph::graph(args, dataset, &files)?;
    let what = if args.refines()? { "refine" } else { "find" };
    let written = Written { graph: &graph, file: &files.graph() };
    written.run(&crate::registry(), what, dataset.images.len() as u64, done.len() as u64)?;
    if !args.refines()? {
        return Ok(vec![NamedEstimates::new("init", read_results(&args.csv, None)?)]);
    }
    let refined = read_results(&args.csv, None)?;
    let passes: Vec<_> = (1..=args.passes).map(|pass| read_details(&files.details(pass))).collect::<Result<_, _>>()?;
    let details = details_of_estimates(&refined, &passes)?;
    let refined = NamedEstimates { details, ..NamedEstimates::new("refined", refined) };
    Ok(vec![NamedEstimates::new("init", initial(args, dataset, &files)?), refined])
}

/// Images that the file of an interrupted run holds whole; what else it holds is removed.
fn images_done(args: &Args) -> Result<BTreeSet<(u32, u32)>> {
    if !(args.resume && args.refines()?) {
        return Ok(BTreeSet::new());
    }
    let (_, done) = ResultsWriter::resume(&args.csv.with_extension("csv.part"))?;
    Ok(done.iter().map(|estimate| (estimate.scene_id, estimate.image_id)).collect())
}

/// The dataset's images and what is to be found in each.
fn targets(dataset: &EvalDataset) -> Vec<Target> {
    let of_image = |image: &pseudoflow_evaluator::EvalImage| {
        let (scene_id, image_id) = (image.scene_id, image.frame.image_id);
        let target = move |(&object_id, &inst_count)| Target { scene_id, image_id, object_id, inst_count };
        image.targets.iter().map(target).collect::<Vec<_>>()
    };
    dataset.images.iter().flat_map(of_image).collect()
}

/// The poses that the refinement began from.
fn initial(args: &Args, dataset: &EvalDataset, files: &Files) -> Result<Vec<Estimate>> {
    Ok(match &args.init {
        Some(_) if args.initializer().is_some() => read_results(&files.found(), None)?,
        Some(path) => read_results(path, Some(&dataset.known))?,
        None => dataset.initial_estimates(),
    })
}

pub(super) fn stages_named(name: &str) -> Result<Stages> {
    Ok(match name {
        "flow" => Stages::Flow,
        "region" => Stages::Region,
        "joint" => Stages::Joint,
        other => bail!("`--stages {other}`: write flow, region or joint"),
    })
}
