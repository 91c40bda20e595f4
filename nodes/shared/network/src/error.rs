//! What can go wrong with configurations, weights and training state.

use std::path::PathBuf;

/// Every failure of this crate. Messages say what was wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// A file could not be read or written.
    #[error("{path}: {source}; check that the path exists and is readable and writable")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        #[source]
        source: std::io::Error,
    },
    /// A YAML configuration has an unknown key, a wrong type or is no YAML at all.
    #[error("{path}: {message}; the keys of a network are listed in config/networks/nano.yaml")]
    ConfigSyntax {
        /// The file.
        path: PathBuf,
        /// The parser's message with line and field.
        message: String,
    },
    /// A configuration value is out of its range.
    #[error("network configuration, field `{field}`: {problem}")]
    ConfigValue {
        /// The field.
        field: &'static str,
        /// What is wrong and which values are allowed.
        problem: String,
    },
    /// The file is no safetensors file, or is damaged.
    #[error("{path}: not a readable safetensors file ({message}); fetch or train the weights again")]
    WeightsFormat {
        /// The file.
        path: PathBuf,
        /// The parser's message.
        message: String,
    },
    /// Weights of another network.
    #[error(
        "{origin}: these weights do not belong to network `{network}`: tensor `{tensor}` {problem}; \
         choose the weights trained for this network, or the network they were trained for"
    )]
    WeightsMismatch {
        /// File or other origin of the weights.
        origin: String,
        /// Network they were loaded into.
        network: String,
        /// First tensor that does not fit.
        tensor: String,
        /// What differs, with both shapes.
        problem: String,
    },
    /// A batch has the wrong size or non-finite values.
    #[error("training batch: {0}")]
    Batch(String),
    /// The loss or a gradient is no longer finite.
    #[error("step {step}: {what} is not finite; the weights were left as they were before this step")]
    NotFinite {
        /// Step at which it happened, counted from 0.
        step: u64,
        /// Loss or gradient of which tensor.
        what: String,
    },
    /// A device was asked for that is not there.
    #[error("device `{device}` {problem}")]
    Device {
        /// As it was asked for.
        device: String,
        /// What is missing and what to do.
        problem: String,
    },
    /// A GPU failed or vanished while it computed.
    #[error(
        "device {device} failed: {cause}; what was computed before is whole: go on from the checkpoint, on this device \
         or on another one (`--device cpu`)"
    )]
    DeviceFailed {
        /// The device.
        device: String,
        /// What it said.
        cause: String,
    },
    /// A checkpoint does not continue this run.
    #[error("{path}: {problem}")]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What differs and what to do.
        problem: String,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, NetworkError>;

/// Maps an [`std::io::Error`] at `path`.
pub fn io_error(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> NetworkError + '_ {
    move |source| NetworkError::Io { path: path.to_path_buf(), source }
}
