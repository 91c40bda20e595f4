//! Pre-training on synthetic pairs: AdamW with a one-cycle rate on the sequence loss over visible foreground.
//!
//! A run is a function of its [`PretrainConfig`]: neither threads nor interruptions change the weights.

mod config;
mod data;
mod networks;
mod pose_loss;
mod run;
mod validation;

#[cfg(test)]
mod tests;

pub(crate) use config::shipped;
pub use config::{Course, PretrainConfig, SHIPPED_REFINER, SHIPPED_WEIGHTS, SizeShare, WarmStart};

use crate::PretrainError;
use crate::offline::{self, Curve, Progress, Row, RunLog, Training};
use data::Prefetch;
pub(crate) use data::push_planes;
use networks::PairNetwork;
use pseudoflow_network::storage::write_atomically;
use pseudoflow_network::{ComputeDevice, FlowNetwork};
use pseudoflow_synthetic::{ObjectPool, SampleGenerator};
use run::Run;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
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
pub fn pretrain(config: &PretrainConfig, progress: &mut dyn Progress) -> Result<PretrainSummary, PretrainError> {
    config.check()?;
    match config.resolve_network()? {
        FlowNetwork::Raft(_) if config.pose_weight > 0.0 => Err(PretrainError::Config {
            field: "pose_weight".to_owned(),
            wanted: "0 for RAFT: only the refiner learns from poses",
        }),
        FlowNetwork::Raft(network) => train(config, network, progress),
        FlowNetwork::Refiner(network) => train(config, network, progress),
    }
}

fn train<M: PairNetwork>(
    config: &PretrainConfig,
    network: M,
    progress: &mut dyn Progress,
) -> Result<PretrainSummary, PretrainError> {
    let pool = ObjectPool::load(&config.objects)?;
    let pool = if config.only_shippable { pool.only_shippable()? } else { pool };
    let (pool, held_out) = match config.hold_out {
        0 => (pool, None),
        every => pool.hold_out(every),
    };
    let generator = SampleGenerator::new(Arc::new(pool), config.synth.clone(), config.seed)?;
    let generator = generator.with_backgrounds(&config.backgrounds, config.only_shippable)?;
    let mut validation = Validation::new(config, &generator, held_out, network.size_px(), M::TAKES_GEOMETRY)?;
    let run = Run::open(config, network, generator.objects())?;
    write_atomically(&config.out.with_extension("card.json"), generator.card().to_json().as_bytes())?;
    let (first, size_px) = (run.state.step(), run.state.network.size_px());
    validation.resume(config, first)?;
    let start = Instant::now();
    let prefetch = Prefetch::start(&generator, config, size_px, M::TAKES_GEOMETRY, first)?;
    let mut training = Pretraining { config, run, validation, prefetch, first, pairs: 0 };
    offline::train(&mut training, config.steps, progress)?;
    let (seconds, pairs) = (start.elapsed().as_secs_f64(), training.pairs as f64);
    training.run.finish(config, seconds, pairs / seconds.max(1e-9), training.prefetch.made_per_s())
}

/// A run with what feeds and measures it.
struct Pretraining<'a, M> {
    config: &'a PretrainConfig,
    run: Run<M>,
    validation: Validation,
    prefetch: Prefetch,
    /// Steps that an earlier part of the run took.
    first: u64,
    /// Pairs of this part.
    pairs: usize,
}

impl<M: PairNetwork> Training for Pretraining<'_, M> {
    fn step(&self) -> u64 {
        self.run.state.step()
    }

    fn advance(&mut self) -> Result<String, PretrainError> {
        let batch = self.prefetch.next(self.step() - self.first)?;
        self.pairs += batch.pairs();
        self.run.step(&batch)?;
        let (loss_px, epe_px) = recent(&self.run.log, 100);
        Ok(format!("loss {loss_px:.3} px  EPE {epe_px:.3} px{}", self.validation.last_text()))
    }

    fn between_steps(&mut self) -> Result<(), PretrainError> {
        self.run.between_steps(self.config, &mut self.validation)
    }

    fn save(&self) -> Result<(), PretrainError> {
        self.run.save(self.config, &self.validation)
    }
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

impl PretrainConfig {
    /// Where the run's configuration is kept, to be compared on resuming.
    #[must_use]
    pub fn run_path(&self) -> PathBuf {
        self.out.with_extension("run.json")
    }
}
