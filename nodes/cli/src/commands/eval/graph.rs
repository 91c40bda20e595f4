//! The graph of an evaluation: `config/graphs/eval.yaml` or `config/graphs/find.yaml` with the arguments put in.

use super::{Args, stages_named};
use anyhow::{Context as _, Result, bail, ensure};
use pseudoflow_cli::in_process::from_contours_alone;
use pseudoflow_evaluator::EvalDataset;
use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_initializer::CompareConfig;
use pseudoflow_metrics::Target;
use pseudoflow_pnp::Stages;
use pseudoflow_pnp::gate::GateConfig;
use pseudoflow_runtime::graph::PortRef;
use pseudoflow_runtime::{Graph, GraphError, NodeSpec};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EVAL: &str = include_str!("../../../../../config/graphs/eval.yaml");
const FIND: &str = include_str!("../../../../../config/graphs/find.yaml");

/// Where the run leaves what the result file has no place for: a folder beside it.
pub(super) struct Files(PathBuf);

impl Files {
    pub(super) fn beside(csv: &Path) -> Self {
        Self(csv.with_extension("eval"))
    }

    /// Covariances and the gate's decisions of a pass, counted from 1.
    pub(super) fn details(&self, pass: u32) -> PathBuf {
        self.0.join(format!("details_{pass}.jsonl"))
    }

    /// What the initializer found.
    pub(super) fn found(&self) -> PathBuf {
        self.0.join("found.csv")
    }

    fn targets(&self) -> PathBuf {
        self.0.join("targets.json")
    }

    pub(super) fn make_folder(&self) -> Result<()> {
        std::fs::create_dir_all(&self.0).with_context(|| format!("{}: cannot be made", self.0.display()))
    }

    pub(super) fn write_targets(&self, targets: &[Target]) -> Result<()> {
        let path = self.targets();
        std::fs::write(&path, serde_json::to_string(targets)?)
            .with_context(|| format!("{}: cannot be written", path.display()))
    }

    pub(super) fn graph(&self) -> PathBuf {
        self.0.join("graph.yaml")
    }
}

pub(super) fn graph(args: &Args, dataset: &EvalDataset, files: &Files) -> Result<Graph> {
    let mut graph = match args.refines()? {
        true => refining(args, dataset, files)?,
        false => finding(args, dataset, &args.csv)?,
    };
    set(
        &mut graph,
        &[
            ("seed", json!(args.seed)),
            ("source", json!(args.dataset.join(&args.split))),
            ("player.targets", json!(files.targets())),
        ],
    )?;
    Ok(graph)
}

fn set(graph: &mut Graph, settings: &[(&str, Value)]) -> Result<()> {
    settings.iter().try_for_each(|(key, value)| Ok(graph.set(key, &value.to_string())?))
}

/// The initializer alone, its poses in `csv`.
fn finding(args: &Args, dataset: &EvalDataset, csv: &Path) -> Result<Graph> {
    let mut graph = Graph::parse(FIND, Path::new("config/graphs/find.yaml"))?;
    let engine = EngineConfig { backend: finder_backend(args)?, ..engine(args)? };
    set(
        &mut graph,
        &[
            ("objects", json!(args.objects(dataset))),
            ("initializer", json!(args.initializer())),
            ("csv", json!(csv)),
            ("initializer.network", json!(args.init_network)),
            ("initializer.compare", json!(args.init_compare.clone().map(CompareConfig::new))),
            ("initializer.engine", json!(engine)),
        ],
    )?;
    Ok(graph)
}

/// Rough poses refined, pass after pass.
fn refining(args: &Args, dataset: &EvalDataset, files: &Files) -> Result<Graph> {
    let stages = stages_named(&args.stages)?;
    let gate = GateConfig { model: args.gate.clone(), ..GateConfig::default() };
    let gate = GateConfig { min_better: args.min_better.unwrap_or(gate.min_better), ..gate };
    let mut graph = Graph::parse(EVAL, Path::new("config/graphs/eval.yaml"))?;
    let poses_file = args.init.as_ref().filter(|_| args.initializer().is_none());
    set(
        &mut graph,
        &[
            ("objects", json!(args.objects(dataset))),
            ("stages", json!(stages)),
            ("csv", json!(args.csv)),
            ("details", json!(files.details(args.passes))),
            ("player.initial_poses", json!({"file": poses_file})),
            ("pnp.gate", json!((!args.no_gate).then_some(gate))),
            ("results.append", json!(args.resume)),
        ],
    )?;
    match args.weights.as_ref().filter(|_| stages != Stages::Region) {
        Some(weights) => set(
            &mut graph,
            &[
                ("weights", json!(weights)),
                ("network", json!(pseudoflow_cli::graphs::network(&args.network)?)),
                ("device", json!(args.device)),
                ("flow.iterations", json!(args.iterations)),
                ("flow.engine", json!(engine(args)?)),
            ],
        )?,
        None => leave_flow_out(&mut graph, stages)?,
    }
    repeat(&mut graph, args, files)?;
    if args.initializer().is_some() {
        find_first(&mut graph, finding(args, dataset, &files.found())?, args.resume)?;
    }
    Ok(graph)
}

/// Poses from contours alone.
fn leave_flow_out(graph: &mut Graph, stages: Stages) -> Result<()> {
    ensure!(stages == Stages::Region, "`--stages` but for `region` needs `--weights`");
    from_contours_alone(graph, "player")
}

fn port(node: &str, port: &str) -> PortRef {
    PortRef { node: node.into(), port: port.into() }
}

/// One pass after the other, each from the poses of the one before; the results are those of the last.
fn repeat(graph: &mut Graph, args: &Args, files: &Files) -> Result<()> {
    let (sizes, passes) = (args.size.len() as u32, args.passes);
    ensure!(passes > 0, "`--passes 0`: give at least 1");
    ensure!(sizes <= passes, "`--size` names {sizes} sizes for `--passes {passes}`: give a pass to each");
    let results = graph.nodes.shift_remove("results").context("the graph has results")?;
    let names = |pass: u32| move |name: &str| if pass == 1 { name.to_owned() } else { format!("{name}_{pass}") };
    let first: Vec<(String, NodeSpec)> =
        graph.nodes.iter().filter(|(name, _)| *name != "player").map(|(n, spec)| (n.clone(), spec.clone())).collect();
    for pass in 1..=passes {
        let (name, before) = (names(pass), names(pass - 1));
        for (node, spec) in &first {
            let mut spec = spec.clone();
            for from in spec.inputs.values_mut().filter(|_| pass > 1) {
                *from = match (from.node.as_str(), from.port.as_str()) {
                    ("player", "initial_poses") => port(&before("pnp"), "poses"),
                    ("player", _) => from.clone(),
                    (node, port_name) => port(&name(node), port_name),
                };
            }
            graph.nodes.insert(name(node), spec);
            if ["renderer", "flow"].contains(&node.as_str()) {
                let size_px = args.size[(pass.min(sizes) - 1) as usize];
                set(graph, &[(&format!("{}.size_px", name(node)), json!(size_px))])?;
            }
        }
        let mut of_pass = results.clone();
        of_pass.inputs.insert("poses".into(), port(&name("pnp"), "poses"));
        of_pass.inputs.insert("decisions".into(), port(&name("pnp"), "decisions"));
        if pass < passes {
            of_pass.config = serde_yaml::to_value(json!({"details": files.details(pass), "append": args.resume}))?;
        }
        graph.nodes.insert(name("results"), of_pass);
    }
    Ok(())
}

/// Lets an initializer give the rough poses, and keeps what it finds.
fn find_first(graph: &mut Graph, finding: Graph, append: bool) -> Result<()> {
    let finding = finding.resolved().map_err(GraphError::Problems)?;
    for spec in graph.nodes.values_mut() {
        for from in spec.inputs.values_mut().filter(|from| **from == port("player", "initial_poses")) {
            *from = port("initializer", "initial_poses");
        }
    }
    let player = graph.nodes.shift_remove_entry("player").context("the graph has a player")?;
    let others = std::mem::take(&mut graph.nodes);
    let found = finding.nodes.into_iter().filter(|(name, _)| name != "player");
    graph.nodes = std::iter::once(player).chain(found).chain(others).collect();
    set(graph, &[("found.append", json!(append))])
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
fn finder_backend(args: &Args) -> Result<Backend> {
    let backend = engine(args)?.backend;
    Ok(if backend == Backend::Burn { Backend::Auto } else { backend })
}
