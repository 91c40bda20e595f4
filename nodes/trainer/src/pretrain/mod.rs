//! Pre-training on synthetic pairs: AdamW with a one-cycle rate on the sequence loss over visible foreground.
//!
//! A run is a function of its [`PretrainConfig`]: neither threads nor interruptions change the weights.

mod config;
mod data;
mod log;
mod progress;

#[cfg(test)]
mod tests;

pub use config::{PretrainConfig, SHIPPED_WEIGHTS, SizeShare, WarmStart};
pub(crate) use config::{network_named, shipped};
pub use progress::{Progress, Silent, TerminalProgress};

use crate::TrainerError;
use crate::synth::SampleGenerator;
use data::Prefetch;
pub(crate) use data::push_planes;
pub(crate) use log::write_atomically;
pub(crate) use log::{Curve, Row, RunLog};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_network::{ComputeDevice, NetworkConfig, NetworkError, TrainConfig, TrainState, Weights};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// One step of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// Steps taken, this one included.
    pub step: u64,
    /// Side of its crops, pixels.
    pub size_px: usize,
    /// Its loss, pixels.
    pub loss_px: f32,
    /// Mean end point error of the last iteration on visible foreground, pixels of its crops.
    pub epe_px: f32,
    /// Global gradient norm before clipping.
    pub grad_norm: f64,
    /// Its learning rate.
    pub learning_rate: f64,
}

impl Row for StepReport {
    const HEADER: &'static str = "step,size_px,loss_px,epe_px,grad_norm,learning_rate";
    const CURVES: &'static [Curve<Self>] =
        &[("loss, px", "#b03020", |r| r.loss_px), ("end point error, px", "#2050a0", |r| r.epe_px)];

    fn step(&self) -> u64 {
        self.step
    }

    fn line(&self) -> String {
        let Self { step, size_px, loss_px, epe_px, grad_norm, learning_rate } = self;
        format!("{step},{size_px},{loss_px},{epe_px},{grad_norm},{learning_rate}")
    }

    fn parse(line: &str) -> Option<Self> {
        let mut parts = line.split(',');
        let report = Self {
            step: parts.next()?.parse().ok()?,
            size_px: parts.next()?.parse().ok()?,
            loss_px: parts.next()?.parse().ok()?,
            epe_px: parts.next()?.parse().ok()?,
            grad_norm: parts.next()?.parse().ok()?,
            learning_rate: parts.next()?.parse().ok()?,
        };
        parts.next().is_none().then_some(report)
    }
}

/// Mean loss and end point error over the last `count` steps, pixels.
fn recent(log: &RunLog<StepReport>, count: usize) -> (f32, f32) {
    (log.recent(count, |r| r.loss_px), log.recent(count, |r| r.epe_px))
}

/// What a run left behind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PretrainSummary {
    /// Steps taken over all.
    pub step: u64,
    /// Whether all steps were taken (else it was interrupted and can be resumed).
    pub finished: bool,
    /// Mean loss over the last 200 steps, pixels.
    pub loss_px: f32,
    /// Mean end point error over the last 200 steps, pixels.
    pub epe_px: f32,
    /// Time of this call, seconds.
    pub seconds: f64,
    /// Pairs trained per second.
    pub trained_per_s: f64,
    /// Pairs that one data thread makes per second (of its own time).
    pub made_per_s: f64,
    /// The weights, when finished; else the checkpoint.
    pub written: PathBuf,
    /// The plot.
    pub plot: PathBuf,
}

/// Trains as configured. The weights are written when the last step is done; checkpoint, log and plot stand beside
/// them.
///
/// # Errors
/// A bad configuration, object set, device or start weights (before anything is written); a checkpoint of another run; a
/// loss that is not finite (the last checkpoint stays); a GPU that fails (a checkpoint is written); a full disk.
pub fn pretrain(config: &PretrainConfig, progress: &mut dyn Progress) -> Result<PretrainSummary, TrainerError> {
    config.check()?;
    let network = config.resolve_network()?;
    let objects = Arc::new(ObjectSet::load(&config.objects)?);
    let generator = SampleGenerator::new(Arc::clone(&objects), config.synth.clone(), config.seed)?;
    let (mut state, mut log) = open(config, &network, &objects)?;
    let first = state.step();
    progress.start(first, config.steps);
    let (start, prefetch) = (Instant::now(), Prefetch::start(&generator, config, network.size_px, first));
    let mut pairs = 0;
    while state.step() < config.steps && !progress.should_stop() {
        let batch = prefetch.next(state.step() - first)?;
        pairs += batch.pairs();
        let report = step(&mut state, &batch, network.size_px);
        log.reports.push(report.inspect_err(|e| keep(e, || save_checkpoint(config, &state, &log)))?);
        let (loss_px, epe_px) = recent(&log, 100);
        progress.step(state.step(), &format!("loss {loss_px:.3} px  EPE {epe_px:.3} px"));
        if state.step().is_multiple_of(config.checkpoint_every) {
            save_checkpoint(config, &state, &log)?;
        }
    }
    save_checkpoint(config, &state, &log)?;
    let seconds = start.elapsed().as_secs_f64();
    let made_per_s = pairs as f64 / prefetch.busy_s().max(1e-9);
    finish(config, &state, &log, seconds, pairs as f64 / seconds.max(1e-9), made_per_s)
}

fn step(state: &mut TrainState, batch: &data::Batch, network_size_px: usize) -> Result<StepReport, TrainerError> {
    // The weights fit any size; the checkpoint belongs to the network's own.
    state.network.size_px = batch.size_px;
    let stats = state.train_step(&batch.view());
    state.network.size_px = network_size_px;
    let stats = stats?;
    Ok(StepReport {
        step: stats.step,
        size_px: batch.size_px,
        loss_px: stats.loss,
        epe_px: stats.epe,
        grad_norm: stats.grad_norm,
        learning_rate: stats.lr,
    })
}

/// A new run, or the checkpoint's.
fn open(
    config: &PretrainConfig,
    network: &NetworkConfig,
    objects: &ObjectSet,
) -> Result<(TrainState, RunLog<StepReport>), TrainerError> {
    let device = config.device.open()?.device;
    let (checkpoint, log_path) = (config.checkpoint_path(), config.out.with_extension("csv"));
    let description = describe(config);
    if config.resume {
        check_same_run(&config.run_path(), &description)?;
        let state = TrainState::load(&checkpoint, network.clone(), &device)?;
        let log = RunLog::resumed(log_path, state.step())?;
        return Ok((state, log));
    }
    let mut weights = match config.start_weights(network)? {
        Some(path) => {
            ::log::info!("starting from {}", path.display());
            Weights::load(&path, network)?
        }
        None => {
            ::log::info!("starting from random weights, seed {}", config.seed);
            Weights::random(network, config.seed)
        }
    };
    weights.info.objects = objects.iter().map(|object| object.name.clone()).collect();
    let state = TrainState::new(network.clone(), TrainConfig::new(config.max_lr, config.steps), weights, &device)?;
    if let Some(folder) = config.out.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(TrainerError::io(folder))?;
    }
    write_atomically(&config.run_path(), description.as_bytes())?;
    Ok((state, RunLog::new(log_path)))
}

/// What decides the weights: the configuration without what may change on resuming.
fn describe(config: &PretrainConfig) -> String {
    let device = ComputeDevice::default();
    let fixed = PretrainConfig { resume: false, device, data_threads: 1, checkpoint_every: 1, ..config.clone() };
    serde_json::to_string_pretty(&fixed).unwrap_or_default()
}

/// When a GPU fails, the steps before are whole: they go to the checkpoint, whatever its interval.
pub(crate) fn keep(error: &TrainerError, save: impl FnOnce() -> Result<(), TrainerError>) {
    if let TrainerError::Network(NetworkError::DeviceFailed { .. }) = error {
        match save() {
            Ok(()) => ::log::error!("the device failed; all steps before are in the checkpoint (`--resume`)"),
            Err(error) => ::log::error!("the device failed, and the checkpoint could not be written: {error}"),
        }
    }
}

/// Refuses to resume with another configuration than the kept one.
pub(crate) fn check_same_run(path: &Path, description: &str) -> Result<(), TrainerError> {
    let found = std::fs::read_to_string(path).map_err(TrainerError::io(path))?;
    let differs = found.lines().zip(description.lines()).find(|(a, b)| a != b);
    match differs {
        Some((there, here)) => Err(TrainerError::OtherRun {
            path: path.to_owned(),
            there: there.trim().to_owned(),
            here: here.trim().to_owned(),
        }),
        None => Ok(()),
    }
}

impl PretrainConfig {
    /// Where the run's configuration is kept, to be compared on resuming.
    #[must_use]
    pub fn run_path(&self) -> PathBuf {
        self.out.with_extension("run.json")
    }
}

/// The log first: a checkpoint never lacks lines of its log.
fn save_checkpoint(config: &PretrainConfig, state: &TrainState, log: &RunLog<StepReport>) -> Result<(), TrainerError> {
    log.save()?;
    Ok(state.save(&config.checkpoint_path())?)
}

fn finish(
    config: &PretrainConfig,
    state: &TrainState,
    log: &RunLog<StepReport>,
    seconds: f64,
    trained_per_s: f64,
    made_per_s: f64,
) -> Result<PretrainSummary, TrainerError> {
    let plot = config.out.with_extension("svg");
    log.save_plot(&plot)?;
    let finished = state.step() >= config.steps;
    if finished {
        state.weights.save(&config.out)?;
    }
    let (loss_px, epe_px) = recent(log, 200);
    let written = if finished { config.out.clone() } else { config.checkpoint_path() };
    Ok(PretrainSummary {
        step: state.step(),
        finished,
        loss_px,
        epe_px,
        seconds,
        trained_per_s,
        made_per_s,
        written,
        plot,
    })
}
