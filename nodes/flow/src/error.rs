use std::path::PathBuf;

/// Why no flow could be computed.
#[derive(Debug, thiserror::Error)]
pub enum FlowError {
    /// The engine could not be opened, or failed.
    #[error(transparent)]
    Engine(#[from] pseudoflow_inference::InferenceError),
    /// The device is not there, or the weights belong to another network.
    #[error(transparent)]
    Network(#[from] pseudoflow_network::NetworkError),
    /// Device and engine do not go together.
    #[error(
        "`device: {device}` and `engine` ({engine}) do not go together: ONNX Runtime computes on cpu and cuda, rten on cpu, \
         burn on every device"
    )]
    DeviceAndEngine {
        /// The device.
        device: String,
        /// Backend and provider.
        engine: String,
    },
    /// No engine computes on the device.
    #[error("`device: {device}`: {reasons}")]
    NoEngine {
        /// The device.
        device: String,
        /// What each engine said.
        reasons: String,
    },
    /// A device that only burn computes on, or burn itself, in a binary without it.
    #[error(
        "`device: {device}` with burn: this binary was built without its feature `training`: build it with it, or let ONNX Runtime \
         or rten compute (`device: cpu`, `engine.backend: auto`)"
    )]
    NoBurn {
        /// The device.
        device: String,
    },
    /// This binary finds no GPU.
    #[error("no GPU that this binary can use")]
    NoGpu,
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
