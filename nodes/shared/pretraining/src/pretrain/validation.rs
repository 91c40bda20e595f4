//! How well a network does on renderings of objects that it never saw in training: the learning curve of a run.

use super::PretrainConfig;
use super::data::{Batch, Schedule};
use super::networks::PairNetwork;
use crate::PretrainError;
use crate::offline::{Curve, Row, RunLog};
use pseudoflow_network::Weights;
use pseudoflow_synthetic::{ObjectPool, Sample, SampleGenerator};
use std::sync::Arc;

/// Pairs that are measured at each crop size, in batches of [`BATCH`]; the same at every time and for every seed.
const PAIRS: usize = 96;
const BATCH: usize = 8;
const SEED: u64 = 0x005e_ed0f_7e57;

/// One measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measured {
    step: u64,
    /// Pairs seen in training until then.
    pairs: u64,
    /// Mean end point error at the network's crop size, pixels.
    epe_px: f32,
    /// The same at the largest crop size of the training, pixels of those crops.
    epe_largest_px: f32,
}

impl Row for Measured {
    const HEADER: &'static str = "step,pairs,epe_px,epe_largest_px";
    const CURVES: &'static [Curve<Self>] = &[
        ("end point error on unseen objects, px", "#2050a0", |r| r.epe_px),
        ("the same at the largest crops, px", "#b03020", |r| r.epe_largest_px),
    ];

    fn step(&self) -> u64 {
        self.step
    }

    fn line(&self) -> String {
        format!("{},{},{},{}", self.step, self.pairs, self.epe_px, self.epe_largest_px)
    }

    fn parse(line: &str) -> Option<Self> {
        let parts: Vec<&str> = line.split(',').collect();
        let [step, pairs, own, largest] = parts.as_slice() else { return None };
        let (step, pairs) = (step.parse().ok()?, pairs.parse().ok()?);
        Some(Self { step, pairs, epe_px: own.parse().ok()?, epe_largest_px: largest.parse().ok()? })
    }
}

/// The pairs to measure on, and what was measured.
pub(super) struct Validation {
    /// At the network's crop size, and at the largest of the training.
    batches: [Vec<Batch>; 2],
    log: RunLog<Measured>,
    schedule: Schedule,
}

impl Validation {
    /// Renders the pairs, if objects were kept out.
    pub(super) fn new(
        config: &PretrainConfig,
        training: &SampleGenerator,
        held_out: Option<ObjectPool>,
        size_px: usize,
        geometry: bool,
    ) -> Result<Self, PretrainError> {
        let generator = held_out.map(|pool| training.of_other_objects(Arc::new(pool), SEED));
        let batches = |size_px: usize| -> Result<Vec<Batch>, PretrainError> {
            let Some(generator) = &generator else { return Ok(vec![]) };
            let samples = generator.batch(0, PAIRS, size_px as u32)?;
            let batch = |samples: &[Sample]| Batch::new(size_px, &samples.iter().collect::<Vec<_>>(), 0.0, geometry);
            Ok(samples.chunks(BATCH).map(batch).collect())
        };
        let largest_px = config.size_shares()?.iter().map(|share| share.size_px).max().unwrap_or(size_px);
        let log = RunLog::new(config.out.with_extension("validation.csv"));
        let batches = [batches(size_px)?, batches(largest_px)?];
        Ok(Self { batches, log, schedule: Schedule::new(config, size_px)? })
    }

    /// Takes up the log of a run that goes on after `step`.
    pub(super) fn resume(&mut self, config: &PretrainConfig, step: u64) -> Result<(), PretrainError> {
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
    ) -> Result<(), PretrainError> {
        if self.batches[0].is_empty() {
            return Ok(());
        }
        let mean = |batches: &[Batch]| -> Result<f32, PretrainError> {
            let errors = batches.iter().map(|batch| network.error_px(weights, batch));
            Ok(errors.sum::<Result<f32, _>>()? / batches.len() as f32)
        };
        let (epe_px, epe_largest_px) = (mean(&self.batches[0])?, mean(&self.batches[1])?);
        let [own, largest] = [0, 1].map(|i| self.batches[i][0].size_px);
        ::log::info!(
            "step {step}: end point error on unseen objects {epe_px:.3} px at {own} px, {epe_largest_px:.3} px at {largest} px"
        );
        self.log.reports.push(Measured { step, pairs: self.schedule.pairs_until(step), epe_px, epe_largest_px });
        Ok(())
    }

    /// The last measurement, for a progress bar.
    pub(super) fn last_text(&self) -> String {
        self.log
            .reports
            .last()
            .map_or_else(String::new, |m| format!("  unseen objects {:.3}, {:.3} px", m.epe_px, m.epe_largest_px))
    }

    /// Writes log and plot, if there is something.
    pub(super) fn save(&self) -> Result<(), PretrainError> {
        if self.log.reports.is_empty() {
            return Ok(());
        }
        self.log.save()?;
        self.log.save_plot(&self.log.path().with_extension("svg"))
    }
}
