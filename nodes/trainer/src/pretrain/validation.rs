//! How well a network does on renderings of objects that it never saw in training: the learning curve of a run.

use super::data::Batch;
use super::networks::PairNetwork;
use super::{Curve, PretrainConfig, Row, RunLog};
use crate::TrainerError;
use crate::synth::{ObjectPool, Sample, SampleGenerator};
use pseudoflow_network::Weights;
use std::sync::Arc;

/// Pairs that are measured, in batches of [`BATCH`]; the same at every time and for every seed.
const PAIRS: usize = 96;
const BATCH: usize = 8;
const SEED: u64 = 0x005e_ed0f_7e57;

/// One measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measured {
    step: u64,
    /// Pairs seen in training until then.
    pairs: u64,
    /// Mean end point error, pixels.
    epe_px: f32,
}

impl Row for Measured {
    const HEADER: &'static str = "step,pairs,epe_px";
    const CURVES: &'static [Curve<Self>] = &[("end point error on unseen objects, px", "#2050a0", |r| r.epe_px)];

    fn step(&self) -> u64 {
        self.step
    }

    fn line(&self) -> String {
        format!("{},{},{}", self.step, self.pairs, self.epe_px)
    }

    fn parse(line: &str) -> Option<Self> {
        let parts: Vec<&str> = line.split(',').collect();
        let [step, pairs, epe_px] = parts.as_slice() else { return None };
        Some(Self { step: step.parse().ok()?, pairs: pairs.parse().ok()?, epe_px: epe_px.parse().ok()? })
    }
}

/// The pairs to measure on, and what was measured.
pub(super) struct Validation {
    batches: Vec<Batch>,
    log: RunLog<Measured>,
    pairs_per_step: u64,
}

impl Validation {
    /// Renders the pairs, if objects were kept out.
    pub(super) fn new(
        config: &PretrainConfig,
        training: &SampleGenerator,
        held_out: Option<ObjectPool>,
        size_px: usize,
        geometry: bool,
    ) -> Result<Self, TrainerError> {
        let samples = match held_out {
            Some(pool) => {
                let generator = training.of_other_objects(Arc::new(pool), SEED);
                generator.batch(0, PAIRS, size_px as u32)?
            }
            None => vec![],
        };
        let batch = |samples: &[Sample]| Batch::new(size_px, &samples.iter().collect::<Vec<_>>(), 0.0, geometry);
        let batches = samples.chunks(BATCH).map(batch).collect();
        let log = RunLog::new(config.out.with_extension("validation.csv"));
        Ok(Self { batches, log, pairs_per_step: config.batch as u64 })
    }

    /// Takes up the log of a run that goes on after `step`.
    pub(super) fn resume(&mut self, config: &PretrainConfig, step: u64) -> Result<(), TrainerError> {
        let path = config.out.with_extension("validation.csv");
        if config.resume && path.is_file() {
            self.log = RunLog::resumed(path, step)?;
        }
        Ok(())
    }

    /// Measures weights after a step.
    pub(super) fn measure<M: PairNetwork>(
        &mut self,
        network: &M,
        weights: &Weights,
        step: u64,
    ) -> Result<(), TrainerError> {
        if self.batches.is_empty() {
            return Ok(());
        }
        let errors = self.batches.iter().map(|batch| network.error_px(weights, batch));
        let sum = errors.sum::<Result<f32, _>>()?;
        let epe_px = sum / self.batches.len() as f32;
        ::log::info!("step {step}: end point error on unseen objects {epe_px:.3} px");
        self.log.reports.push(Measured { step, pairs: step * self.pairs_per_step, epe_px });
        Ok(())
    }

    /// The last measurement, for a progress bar.
    pub(super) fn last_text(&self) -> String {
        self.log.reports.last().map_or_else(String::new, |m| format!("  unseen objects {:.3} px", m.epe_px))
    }

    /// Writes log and plot, if there is something.
    pub(super) fn save(&self) -> Result<(), TrainerError> {
        if self.log.reports.is_empty() {
            return Ok(());
        }
        self.log.save()?;
        self.log.save_plot(&self.log.path().with_extension("svg"))
    }
}
