use pseudoflow_imaging::ImagingError;
use std::path::{Path, PathBuf};

/// Why no synthetic pictures could be made.
#[derive(Debug, thiserror::Error)]
pub enum SyntheticError {
    /// A configuration value is out of its range.
    #[error("configuration of synthetic pictures, field `{field}`: give {wanted}")]
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
    /// What is said of meshes and pictures cannot be used.
    #[error("{0}")]
    Message(String),
    /// An object set or an image is bad.
    #[error(transparent)]
    Imaging(#[from] ImagingError),
}

impl SyntheticError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }
}
