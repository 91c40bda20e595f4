use crate::FlowError;
use crate::onnxruntime::OnnxRuntime;
use crate::rten_engine::Rten;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Runs the flow network.
pub trait FlowEngine: Send {
    /// Engine, version and provider, for logs and reports.
    fn describe(&self) -> String;

    /// Computes `n` fields. `reference` and `real` are `n x 3 x S x S` in `[-1, 1]` ([`crate::normalise`]); the
    /// answer goes to `flow_px`, `n x 2 x S x S` pixels.
    ///
    /// # Errors
    /// What the engine says, with sizes.
    fn run(
        &mut self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        flow_px: &mut [f32],
    ) -> Result<(), FlowError>;
}

/// Which engine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// ONNX Runtime where its library is found, else rten; the log says which.
    #[default]
    Auto,
    /// ONNX Runtime, or an error.
    OnnxRuntime,
    /// The engine inside the binary.
    Rten,
}

/// Where ONNX Runtime computes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExecutionProvider {
    /// The processor.
    #[default]
    Cpu,
    /// An NVIDIA GPU through CUDA; an error where there is none.
    Cuda,
    /// An NVIDIA GPU through TensorRT, CUDA for what it does not take; an error where there is none.
    TensorRt,
}

/// How to run a network.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EngineConfig {
    /// Which engine.
    pub backend: Backend,
    /// Where ONNX Runtime computes.
    pub provider: ExecutionProvider,
    /// File of ONNX Runtime's library; else `ORT_DYLIB_PATH`, else `libonnxruntime.so` as the loader finds it.
    pub onnxruntime: Option<PathBuf>,
    /// Threads; 0: as many as there are cores.
    pub threads: usize,
}

impl EngineConfig {
    /// The library to load, and whether somebody named it.
    fn library(&self) -> (PathBuf, bool) {
        let named = self.onnxruntime.clone().or_else(|| std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from));
        let given = named.is_some();
        (named.unwrap_or_else(|| PathBuf::from(DEFAULT_LIBRARY)), given)
    }
}

#[cfg(target_os = "macos")]
const DEFAULT_LIBRARY: &str = "libonnxruntime.dylib";
#[cfg(not(target_os = "macos"))]
const DEFAULT_LIBRARY: &str = "libonnxruntime.so";

/// Opens a network, given as the bytes of an ONNX file, on the engine that the configuration names.
///
/// # Errors
/// When the engine is not there or refuses the network. `backend: auto` turns to rten only when nobody named a
/// library and the loader finds none.
pub fn open(onnx: &[u8], config: &EngineConfig) -> Result<Box<dyn FlowEngine>, FlowError> {
    let (library, named) = config.library();
    match config.backend {
        Backend::OnnxRuntime => Ok(Box::new(OnnxRuntime::open(onnx, &library, config)?)),
        Backend::Rten => open_rten(onnx, config),
        Backend::Auto => match OnnxRuntime::open(onnx, &library, config) {
            Err(FlowError::Library { cause, .. }) if !named => {
                log::info!("no ONNX Runtime on this machine ({cause}): the embedded rten computes the flow");
                open_rten(onnx, config)
            }
            other => Ok(Box::new(other?)),
        },
    }
}

fn open_rten(onnx: &[u8], config: &EngineConfig) -> Result<Box<dyn FlowEngine>, FlowError> {
    if config.provider != ExecutionProvider::Cpu {
        return Err(FlowError::ProviderNeedsOnnxRuntime(config.provider));
    }
    Ok(Box::new(Rten::open(onnx, config.threads)?))
}
