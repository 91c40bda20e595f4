use std::path::PathBuf;

/// Why objects could not be looked for.
#[derive(Debug, thiserror::Error)]
pub enum InitializerError {
    /// The weights cannot be used.
    #[error(
        "`model: {path}`: {cause}. Give weights that `pseudoflow pretrain --stage initializer` wrote, and the network that \
         they were trained with"
    )]
    Model {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: String,
    },
    /// The weights know objects that the set has not.
    #[error("`model: {path}` finds object {id}, which `objects:` has not ({known:?}): give both for the same set")]
    Objects {
        /// The weights.
        path: PathBuf,
        /// The object.
        id: u32,
        /// Those of the set.
        known: Vec<u32>,
    },
    /// A setting is out of its range.
    #[error("`{field}: {got}`: give {wanted}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// Its value.
        got: f64,
        /// What would be right.
        wanted: &'static str,
    },
    /// The engine failed.
    #[error(transparent)]
    Engine(#[from] pseudoflow_inference::InferenceError),
    /// The solver refused its settings.
    #[error(transparent)]
    Solver(#[from] pseudoflow_solver::PnpError),
    /// An object could not be rendered.
    #[error("the views of an object cannot be rendered: {0}")]
    Render(String),
    /// The object set is bad.
    #[error(transparent)]
    Imaging(#[from] pseudoflow_imaging::ImagingError),
}
