use pseudoflow_imaging::ImagingError;
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
    /// The object set is empty.
    #[error("{folder}: the object set holds no object; give a BOP models/ folder")]
    NoObjects {
        /// The object set's folder.
        folder: PathBuf,
    },
    /// No draw of a sample showed enough of its object.
    #[error(
        "sample {index} of seed {seed}: the object is hardly visible in every try; lower `synth.visible_min`, widen `synth.projected_px`, or check that models_info.json and the meshes agree"
    )]
    Invisible {
        /// The data's seed.
        seed: u64,
        /// The sample.
        index: u64,
    },
    /// A folder of backgrounds holds no picture that can be used.
    #[error(
        "{folder}: {}; give folders with .jpg or .png pictures of at least 64 x 64 pixels that show something",
        if *found == 0 { "no picture here".to_owned() } else { format!("none of {found} pictures can be used as a background") }
    )]
    NoPictures {
        /// The folder.
        folder: PathBuf,
        /// How many pictures were looked at.
        found: usize,
    },
    /// A folder could not be read.
    #[error("{path}: {source}; check that it is a folder and may be read")]
    Unreadable {
        /// The folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
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
    /// A message that does not fit this training.
    #[error("{0}")]
    Message(String),
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
}

impl TrainerError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}
