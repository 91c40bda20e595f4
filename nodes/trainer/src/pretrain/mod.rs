//! Pre-training on synthetic pairs: AdamW with a one-cycle rate on the sequence loss over visible foreground.
//!
//! A run is a function of its [`PretrainConfig`]: neither threads nor interruptions change the weights.

mod config;
mod data;
mod log;
mod networks;
mod progress;
mod run;
mod validation;

#[cfg(test)]
mod tests;

pub(crate) use config::shipped;
pub use config::{Course, PretrainConfig, SHIPPED_REFINER, SHIPPED_WEIGHTS, SizeShare, WarmStart};
pub use progress::{Progress, Silent, TerminalProgress};

use crate::TrainerError;
use crate::synth::{ObjectPool, SampleGenerator};
use data::Prefetch;
pub(crate) use data::push_planes;
pub(crate) use log::write_atomically;
pub(crate) use log::{Curve, Row, RunLog};
use networks::PairNetwork;
use pseudoflow_network::{ComputeDevice, FlowNetwork, NetworkError};
use run::Run;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use validation::Validation;

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
    match config.resolve_network()? {
        FlowNetwork::Raft(network) => train(config, network, progress),
        FlowNetwork::Refiner(network) => train(config, network, progress),
    }
}

fn train<M: PairNetwork>(
    config: &PretrainConfig,
    network: M,
    progress: &mut dyn Progress,
) -> Result<PretrainSummary, TrainerError> {
    let pool = ObjectPool::load(&config.objects)?;
    let pool = if config.only_shippable { pool.only_shippable()? } else { pool };
    let (pool, held_out) = match config.hold_out {
        0 => (pool, None),
        every => pool.hold_out(every),
    };
    let generator = SampleGenerator::new(Arc::new(pool), config.synth.clone(), config.seed)?;
    let generator = generator.with_backgrounds(&config.backgrounds, config.only_shippable)?;
    let mut validation = Validation::new(config, &generator, held_out, network.size_px(), M::TAKES_GEOMETRY)?;
    let mut run = Run::open(config, network, generator.objects())?;
    write_atomically(&config.out.with_extension("card.json"), generator.card().to_json().as_bytes())?;
    let first = run.state.step();
    validation.resume(config, first)?;
    progress.start(first, config.steps);
    let (start, size_px) = (Instant::now(), run.state.network.size_px());
    let prefetch = Prefetch::start(&generator, config, size_px, M::TAKES_GEOMETRY, first)?;
    let mut pairs = 0;
    while run.state.step() < config.steps && !progress.should_stop() {
        let batch = prefetch.next(run.state.step() - first)?;
        pairs += batch.pairs();
        let step = run.step(&batch);
        step.inspect_err(|e| keep(e, || run.save(config, &validation)))?;
        let (loss_px, epe_px) = recent(&run.log, 100);
        let seen = validation.last_text();
        progress.step(run.state.step(), &format!("loss {loss_px:.3} px  EPE {epe_px:.3} px{seen}"));
        run.between_steps(config, &mut validation)?;
    }
    run.save(config, &validation)?;
    let seconds = start.elapsed().as_secs_f64();
    run.finish(config, seconds, pairs as f64 / seconds.max(1e-9), prefetch.made_per_s())
}

/// What decides the weights: the configuration without what may change on resuming.
fn describe(config: &PretrainConfig) -> String {
    let device = ComputeDevice::default();
    let mut fixed = PretrainConfig { resume: false, device, data_threads: 1, checkpoint_every: 1, ..config.clone() };
    fixed.validate_every = 1;
    if config.on_plateau() {
        // How long it lasts and how it ends may be decided at any time.
        (fixed.steps, fixed.schedule) = (1, None);
    }
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
