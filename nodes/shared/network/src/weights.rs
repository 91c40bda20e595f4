//! Weights as named plain tensors, in safetensors files with the authors' names.

use crate::error::{NetworkError, Result, io_error};
use crate::model::{Init, Model, TensorSpec};
use crate::storage::{parse, serialize_with, write_atomically};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// One named tensor, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedTensor {
    /// Name as in the authors' code, e.g. `fnet.layer1.0.conv1.weight`.
    pub name: String,
    /// Shape, outermost first.
    pub shape: Vec<usize>,
    /// Values.
    pub data: Vec<f32>,
}

/// Where weights come from; kept in the file's metadata.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct WeightsInfo {
    /// Name of the network.
    pub network: String,
    /// [`Model::hash`] of the configuration they were trained with.
    pub config_hash: String,
    /// Optimiser steps taken.
    pub step: u64,
    /// Objects they were trained for, by name; empty for general weights.
    pub objects: Vec<String>,
    /// The same by id, where the network tells them apart: in the order of its outputs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub object_ids: Vec<u32>,
    /// Licence or origin, if other than this project's.
    pub origin: String,
}

/// All weights of one network, in the fixed order of its architecture.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Origin and progress.
    pub info: WeightsInfo,
    tensors: Vec<NamedTensor>,
}

impl Weights {
    /// Weights to train from scratch, as the authors start: the same seed gives the same bits.
    pub fn random(config: &impl Model, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let tensors = config.layout().into_iter().map(|spec| {
            let data = initial_values(&spec, &mut rng);
            NamedTensor { name: spec.name, shape: spec.shape, data }
        });
        let info =
            WeightsInfo { network: config.name().to_owned(), config_hash: config.hash(), ..WeightsInfo::default() };
        Self { info, tensors: tensors.collect() }
    }

    /// Reads a safetensors file and checks it against a network.
    ///
    /// # Errors
    /// The file is unreadable or damaged, or a tensor is missing, has another shape or is not finite: the message names
    /// the first one in the network's order.
    pub fn load(path: &Path, config: &impl Model) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(io_error(path))?;
        Self::from_bytes(&bytes, config, &path.display().to_string())
    }

    /// As [`Self::load`] from the bytes of such a file; `origin` is named in errors.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn from_bytes(bytes: &[u8], config: &impl Model, origin: &str) -> Result<Self> {
        let (info, tensors) = parse(bytes, Path::new(origin))?;
        Self::from_parts(info, tensors, config, origin)
    }

    /// Reads where the weights of a file come from; a checkpoint's as well.
    ///
    /// # Errors
    /// The file is unreadable or damaged.
    pub fn read_info(path: &Path) -> Result<WeightsInfo> {
        let bytes = std::fs::read(path).map_err(io_error(path))?;
        Ok(parse(&bytes, path)?.0)
    }

    /// Orders and checks loose tensors; `origin` is named in errors.
    ///
    /// # Errors
    /// A tensor is missing, unknown, of another shape or not finite: the message names the first.
    pub fn from_parts(
        info: WeightsInfo,
        mut tensors: BTreeMap<String, NamedTensor>,
        config: &impl Model,
        origin: &str,
    ) -> Result<Self> {
        let mismatch = |tensor: &str, problem: String| NetworkError::WeightsMismatch {
            origin: origin.into(),
            network: config.name().to_owned(),
            tensor: tensor.into(),
            problem,
        };
        let mut ordered = Vec::new();
        for spec in config.layout() {
            let found = tensors.remove(&spec.name);
            ordered.push(check_tensor(found, &spec).map_err(|problem| mismatch(&spec.name, problem))?);
        }
        match tensors.keys().next() {
            Some(extra) => Err(mismatch(extra, "is unknown to it".into())),
            None => Ok(Self { info, tensors: ordered }),
        }
    }

    /// Writes a safetensors file: beside the target, synced, then renamed over it.
    ///
    /// # Errors
    /// The folder is not writable or the disk is full; the target is then as it was.
    pub fn save(&self, path: &Path) -> Result<()> {
        write_atomically(path, &self.to_bytes())
    }

    /// The file's bytes; the same weights give the same bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        serialize_with(&self.info, self.tensors.iter(), &[])
    }

    /// All tensors in order.
    pub fn tensors(&self) -> &[NamedTensor] {
        &self.tensors
    }

    /// All tensors in order, to change their values (shapes must stay).
    pub fn tensors_mut(&mut self) -> impl Iterator<Item = &mut NamedTensor> {
        self.tensors.iter_mut()
    }

    /// A tensor by name.
    pub fn get(&self, name: &str) -> Option<&NamedTensor> {
        self.tensors.iter().find(|t| t.name == name)
    }

    /// Moves the values towards `other`: `w = alpha w + (1 - alpha) other`, the teacher's moving average.
    ///
    /// # Panics
    /// If the two belong to different architectures.
    pub fn average_with(&mut self, other: &Self, alpha: f32) {
        assert_eq!(self.tensors.len(), other.tensors.len(), "weights of one architecture");
        for (mine, theirs) in self.tensors.iter_mut().zip(&other.tensors) {
            assert_eq!((&mine.name, &mine.shape), (&theirs.name, &theirs.shape), "weights of one architecture");
            mine.data.iter_mut().zip(&theirs.data).for_each(|(m, t)| *m = alpha * *m + (1.0 - alpha) * t);
        }
    }
}

fn initial_values(spec: &TensorSpec, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let count = spec.shape.iter().product();
    match spec.init {
        Init::Constant(value) => vec![value; count],
        Init::Uniform(fan_in) => {
            let bound = 1.0 / (fan_in as f32).sqrt();
            (0..count).map(|_| rng.random_range(-bound..bound)).collect()
        }
        Init::KaimingNormal => {
            let fan_out = spec.shape[0] * spec.shape[2] * spec.shape[3];
            let sigma = (2.0 / fan_out as f32).sqrt();
            (0..count).map(|_| sigma * normal(rng)).collect()
        }
    }
}

/// Standard normal by Box and Muller.
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    (radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()) as f32
}

fn check_tensor(found: Option<NamedTensor>, spec: &TensorSpec) -> std::result::Result<NamedTensor, String> {
    let tensor = found.ok_or_else(|| format!("(shape {:?}) is missing", spec.shape))?;
    if tensor.shape != spec.shape {
        return Err(format!("has shape {:?}, the network needs {:?}", tensor.shape, spec.shape));
    }
    match tensor.data.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("has a value that is not finite at index {at}")),
        None => Ok(tensor),
    }
}
