//! A run in progress: state, log, moving average, and what is written.

use super::data::Batch;
use super::networks::PairNetwork;
use super::validation::Validation;
use super::{Course, PretrainConfig, PretrainSummary, StepReport, describe, recent};
use crate::PretrainError;
use crate::offline::{RunLog, check_same_run, keep_description};
use pseudoflow_learning::{OpenDevice, TrainState};
use pseudoflow_network::{FlowNetwork, Weights};
use pseudoflow_synthetic::ObjectPool;
use std::path::PathBuf;

/// Name of the moving average in a checkpoint.
const AVERAGE: &str = "average";

/// A run in progress.
pub(super) struct Run<M> {
    pub(super) state: TrainState<M>,
    pub(super) log: RunLog<StepReport>,
    /// The moving average of the weights, and its memory in steps.
    average: Option<(Weights, u64)>,
}

impl<M: PairNetwork> Run<M> {
    /// A new run, or the checkpoint's.
    pub(super) fn open(config: &PretrainConfig, network: M, objects: &ObjectPool) -> Result<Self, PretrainError> {
        if config.resume { Self::resume(config, network) } else { Self::begin(config, network, objects) }
    }

    fn begin(config: &PretrainConfig, network: M, objects: &ObjectPool) -> Result<Self, PretrainError> {
        let mut weights = match config.start_weights(&config.resolve_network()?)? {
            Some(path) => {
                ::log::info!("starting from {}", path.display());
                Weights::load(&path, &network)?
            }
            None => {
                ::log::info!("starting from random weights, seed {}", config.seed);
                Weights::random(&network, config.seed)
            }
        };
        weights.info.objects = objects.names().to_vec();
        let average = Some((weights.clone(), config.averaged_steps())).filter(|(_, steps)| *steps > 0);
        let state = TrainState::new(network, config.train_config(), weights, &OpenDevice::open(config.device)?.device)?;
        keep_description(&config.out, &config.run_path(), &describe(config))?;
        Ok(Self { state, log: RunLog::new(config.out.with_extension("csv")), average })
    }

    fn resume(config: &PretrainConfig, network: M) -> Result<Self, PretrainError> {
        check_same_run(&config.run_path(), &describe(config))?;
        let path = config.resumed_checkpoint()?;
        ::log::info!("going on from {}", path.display());
        let names: &[&str] = if config.averaged_steps() > 0 { &[AVERAGE] } else { &[] };
        let (mut state, averages) =
            TrainState::load_with(&path, network, &OpenDevice::open(config.device)?.device, names)?;
        state.config = config.train_config();
        let log = RunLog::resumed(config.out.with_extension("csv"), state.step())?;
        let average = averages.into_iter().next().map(|weights| (weights, config.averaged_steps()));
        Ok(Self { state, log, average })
    }

    /// One step, with its line in the log.
    pub(super) fn step(&mut self, batch: &Batch) -> Result<(), PretrainError> {
        let stats = M::train(&mut self.state, batch)?;
        if let Some((average, steps)) = &mut self.average {
            // Young averages forget faster: else the first weights would weigh for long.
            let memory = (stats.step as f32 / 10.0).clamp(1.0, *steps as f32);
            average.average_with(&self.state.weights, 1.0 - 1.0 / memory);
            average.info.step = stats.step;
        }
        self.log.reports.push(StepReport {
            step: stats.step,
            size_px: batch.size_px,
            loss_px: stats.loss,
            epe_px: stats.epe,
            grad_norm: stats.grad_norm,
            learning_rate: stats.lr,
        });
        Ok(())
    }

    /// The weights that the run is about.
    fn best(&self) -> &Weights {
        self.average.as_ref().map_or(&self.state.weights, |(average, _)| average)
    }

    /// Measures, saves and marks the beginning of a cool-down, each at its steps.
    pub(super) fn between_steps(
        &mut self,
        config: &PretrainConfig,
        validation: &mut Validation,
    ) -> Result<(), PretrainError> {
        let step = self.state.step();
        if step.is_multiple_of(config.validate_every) {
            validation.measure(&self.state.network, self.best(), step)?;
        }
        if config.cool_down_from() == Some(step) {
            self.save_state(&config.plateau_path())?;
        }
        if step.is_multiple_of(config.checkpoint_every) {
            self.save(config, validation)?;
        }
        Ok(())
    }

    fn save_state(&self, path: &std::path::Path) -> Result<(), PretrainError> {
        let others: Vec<(&str, &Weights)> = self.average.iter().map(|(average, _)| (AVERAGE, average)).collect();
        Ok(self.state.save_with(path, &others)?)
    }

    /// The logs first: a checkpoint never lacks lines of its log. On a plateau the average is written as well: it is of use at
    /// any time.
    pub(super) fn save(&self, config: &PretrainConfig, validation: &Validation) -> Result<(), PretrainError> {
        self.log.save()?;
        validation.save()?;
        self.save_state(&config.checkpoint_path())?;
        if config.on_plateau() && self.state.step() > 0 {
            self.best().save(&config.out)?;
        }
        Ok(())
    }

    pub(super) fn finish(
        &self,
        config: &PretrainConfig,
        seconds: f64,
        trained_per_s: f64,
        made_per_s: f64,
    ) -> Result<PretrainSummary, PretrainError> {
        let plot = config.out.with_extension("svg");
        self.log.save_plot(&plot)?;
        let finished = self.state.step() >= config.steps;
        if finished {
            self.best().save(&config.out)?;
        }
        let (loss_px, epe_px) = recent(&self.log, 200);
        let written = if finished { config.out.clone() } else { config.checkpoint_path() };
        let step = self.state.step();
        Ok(PretrainSummary { step, finished, loss_px, epe_px, seconds, trained_per_s, made_per_s, written, plot })
    }
}

impl PretrainConfig {
    /// Whether the run may go on beyond its steps.
    pub(super) fn on_plateau(&self) -> bool {
        matches!(self.course(), Course::Plateau { .. })
    }

    /// The step at which the cool-down begins, if there is one.
    fn cool_down_from(&self) -> Option<u64> {
        match self.course() {
            Course::Plateau { cool_down, .. } if cool_down > 0 => Some(self.steps.saturating_sub(cool_down)),
            _ => None,
        }
    }

    /// The checkpoint that a resumed run starts from: that before a cool-down, when the run is to go on after it.
    fn resumed_checkpoint(&self) -> Result<PathBuf, PretrainError> {
        let (last, plateau) = (self.checkpoint_path(), self.plateau_path());
        if !self.on_plateau() || !plateau.is_file() {
            return Ok(last);
        }
        let (last_step, plateau_step) = (Weights::read_info(&last)?.step, Weights::read_info(&plateau)?.step);
        let cooling = self.cool_down_from() == Some(plateau_step) && last_step < self.steps;
        Ok(if plateau_step < last_step && !cooling { plateau } else { last })
    }
}

impl PretrainConfig {
    /// The course of the learning rate.
    pub(super) fn course(&self) -> Course {
        let refiner = FlowNetwork::named(&self.network).is_ok_and(|network| network.is_refiner());
        let default = if refiner { Course::Plateau { warm_up: 500, cool_down: 0 } } else { Course::OneCycle };
        self.schedule.unwrap_or(default)
    }
}
