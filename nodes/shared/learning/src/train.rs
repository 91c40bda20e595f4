//! A training run: weights, optimiser and step, saved whole so that a resumed run has the bits of an unbroken one.

use crate::guard::guarded_on;
use crate::loss::{FlowBatch, device_end_point_error, end_point_error, sequence_loss, values};
use crate::memory::keep_freed;
use crate::model::{ByName, Trainable, gradients_with};
use crate::optim::{AdamWConfig, Moments, OneCycle, Schedule, adamw, clip_scale, global_norm};
use crate::raft::Raft;
use burn::tensor::{Device, Tensor};
use pseudoflow_network::NetworkConfig;
use pseudoflow_network::storage::{parse_with, serialize_with, write_atomically};
use pseudoflow_network::{NamedTensor, Weights};
use pseudoflow_network::{NetworkError, Result, io_error};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How to train.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Learning rate over the run.
    pub schedule: Schedule,
    /// Optimiser constants.
    pub adamw: AdamWConfig,
    /// Largest global gradient norm.
    pub clip_norm: f64,
    /// Weight of an iteration relative to the next.
    pub gamma: f32,
}

impl TrainConfig {
    /// The paper's constants for a run of `total_steps` with peak rate `max_lr`.
    pub fn new(max_lr: f64, total_steps: u64) -> Self {
        Self::scheduled(Schedule::OneCycle(OneCycle::new(max_lr, total_steps)))
    }

    /// The paper's constants with another schedule.
    pub fn scheduled(schedule: Schedule) -> Self {
        Self { schedule, adamw: AdamWConfig::default(), clip_norm: 1.0, gamma: 0.8 }
    }
}

/// What one step did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepStats {
    /// Steps taken, this one included.
    pub step: u64,
    /// Loss before the step, px.
    pub loss: f32,
    /// Mean end point error of the last iteration, px; NaN if the loss has none.
    pub epe: f32,
    /// Global gradient norm before clipping.
    pub grad_norm: f64,
    /// Learning rate of the step.
    pub lr: f64,
}

/// A training run in progress.
#[derive(Debug)]
pub struct TrainState<M = NetworkConfig> {
    /// The network.
    pub network: M,
    /// How it is trained.
    pub config: TrainConfig,
    /// The weights; `weights.info.step` counts the steps.
    pub weights: Weights,
    moments: Vec<Moments>,
    device: Device,
}

/// What a step learns from the device.
struct Slope {
    loss: f32,
    /// Gradients, row-major.
    by_name: ByName,
    measured: Vec<f32>,
}

impl<M: Trainable> TrainState<M> {
    /// Starts a run from weights, at step 0. `device` is a plain device such as `Device::flex()`.
    ///
    /// # Errors
    /// The weights belong to another architecture, or the configuration is out of range.
    pub fn new(network: M, config: TrainConfig, mut weights: Weights, device: &Device) -> Result<Self> {
        keep_freed();
        network.check()?;
        network.build(&weights, device)?;
        weights.info.network = network.name().to_owned();
        weights.info.config_hash = network.hash();
        weights.info.step = 0;
        let moments = weights.tensors().iter().map(|t| Moments::zeros(t.data.len())).collect();
        Ok(Self { network, config, weights, moments, device: device.clone() })
    }

    /// The plain device it trains on.
    pub(crate) fn device(&self) -> Device {
        self.device.clone()
    }

    /// Steps taken.
    pub fn step(&self) -> u64 {
        self.weights.info.step
    }

    /// One step on any loss of shape (1), given the network on the device with autodiff.
    ///
    /// # Errors
    /// Loss or gradient are not finite, or a GPU failed: the weights then stay as they were.
    pub fn step_with(&mut self, loss: impl FnOnce(&M::Network) -> Tensor<1>) -> Result<StepStats> {
        Ok(self.step_measuring(|network| (loss(network), vec![]))?.0)
    }

    /// As [`Self::step_with`], with further numbers of shape (1), which are read with the gradients: a GPU is waited for
    /// once a step.
    ///
    /// # Errors
    /// As [`Self::step_with`].
    pub(crate) fn step_measuring(
        &mut self,
        loss: impl FnOnce(&M::Network) -> (Tensor<1>, Vec<Tensor<1>>),
    ) -> Result<(StepStats, Vec<f32>)> {
        let Slope { loss, mut by_name, measured } = guarded_on(&self.device, || self.slope(loss))?;
        self.check_finite(loss.is_finite(), "the loss")?;
        let grads: Vec<Vec<f32>> =
            self.weights.tensors().iter().map(|t| by_name.remove(&t.name).unwrap_or_default()).collect();
        let grad_norm = global_norm(&grads);
        self.check_finite(grad_norm.is_finite(), "the gradient")?;
        let lr = self.config.schedule.lr(self.step());
        self.apply(&grads, clip_scale(grad_norm, self.config.clip_norm), lr);
        Ok((StepStats { step: self.step(), loss, epe: f32::NAN, grad_norm, lr }, measured))
    }

    fn slope(&self, loss: impl FnOnce(&M::Network) -> (Tensor<1>, Vec<Tensor<1>>)) -> Result<Slope> {
        let network = self.network.build(&self.weights, &self.device.clone().autodiff())?;
        let (loss, mut others) = loss(&network);
        others.push(loss.clone());
        let (by_name, others) = gradients_with::<M>(&network, &loss.backward(), others)?;
        let mut measured: Vec<f32> = others.into_iter().map(|values| values[0]).collect();
        let loss = measured.pop().unwrap_or(f32::NAN);
        Ok(Slope { loss, by_name, measured })
    }

    /// Counts a step without data: the schedule goes on, weights and moments stay. Returns the step's learning rate.
    pub fn skip_step(&mut self) -> f64 {
        let lr = self.config.schedule.lr(self.step());
        self.weights.info.step += 1;
        lr
    }

    fn check_finite(&self, finite: bool, what: &str) -> Result<()> {
        if finite {
            return Ok(());
        }
        Err(NetworkError::NotFinite { step: self.step(), what: what.into() })
    }

    /// Updates each tensor that has a gradient; stored statistics have none.
    fn apply(&mut self, grads: &[Vec<f32>], scale: f32, lr: f64) {
        let (taken, config) = (self.step(), self.config.adamw);
        let tensors: Vec<&mut NamedTensor> = self.weights.tensors_mut().collect();
        tensors.into_par_iter().zip(&mut self.moments).zip(grads).for_each(|((tensor, moments), grad)| {
            if !grad.is_empty() {
                adamw(&config, taken, lr, &mut tensor.data, grad, scale, moments);
            }
        });
        self.weights.info.step += 1;
    }

    /// Writes the whole state atomically.
    ///
    /// # Errors
    /// The folder is not writable or the disk is full; an older checkpoint then stays.
    pub fn save(&self, path: &Path) -> Result<()> {
        self.save_with(path, &[])
    }

    /// As [`Self::save`], with other weights of the network under names of their own, all in one file.
    ///
    /// # Errors
    /// As [`Self::save`].
    pub fn save_with(&self, path: &Path, others: &[(&str, &Weights)]) -> Result<()> {
        let mut all: Vec<NamedTensor> = self.weights.tensors().to_vec();
        for (tensor, moments) in self.weights.tensors().iter().zip(&self.moments) {
            for (prefix, data) in [(MEAN, &moments.mean), (SQUARE, &moments.square)] {
                let name = format!("{prefix}{}", tensor.name);
                all.push(NamedTensor { name, shape: tensor.shape.clone(), data: data.clone() });
            }
        }
        for (name, weights) in others {
            all.extend(
                weights.tensors().iter().map(|t| NamedTensor { name: format!("{name}.{}", t.name), ..t.clone() }),
            );
        }
        let training = serde_json::to_string(&self.config).expect("plain struct");
        write_atomically(path, &serialize_with(&self.weights.info, all.iter(), &[(TRAINING, training)]))
    }

    /// Reads a state that [`Self::save`] wrote, to continue it.
    ///
    /// # Errors
    /// The file is unreadable or damaged, carries no optimiser state, or belongs to another network.
    pub fn load(path: &Path, network: M, device: &Device) -> Result<Self> {
        Ok(Self::load_with(path, network, device, &[])?.0)
    }

    /// Reads a state that [`Self::save_with`] wrote, and the other weights by their names.
    ///
    /// # Errors
    /// As [`Self::load`]; other weights are missing.
    pub fn load_with(path: &Path, network: M, device: &Device, others: &[&str]) -> Result<(Self, Vec<Weights>)> {
        keep_freed();
        let bytes = std::fs::read(path).map_err(io_error(path))?;
        let (info, mut tensors, metadata) = parse_with(&bytes, path)?;
        let problem = |text: String| NetworkError::Checkpoint { path: path.into(), problem: text };
        let text = metadata.get(TRAINING).ok_or_else(|| {
            problem("has no training state; these are plain weights: start a new run from them instead".into())
        })?;
        let config = serde_json::from_str(text).map_err(|e| problem(format!("training state is damaged: {e}")))?;
        if info.config_hash != network.hash() {
            let text = format!("belongs to network `{}` in another configuration; resume with that one", info.network);
            return Err(problem(text));
        }
        let mut moments = Vec::new();
        for spec in network.layout() {
            let mut take = |prefix: &str| {
                let found = tensors.remove(&format!("{prefix}{}", spec.name)).filter(|t| t.shape == spec.shape);
                found.map(|t| t.data).ok_or_else(|| problem(format!("lacks `{prefix}{}` or its shape", spec.name)))
            };
            moments.push(Moments { mean: take(MEAN)?, square: take(SQUARE)? });
        }
        let origin = path.display().to_string();
        let other = |name: &&str| {
            let own = network.layout().into_iter().filter_map(|spec| {
                let found = tensors.remove(&format!("{name}.{}", spec.name))?;
                Some((spec.name.clone(), NamedTensor { name: spec.name, ..found }))
            });
            Weights::from_parts(info.clone(), own.collect(), &network, &origin)
        };
        let others = others.iter().map(other).collect::<Result<Vec<_>>>()?;
        let weights = Weights::from_parts(info, tensors, &network, &origin)?;
        Ok((Self { network, config, weights, moments, device: device.clone() }, others))
    }
}

impl TrainState {
    /// One step on synthetic pairs of side [`NetworkConfig::size_px`] with [`sequence_loss`].
    ///
    /// # Errors
    /// The batch has wrong lengths or values, or loss or gradient are not finite: the weights then stay as they were.
    pub fn train_step(&mut self, batch: &FlowBatch<'_>) -> Result<StepStats> {
        let device = self.device.clone().autodiff();
        let data = guarded_on(&device, || batch.to_device(self.network.size_px, &device))?;
        let (iterations, gamma) = (self.network.iterations_train, self.config.gamma);
        let (stats, measured) = self.step_measuring(|raft| {
            let flows = raft.forward(data.reference.clone(), data.real.clone(), iterations);
            let epe = device_end_point_error(&flows[iterations - 1], &data);
            (sequence_loss(&flows, &data, gamma), vec![epe])
        })?;
        Ok(StepStats { epe: measured[0], ..stats })
    }
}

impl Raft {
    /// Mean end point error of these weights on a batch of pairs of side [`NetworkConfig::size_px`], over the mask, px, computed on
    /// the processor.
    ///
    /// # Errors
    /// The batch has wrong lengths or values, or the weights belong to another architecture.
    pub fn error_px(config: &NetworkConfig, weights: &Weights, batch: &FlowBatch<'_>) -> Result<f32> {
        let device = Device::flex();
        let data = batch.to_device(config.size_px, &device)?;
        let flow = config.build(weights, &device)?.infer(data.reference, data.real, config.iterations_infer);
        Ok(end_point_error(&values(flow), &values(data.flow), &values(data.mask), batch.n))
    }
}

/// Prefixes of the optimiser's tensors and key of the run's constants in a checkpoint.
const MEAN: &str = "adamw.mean.";
const SQUARE: &str = "adamw.square.";
const TRAINING: &str = "pseudoflow_training";

#[cfg(test)]
pub(crate) mod tests;
