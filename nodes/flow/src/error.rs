use std::path::PathBuf;

/// Why no flow could be computed.
#[derive(Debug, thiserror::Error)]
pub enum FlowError {
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
    #[error("{engine} failed on {fields} fields of {size_px} x {size_px} px: {cause}")]
    Run {
        /// Engine.
        engine: &'static str,
        /// Fields in the batch.
        fields: usize,
        /// Width and height.
        size_px: usize,
        /// What it said.
        cause: String,
    },
    /// A GPU provider was asked for where only the embedded engine is.
    #[error("provider `{0:?}` needs ONNX Runtime: set `backend: onnxruntime`, or `provider: cpu`")]
    ProviderNeedsOnnxRuntime(crate::ExecutionProvider),
    /// The model file could not be read.
    #[error("`model: {path}` could not be read: {cause}. Give the path of a .onnx or .safetensors file")]
    Model {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: String,
    },
    /// Sizes of views and network differ.
    #[error(
        "the views are {views_px} px wide, the flow network is set to {network_px}: give renderer and flow the same `size_px`"
    )]
    Size {
        /// Of the renderer's message.
        views_px: usize,
        /// Of this node's configuration.
        network_px: usize,
    },
    /// A trainer publishes at another pace.
    #[error(
        "flow's `lockstep` swaps weights every {here} frames, the trainer sends them every {there}: give both the same \
         `frames_per_step` and `publish_every`"
    )]
    OutOfStep {
        /// Frames between two publications by this node's configuration.
        here: u64,
        /// By the trainer's.
        there: u64,
    },
}
