use pseudoflow_imaging::ImagingError;
use std::path::{Path, PathBuf};

/// Why training did not start or did not go on.
#[derive(Debug, thiserror::Error)]
pub enum PretrainError {
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
    /// The log of an earlier part of the run cannot be read.
    #[error("{path}: not the log of a pre-training run; start a new run, or restore it")]
    Log {
        /// The file.
        path: PathBuf,
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
    /// The weights that a training starts from by default are not where they are looked for.
    #[error(
        "{path}: {cause}; trainings start from weights that come with pseudoflow: give others with `--warm-start FILE`, or none with `--warm-start random`"
    )]
    NotShipped {
        /// Their path in the repository.
        path: PathBuf,
        /// Why they were not found.
        cause: String,
    },
    /// A data thread died.
    #[error("the thread that makes synthetic samples ended early; see the log")]
    DataThread,
    /// Signals cannot be caught.
    #[error("cannot catch SIGINT and SIGTERM: {0}")]
    Signal(std::io::Error),
    /// The network refused.
    #[error(transparent)]
    Network(#[from] pseudoflow_network::NetworkError),
    /// An object set or an image is bad.
    #[error(transparent)]
    Imaging(#[from] ImagingError),
    /// No synthetic pictures can be made.
    #[error(transparent)]
    Synthetic(#[from] pseudoflow_synthetic::SyntheticError),
}

impl PretrainError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}
