//! Safetensors files of weights and of checkpoints, which hold more than weights.

use crate::error::{NetworkError, Result, io_error};
use crate::weights::{NamedTensor, WeightsInfo};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Reads all f32 tensors and the info of a safetensors file.
pub fn parse(bytes: &[u8], path: &Path) -> Result<(WeightsInfo, BTreeMap<String, NamedTensor>)> {
    parse_with(bytes, path).map(|(info, tensors, _)| (info, tensors))
}

/// Tensors by name, info, and all metadata of a safetensors file.
pub type Parsed = (WeightsInfo, BTreeMap<String, NamedTensor>, HashMap<String, String>);

/// [`parse`] with all metadata.
pub fn parse_with(bytes: &[u8], path: &Path) -> Result<Parsed> {
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
pub fn serialize_with<'a>(
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

/// [`pseudoflow_files::write`] with this crate's error.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    pseudoflow_files::write(path, bytes).map_err(io_error(path))
}
