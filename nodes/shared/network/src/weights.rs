//! Weights as named plain tensors, in safetensors files with the authors' names.

use crate::error::{NetworkError, Result, io_error};
use crate::model::{Init, Model, TensorSpec};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
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
    pub(crate) fn from_parts(
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

/// Reads all f32 tensors and the info of a safetensors file.
pub(crate) fn parse(bytes: &[u8], path: &Path) -> Result<(WeightsInfo, BTreeMap<String, NamedTensor>)> {
    parse_with(bytes, path).map(|(info, tensors, _)| (info, tensors))
}

/// Tensors by name, info, and all metadata of a safetensors file.
pub(crate) type Parsed = (WeightsInfo, BTreeMap<String, NamedTensor>, HashMap<String, String>);

/// [`parse`] with all metadata.
pub(crate) fn parse_with(bytes: &[u8], path: &Path) -> Result<Parsed> {
    let bad = |message: String| NetworkError::WeightsFormat { path: path.into(), message };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| bad(e.to_string()))?;
    let file = SafeTensors::deserialize(bytes).map_err(|e| bad(e.to_string()))?;
    let mut metadata = header.metadata().clone().unwrap_or_default();
    lift(&mut metadata);
    let mut tensors = BTreeMap::new();
    for (name, view) in file.tensors() {
        // Counters of the authors' batch norms carry nothing.
        if name.ends_with("num_batches_tracked") {
            continue;
        }
        if view.dtype() != Dtype::F32 {
            return Err(bad(format!("tensor `{name}` has type {:?}, only F32 is read", view.dtype())));
        }
        let data = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        tensors.insert(name.clone(), NamedTensor { name, shape: view.shape().to_vec(), data });
    }
    Ok((read_info(&metadata).map_err(bad)?, tensors, metadata))
}

/// Makes the texts that [`serialize_with`] put beside the info entries of their own.
fn lift(metadata: &mut HashMap<String, String>) {
    let text = metadata.get("pseudoflow").map(String::as_str).unwrap_or_default();
    if let Ok(serde_json::Value::Object(fields)) = serde_json::from_str(text) {
        let texts = fields.iter().filter_map(|(key, value)| Some((key.clone(), value.as_str()?.to_owned())));
        texts.filter(|(key, _)| key.starts_with("pseudoflow_")).for_each(|(key, value)| {
            metadata.insert(key, value);
        });
    }
}

fn read_info(metadata: &HashMap<String, String>) -> std::result::Result<WeightsInfo, String> {
    match metadata.get("pseudoflow") {
        Some(text) => serde_json::from_str(text).map_err(|e| format!("metadata `pseudoflow`: {e}")),
        None => {
            let origin = [metadata.get("source"), metadata.get("licence")].into_iter().flatten().cloned();
            Ok(WeightsInfo { origin: origin.collect::<Vec<_>>().join(", "), ..WeightsInfo::default() })
        }
    }
}

/// The bytes of a safetensors file with this info, these tensors and more metadata.
pub(crate) fn serialize_with<'a>(
    info: &WeightsInfo,
    tensors: impl Iterator<Item = &'a NamedTensor>,
    more: &[(&str, String)],
) -> Vec<u8> {
    let bytes: Vec<(&NamedTensor, Vec<u8>)> =
        tensors.map(|t| (t, t.data.iter().flat_map(|v| v.to_le_bytes()).collect())).collect();
    let views = bytes.iter().map(|(t, b)| {
        let view = TensorView::new(Dtype::F32, t.shape.clone(), b).expect("data as long as its shape says");
        (t.name.as_str(), view)
    });
    // All under one key: the library writes several in an order of chance.
    let mut text = serde_json::to_value(info).expect("plain struct");
    more.iter().for_each(|(key, value)| text[key] = value.clone().into());
    let metadata = HashMap::from([("pseudoflow".to_string(), text.to_string())]);
    safetensors::serialize(views, Some(metadata)).expect("names are unique, shapes are small")
}

/// Writes beside the target, syncs, and renames over it, so that a crash leaves the old or the new file, never half.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let write = || {
        let mut file = std::fs::File::create(&part)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&part, path)?;
        // Makes the rename itself durable.
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::File::open(folder)?.sync_all()
    };
    write().map_err(|e| {
        // Best effort: the error that matters is the first one.
        let _ = std::fs::remove_file(&part);
        io_error(path)(e)
    })
}
