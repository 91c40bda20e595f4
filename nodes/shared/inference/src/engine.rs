use crate::InferenceError;
use crate::onnxruntime::OnnxRuntime;
use crate::rten_engine::Rten;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A tensor that goes into a network.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// Its name in the network.
    pub name: &'a str,
    /// Shape, outermost first.
    pub shape: &'a [usize],
    /// Row-major values.
    pub data: &'a [f32],
}

/// Where a tensor goes that comes out.
#[derive(Debug)]
pub struct Output<'a> {
    /// Its name in the network.
    pub name: &'a str,
    /// Row-major values; as many as the network gives.
    pub data: &'a mut [f32],
}

/// Runs a network.
pub trait Engine: Send {
    /// Engine, version and provider, for logs and reports.
    fn describe(&self) -> String;

    /// Computes the outputs.
    ///
    /// # Errors
    /// What the engine says, with shapes; an output that is not there or has another length.
    fn run(&mut self, inputs: &[Input<'_>], outputs: &mut [Output<'_>]) -> Result<(), InferenceError>;
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
    /// The training's own network, inside the binary, on the `device` of the node. It runs weights, not ONNX files.
    Burn,
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
    /// Where ONNX Runtime computes; by default as the node's `device` says, and on the processor where it has none.
    pub provider: Option<ExecutionProvider>,
    /// Number of the NVIDIA GPU that ONNX Runtime computes on.
    pub gpu: u16,
    /// File of ONNX Runtime's library; else `ORT_DYLIB_PATH`, else `libonnxruntime.so` as the loader finds it.
    pub onnxruntime: Option<PathBuf>,
    /// Threads; 0: as many as there are cores.
    pub threads: usize,
}

impl EngineConfig {
    /// Where ONNX Runtime computes.
    #[must_use]
    pub fn provider(&self) -> ExecutionProvider {
        self.provider.unwrap_or_default()
    }

    /// This configuration with ONNX Runtime on an NVIDIA GPU, through CUDA if no provider is named.
    #[must_use]
    pub fn on_gpu(&self, gpu: u16) -> Self {
        let provider = Some(self.provider.unwrap_or(ExecutionProvider::Cuda));
        Self { backend: Backend::OnnxRuntime, provider, gpu, ..self.clone() }
    }

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
pub fn open(onnx: &[u8], config: &EngineConfig) -> Result<Box<dyn Engine>, InferenceError> {
    let (library, named) = config.library();
    match config.backend {
        Backend::OnnxRuntime => Ok(Box::new(OnnxRuntime::open(onnx, &library, config)?)),
        Backend::Rten => open_rten(onnx, config),
        Backend::Burn => Err(InferenceError::NeedsWeights),
        Backend::Auto => match OnnxRuntime::open(onnx, &library, config) {
            Err(InferenceError::Library { cause, .. }) if !named => {
                log::info!("no ONNX Runtime on this machine ({cause}): the embedded rten computes");
                open_rten(onnx, config)
            }
            other => Ok(Box::new(other?)),
        },
    }
}

fn open_rten(onnx: &[u8], config: &EngineConfig) -> Result<Box<dyn Engine>, InferenceError> {
    if config.provider() != ExecutionProvider::Cpu {
        return Err(InferenceError::ProviderNeedsOnnxRuntime(config.provider()));
    }
    Ok(Box::new(Rten::open(onnx, config.threads)?))
}
