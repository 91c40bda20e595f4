//! Training of the initializer's network on synthetic scenes (docs/method.md, pipeline step 1).
//!
//! A run is a function of its [`InitializerTraining`]: neither threads nor interruptions change the weights.

mod augment;
mod config;
mod data;
mod preview;
#[cfg(test)]
mod tests;

pub use config::InitializerTraining;
pub use preview::scene_sheet;

use crate::PretrainError;
use crate::offline::{self, Curve, Progress, Row, RunLog, Training, check_same_run, keep_description};
use crate::pretrain::{SHIPPED_WEIGHTS, WarmStart, shipped};
use data::{Prefetch, Source};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_learning::{LossWeights, OpenDevice, TrainConfig, TrainState, Trunk};
use pseudoflow_network::storage::write_atomically;
use pseudoflow_network::{ComputeDevice, DetectorConfig, Grid, NetworkConfig, Weights, WeightsInfo};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// One step of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InitializerStep {
    /// Steps taken, this one included.
    pub step: u64,
    /// The whole loss.
    pub loss: f32,
    /// The classes' part.
    pub class: f32,
    /// Mean distance of the corners from their rays, diameters.
    pub space_diameters: f32,
    /// Mean distance of the surface points, diameters.
    pub surface_diameters: f32,
    /// Mean distance of the rectangles' edges, sides of the projections.
    pub rectangle_sides: f32,
    /// Global gradient norm before clipping.
    pub grad_norm: f64,
    /// Its learning rate.
    pub learning_rate: f64,
}

impl Row for InitializerStep {
    const HEADER: &'static str =
        "step,loss,class,space_diameters,surface_diameters,rectangle_sides,grad_norm,learning_rate";
    const CURVES: &'static [Curve<Self>] = &[
        ("loss", "#b03020", |r| r.loss),
        ("class", "#2050a0", |r| r.class),
        ("corners, diameters", "#208040", |r| r.space_diameters),
        ("surface, diameters", "#a07010", |r| r.surface_diameters),
        ("rectangle, sides", "#707070", |r| r.rectangle_sides),
    ];

    fn step(&self) -> u64 {
        self.step
    }

    fn line(&self) -> String {
        let Self { step, loss, class, space_diameters, surface_diameters, rectangle_sides, grad_norm, learning_rate } =
            self;
        format!(
            "{step},{loss},{class},{space_diameters},{surface_diameters},{rectangle_sides},{grad_norm},{learning_rate}"
        )
    }

    fn parse(line: &str) -> Option<Self> {
        let mut parts = line.split(',');
        let report = Self {
            step: parts.next()?.parse().ok()?,
            loss: parts.next()?.parse().ok()?,
            class: parts.next()?.parse().ok()?,
            space_diameters: parts.next()?.parse().ok()?,
            surface_diameters: parts.next()?.parse().ok()?,
            rectangle_sides: parts.next()?.parse().ok()?,
            grad_norm: parts.next()?.parse().ok()?,
            learning_rate: parts.next()?.parse().ok()?,
        };
        parts.next().is_none().then_some(report)
    }
}

/// What a run left behind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InitializerSummary {
    /// Steps taken over all.
    pub step: u64,
    /// Whether all steps were taken (else it was interrupted and can be resumed).
    pub finished: bool,
    /// Mean loss over the last 200 steps.
    pub loss: f32,
    /// Mean distance of the corners from their rays over the last 200 steps, diameters.
    pub space_diameters: f32,
    /// Time of this call, seconds.
    pub seconds: f64,
    /// Time that its threads spent rendering, seconds.
    pub rendering_s: f64,
    /// The weights, when finished; else the checkpoint.
    pub written: PathBuf,
    /// The plot.
    pub plot: PathBuf,
}

type State = TrainState<DetectorConfig>;

/// Trains as configured. The weights are written when the last step is done; checkpoint, log and plot stand beside
/// them.
///
/// # Errors
/// A bad configuration, object set, device or start weights (before anything is written); a checkpoint of another run; a
/// loss that is not finite (the last checkpoint stays); a GPU that fails (a checkpoint is written); a full disk.
pub fn train_initializer(
    config: &InitializerTraining,
    progress: &mut dyn Progress,
) -> Result<InitializerSummary, PretrainError> {
    config.check()?;
    let objects = Arc::new(ObjectSet::load(&config.objects)?);
    let network = DetectorConfig::named(&config.network, objects.len())?;
    let generator = config.generator(&objects, &network)?;
    let grid = Grid::new(network.input_px[0], network.input_px[1]);
    let config = &config.with_trunk_of_its_start(&network, &objects)?;
    let (state, log) = open(config, &network, &objects)?;
    write_atomically(&config.out.with_extension("card.json"), generator.card().to_json().as_bytes())?;
    let source = Source { generator, objects, grid, config: config.clone() };
    let (start, prefetch) = (Instant::now(), Prefetch::start(&source, state.step()));
    let mut training = InitializerRun { config, state, log, prefetch };
    offline::train(&mut training, config.steps, progress)?;
    training.finish(start.elapsed().as_secs_f64())
}

/// A run in progress, with what feeds it.
struct InitializerRun<'a> {
    config: &'a InitializerTraining,
    state: State,
    log: RunLog<InitializerStep>,
    prefetch: Prefetch,
}

impl Training for InitializerRun<'_> {
    fn step(&self) -> u64 {
        self.state.step()
    }

    fn advance(&mut self) -> Result<String, PretrainError> {
        let batch = self.prefetch.next()?;
        let trunk = self.config.trunk_at(self.state.step());
        self.log.reports.push(step(&mut self.state, &batch, trunk)?);
        let values: [fn(&InitializerStep) -> f32; 4] =
            [|r| r.loss, |r| r.space_diameters, |r| r.surface_diameters, |r| r.rectangle_sides];
        let [loss, corners, surface, edges] = values.map(|value| self.log.recent(100, value));
        Ok(format!(
            "loss {loss:.3}  off by (diameters): corners {corners:.3}, surface {surface:.3}; rectangle off by {edges:.3} sides"
        ))
    }

    fn between_steps(&mut self) -> Result<(), PretrainError> {
        if self.step().is_multiple_of(self.config.checkpoint_every) { self.save() } else { Ok(()) }
    }

    fn save(&self) -> Result<(), PretrainError> {
        self.log.save()?;
        Ok(self.state.save(&self.config.checkpoint_path())?)
    }
}

impl InitializerRun<'_> {
    fn finish(&self, seconds: f64) -> Result<InitializerSummary, PretrainError> {
        let plot = self.config.out.with_extension("svg");
        self.log.save_plot(&plot)?;
        let finished = self.step() >= self.config.steps;
        if finished {
            self.state.weights.save(&self.config.out)?;
        }
        Ok(InitializerSummary {
            step: self.step(),
            finished,
            loss: self.log.recent(200, |r| r.loss),
            space_diameters: self.log.recent(200, |r| r.space_diameters),
            seconds,
            rendering_s: self.prefetch.busy_s(),
            written: if finished { self.config.out.clone() } else { self.config.checkpoint_path() },
            plot,
        })
    }
}

fn step(state: &mut State, batch: &data::Batch, trunk: Trunk) -> Result<InitializerStep, PretrainError> {
    let (stats, loss) = state.detection_step(&batch.images, &batch.truth, &LossWeights::default(), trunk)?;
    Ok(InitializerStep {
        step: stats.step,
        loss: loss.total,
        class: loss.class,
        space_diameters: loss.space_diameters,
        surface_diameters: loss.surface_diameters,
        rectangle_sides: loss.rectangle_sides,
        grad_norm: stats.grad_norm,
        learning_rate: stats.lr,
    })
}

/// A new run, or the checkpoint's.
fn open(
    config: &InitializerTraining,
    network: &DetectorConfig,
    objects: &ObjectSet,
) -> Result<(State, RunLog<InitializerStep>), PretrainError> {
    let device = OpenDevice::open(config.device)?.device;
    let (checkpoint, log_path) = (config.checkpoint_path(), config.out.with_extension("csv"));
    let description = describe(config);
    if config.resume {
        check_same_run(&config.run_path(), &description)?;
        let state = TrainState::load(&checkpoint, network.clone(), &device)?;
        let log = RunLog::resumed(log_path, state.step())?;
        return Ok((state, log));
    }
    let mut weights = start_weights(config, network, objects)?;
    weights.info.objects = objects.iter().map(|object| object.name.clone()).collect();
    weights.info.object_ids = objects.ids();
    let state = TrainState::new(network.clone(), TrainConfig::new(config.max_lr, config.steps), weights, &device)?;
    keep_description(&config.out, &config.run_path(), &description)?;
    Ok((state, RunLog::new(log_path)))
}

impl InitializerTraining {
    /// The training; without a frozen trunk when it begins with a network of the same objects, whose heads have learnt all that this
    /// trunk tells. One that is resumed keeps to what it began with: the file of its start may be gone.
    fn with_trunk_of_its_start(&self, network: &DetectorConfig, objects: &ObjectSet) -> Result<Self, PretrainError> {
        let never_frozen = match self.resume {
            true => self.begun().is_some_and(|begun| begun.frozen_trunk == 0.0),
            false => {
                let start = start_file(self, network)?.map(|path| Weights::read_info(&path)).transpose()?;
                start.is_some_and(|info| knows(&info, objects))
            }
        };
        Ok(Self { frozen_trunk: if never_frozen { 0.0 } else { self.frozen_trunk }, ..self.clone() })
    }

    /// The configuration that a run to be resumed began with; whether it is the same run is checked when it is opened.
    fn begun(&self) -> Option<Self> {
        serde_json::from_str(&std::fs::read_to_string(self.run_path()).ok()?).ok()
    }
}

/// The file that a training begins with; `None` for random weights.
fn start_file(config: &InitializerTraining, network: &DetectorConfig) -> Result<Option<PathBuf>, PretrainError> {
    Ok(match &config.warm_start {
        WarmStart::Random => None,
        WarmStart::File(path) => Some(path.clone()),
        WarmStart::Auto => Some(shipped(shipped_for(network))?),
    })
}

fn start_weights(
    config: &InitializerTraining,
    network: &DetectorConfig,
    objects: &ObjectSet,
) -> Result<Weights, PretrainError> {
    match start_file(config, network)? {
        None => Ok(Weights::random(network, config.seed)),
        Some(path) => start_from_file(&path, network, objects, config.seed),
    }
}

/// Whether weights are those of an initializer of these very objects.
fn knows(info: &WeightsInfo, objects: &ObjectSet) -> bool {
    info.object_ids == objects.ids() && info.objects.iter().eq(objects.iter().map(|object| &object.name))
}

/// The initializer that comes with this repository, for networks as wide as it.
const SHIPPED_INITIALIZER: &str = "config/weights/initializer_tabletop.safetensors";

/// The shipped weights that a network learns fastest from.
fn shipped_for(network: &DetectorConfig) -> &'static str {
    let nano = DetectorConfig::nano(network.objects);
    let as_wide = (network.widths, network.pyramid) == (nano.widths, nano.pyramid);
    if as_wide { SHIPPED_INITIALIZER } else { SHIPPED_WEIGHTS }
}

/// Weights of an initializer, which may know other objects, or of a flow network of RAFT-small's shape, whose feature encoder
/// is taken.
fn start_from_file(
    path: &Path,
    network: &DetectorConfig,
    objects: &ObjectSet,
    seed: u64,
) -> Result<Weights, PretrainError> {
    let info = Weights::read_info(path)?;
    if info.object_ids.is_empty() {
        let raft = Weights::load(path, &NetworkConfig::small())?;
        return Ok(Weights::detector_from_raft(network, &raft, seed)?);
    }
    let known = Weights::load(path, &DetectorConfig { objects: info.object_ids.len(), ..network.clone() })?;
    Ok(if knows(&info, objects) { known } else { Weights::detector_from_known(network, &known)? })
}

/// What decides the weights: the configuration without what may change on resuming.
fn describe(config: &InitializerTraining) -> String {
    let device = ComputeDevice::default();
    let fixed = InitializerTraining { resume: false, device, data_threads: 1, checkpoint_every: 1, ..config.clone() };
    serde_json::to_string_pretty(&fixed).unwrap_or_default()
}
