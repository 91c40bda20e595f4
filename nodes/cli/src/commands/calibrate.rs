//! `pseudoflow calibrate`: what the gate believes, from synthetic images. Objects are placed in synthetic scenes, whose truth
//! is lawful; rough poses are made of it; the pipeline refines them as it would those of a camera's image; and from what it
//! says about itself a model is fitted that tells how often that was right.

mod fit;
mod samples;
mod scenes;
mod starts;

pub(crate) use scenes::ScenesNode;

use anyhow::{Context as _, Result, bail, ensure};
use fit::{Fitted, fit_stage};
use pseudoflow_cli::in_process::{Written, from_contours_alone};
use pseudoflow_pnp::Stages;
use pseudoflow_pnp::gate::{GateModel, Stage};
use pseudoflow_runtime::{Graph, read_lines};
use samples::{Sample, SampleReader};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const GRAPH: &str = include_str!("../../../../config/graphs/calibrate.yaml");

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
    /// Synthetic scenes to refine and learn from, each with about four objects.
    ///
    /// 0 to learn from `--samples` alone.
    #[arg(long, default_value_t = 700)]
    scenes: u64,
    /// What earlier versions counted: refused, with the `--scenes` to write.
    #[arg(long, hide = true)]
    pairs: Option<u64>,
    /// Width and height of the crops, pixels.
    ///
    /// Several share the scenes.
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
    /// Other stages stay as they are in it, or as in the binary where there is no such file yet. Beside it lie the samples,
    /// `.STAGES.samples.jsonl`, and the runs that they come from, `.calibrate/`.
    #[arg(long)]
    out: PathBuf,
    /// Samples of earlier runs to fit with too.
    #[arg(long, num_args = 1..)]
    samples: Vec<PathBuf>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    ensure!(!args.size.is_empty() && args.ridge > 0.0, "give at least one `--size` and a `--ridge` over 0");
    if let Some(pairs) = args.pairs {
        bail!(
            "`--pairs {pairs}`: write `--scenes {}`: scenes are counted now, of about four objects each",
            pairs.div_ceil(4)
        );
    }
    let stages = super::eval::stages_named(&args.stages)?;
    ensure!(
        args.scenes == 0 || stages == Stages::Region || args.weights.is_some(),
        "`--stages {}` needs `--weights`: those of the flow network",
        args.stages
    );
    let mut all = Vec::new();
    for file in &args.samples {
        all.extend(read_lines::<Sample>(file).with_context(|| format!("`--samples {}`", file.display()))?);
    }
    if args.scenes > 0 {
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

/// Refinements of as many scenes as asked for, an equal share of each folder and size.
fn make(args: &Args, stages: Stages) -> Result<Vec<Sample>> {
    let shares: Vec<(&PathBuf, u32)> =
        args.objects.iter().flat_map(|folder| args.size.iter().map(move |size_px| (folder, *size_px))).collect();
    let files = args.out.with_extension("calibrate");
    let mut made = Vec::new();
    for (i, (folder, size_px)) in shares.iter().enumerate() {
        let scenes = args.scenes * (i as u64 + 1) / shares.len() as u64 - args.scenes * i as u64 / shares.len() as u64;
        if scenes > 0 {
            let share = Share { objects: folder, size_px: *size_px, scenes, seed: args.seed + 1000 * i as u64 };
            let what = format!("refine, {} of {}", i + 1, shares.len());
            made.extend(share.refine(args, stages, &files.join(i.to_string()), &what)?);
        }
    }
    Ok(made)
}

/// The scenes of one object set that are refined at one size.
struct Share<'a> {
    objects: &'a Path,
    size_px: u32,
    scenes: u64,
    seed: u64,
}

impl Share<'_> {
    /// Runs the graph in a folder of its own; `what` stands before the progress.
    fn refine(&self, args: &Args, stages: Stages, folder: &Path, what: &str) -> Result<Vec<Sample>> {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
        let (truth, details) = (folder.join("truth.jsonl"), folder.join("details.jsonl"));
        let mut graph = self.graph(args, stages)?;
        graph.set_params(&json!({"truth": truth, "details": details}))?;
        let written = Written { graph: &graph, file: &folder.join("graph.yaml") };
        written.run(&crate::registry(), what, self.scenes, 0)?;
        SampleReader::open(self.objects, stages.learnt())?.samples(&truth, &details)
    }

    fn graph(&self, args: &Args, stages: Stages) -> Result<Graph> {
        let mut graph = Graph::parse(GRAPH, Path::new("config/graphs/calibrate.yaml"))?;
        graph.seed = self.seed;
        graph.set_params(&json!({
            "objects": self.objects,
            "scenes": self.scenes,
            "size_px": self.size_px,
            "stages": stages,
            "network": pseudoflow_cli::graphs::network(&args.network)?,
        }))?;
        match args.weights.as_ref().filter(|_| stages != Stages::Region) {
            Some(weights) => {
                graph.set_params(&json!({"weights": weights}))?;
                graph.set("flow.iterations", &json!(args.iterations).to_string())?;
            }
            None => from_contours_alone(&mut graph, "scenes")?,
        }
        Ok(graph)
    }
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
    pseudoflow_files::write(&args.out, text.as_bytes())
        .with_context(|| format!("{}: cannot be written", args.out.display()))
}

/// The command again, for the file's head.
fn command(args: &Args, refinements: usize) -> String {
    let folders: Vec<String> = args.objects.iter().map(|f| f.display().to_string()).collect();
    let sizes: Vec<String> = args.size.iter().map(u32::to_string).collect();
    let weights = args.weights.as_ref().map_or(String::new(), |w| format!(" --weights {}", w.display()));
    format!(
        "pseudoflow calibrate --stages {} --objects {}{weights} --size {} --scenes {} --ridge {} --seed {} ({refinements} refinements)",
        args.stages,
        folders.join(" "),
        sizes.join(","),
        args.scenes,
        args.ridge,
        args.seed,
    )
}
