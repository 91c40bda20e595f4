use std::path::{Path, PathBuf};

/// Why training did not start or did not go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainerError {
    /// A configuration value is out of its range.
    #[error("training configuration, field `{field}`: give {wanted}")]
    Config {
        /// The field.
        field: String,
        /// What it should be.
        wanted: &'static str,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}; check that the folder exists and may be written")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The checkpoint belongs to a run with another configuration.
    #[error(
        "{path}: the checkpoint's run has `{there}`, this one `{here}`; resume with the same configuration or start a new run"
    )]
    OtherRun {
        /// The configuration kept beside the checkpoint.
        path: PathBuf,
        /// Its first line that differs.
        there: String,
        /// This run's line.
        here: String,
    },
    /// A message that does not fit this training.
    #[error("{0}")]
    Message(String),
    /// The network refused.
    #[error(transparent)]
    Network(#[from] pseudoflow_network::NetworkError),
}

impl TrainerError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}
