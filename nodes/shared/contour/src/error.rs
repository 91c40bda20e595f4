use std::path::PathBuf;

/// What is wrong with the arguments of a call. What the picture does not say is a [`RegionStatus`](crate::RegionStatus) instead.
#[derive(Debug, thiserror::Error)]
pub enum ContourError {
    /// No model can be made of a mesh.
    #[error("no contour model of this mesh: {what}; check its faces and its scale (metres)")]
    Mesh {
        /// What is wrong with it.
        what: String,
    },
    /// A model could not be kept for the next start.
    #[error("cannot write the contour model to {path}: {source}; give a folder that can be written")]
    Cache {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A picture has the wrong number of bytes.
    #[error("a picture of {width} x {height} pixels has {need} bytes, got {got}")]
    Picture {
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes needed: three for each pixel.
        need: usize,
        /// Bytes given.
        got: usize,
    },
    /// A setting is out of its range.
    #[error("setting `{name}` is {got}: it must be {must}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The value given.
        got: f64,
        /// What would be right.
        must: &'static str,
    },
}
