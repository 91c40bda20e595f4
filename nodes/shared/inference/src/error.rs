use std::path::PathBuf;

/// Why a network could not be run.
#[derive(Debug, thiserror::Error)]
pub enum InferenceError {
    /// The library of ONNX Runtime was asked for and is not there.
    #[error(
        "ONNX Runtime could not be loaded from `{path}`: {cause}. Install it (`pip install onnxruntime==1.31.1` brings \
         onnxruntime/capi/libonnxruntime.so.1.31.1), set ORT_DYLIB_PATH or `onnxruntime:` to the file, or choose `backend: rten`"
    )]
    Library {
        /// Where it was looked for.
        path: PathBuf,
        /// What the loader said.
        cause: String,
    },
    /// The engine refused the network.
    #[error("{engine} cannot load the network: {cause}")]
    Load {
        /// Engine.
        engine: &'static str,
        /// What it said.
        cause: String,
    },
    /// The engine failed while it ran.
    #[error("{engine} failed on input `{input}` of shape {shape:?}: {cause}")]
    Run {
        /// Engine.
        engine: &'static str,
        /// First input.
        input: String,
        /// Its shape.
        shape: Vec<usize>,
        /// What it said.
        cause: String,
    },
    /// The library has no part for the GPU.
    #[error(
        "the ONNX Runtime of `{library}` was built without {provider:?}; install the one for GPUs (`pip install \
         onnxruntime-gpu`) and set ORT_DYLIB_PATH to its libonnxruntime.so, or use `device: vulkan` or `cpu`"
    )]
    ProviderNotBuilt {
        /// What was asked for.
        provider: crate::ExecutionProvider,
        /// The library.
        library: PathBuf,
    },
    /// An engine that runs weights was asked to run an ONNX file.
    #[error(
        "`backend: burn` runs .safetensors weights of a flow network, and this is an ONNX file; choose `onnxruntime` or `rten`"
    )]
    NeedsWeights,
    /// A GPU provider was asked for where only the embedded engine is.
    #[error("provider `{0:?}` needs ONNX Runtime: set `backend: onnxruntime`, or `provider: cpu`")]
    ProviderNeedsOnnxRuntime(crate::ExecutionProvider),
}
