use pseudoflow_imaging::ImagingError;
use pseudoflow_metrics::{PointsError, TruthError};
use std::path::PathBuf;

/// Why poses could not be scored or reported.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// Images, cameras, meshes or initial poses of the dataset.
    #[error(transparent)]
    Imaging(#[from] ImagingError),
    /// Ground truth or target list.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// A model that cannot be measured with.
    #[error("object {object_id}: {source}")]
    Points {
        /// Object.
        object_id: u32,
        /// The cause.
        source: PointsError,
    },
    /// A reference result file.
    #[error("{0}: give a BOP result file as `pseudoflow eval --csv` writes it")]
    Reference(String),
    /// A pose that came is none.
    #[error("a pose that came is no pose: {0}")]
    Arrival(String),
    /// A file of details that is none, or belongs to other poses.
    #[error("{what}: give the `details` that a results node wrote beside the result file")]
    DetailsFile {
        /// File or image, and what is wrong.
        what: String,
    },
    /// A file that cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A report that is not one.
    #[error("{path} is not a report of `pseudoflow eval`: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
    /// The folder has no folder of models.
    #[error("{dir} has none of models_eval/, models/, models_cad/: unpack the dataset's models archive there")]
    NoModels {
        /// The dataset's folder.
        dir: PathBuf,
    },
    /// Nobody states which objects are symmetric.
    #[error("{path} is not there: without the symmetries that it lists, right poses would be scored as wrong")]
    NoModelsInfo {
        /// Where it should be.
        path: PathBuf,
    },
    /// An image whose size cannot be read.
    #[error("cannot read the size of {path}: {source}")]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// The cause.
        source: image::ImageError,
    },
    /// The target list asks for an image that is not there.
    #[error(
        "the target list names image {image_id} of scene {scene_id}, which {dir} does not have: wrong split or list?"
    )]
    UnknownTarget {
        /// The split's folder.
        dir: PathBuf,
        /// Scene.
        scene_id: u32,
        /// Image.
        image_id: u32,
    },
    /// An object without a model.
    #[error("scene {scene_id}, image {image_id}: object {object_id} has no model in {models}")]
    UnknownObject {
        /// The models' folder.
        models: PathBuf,
        /// Scene.
        scene_id: u32,
        /// Image.
        image_id: u32,
        /// Object.
        object_id: u32,
    },
    /// Nothing to score.
    #[error("{dir} has no visible true instance to look for: is it a split with scene_gt.json?")]
    NoTargets {
        /// The split's folder.
        dir: PathBuf,
    },
    /// Depth and image differ in size.
    #[error("{path} is {found:?} pixels, its image {expected:?}: VSD needs depth aligned to the image")]
    DepthSize {
        /// The depth image.
        path: PathBuf,
        /// Width and height found.
        found: (u32, u32),
        /// Width and height of the image.
        expected: (u32, u32),
    },
    /// Two sets of estimates of one name, or none.
    #[error("give one or more sets of estimates with different names, not {names:?}")]
    SetNames {
        /// The names.
        names: Vec<String>,
    },
    /// Details that cannot be told which estimates they belong to.
    #[error("set `{set}` has {estimates} estimates and {details} details: give as many, or no details")]
    Details {
        /// Name of the set.
        set: String,
        /// Estimates.
        estimates: usize,
        /// Details.
        details: usize,
    },
    /// An object to be left out that is not there.
    #[error("object {object_id} cannot be left out of the report, which has the objects {known:?}")]
    NotScored {
        /// The object.
        object_id: u32,
        /// Objects of the report.
        known: Vec<u32>,
    },
    /// All objects are to be left out.
    #[error("without the objects {known:?} nothing is left of the report: leave out fewer")]
    NothingLeft {
        /// Objects of the report.
        known: Vec<u32>,
    },
    /// Two reports without a common instance.
    #[error("the two reports have no instance in common (datasets {a} and {b}): compare runs on the same images")]
    NothingInCommon {
        /// Dataset and split of the first.
        a: String,
        /// Dataset and split of the second.
        b: String,
    },
    /// A report without the block to compare.
    #[error("the report of {dataset} has the blocks {found:?}, not `{wanted}`")]
    NoBlock {
        /// Dataset and split.
        dataset: String,
        /// Blocks it has.
        found: Vec<String>,
        /// Block asked for.
        wanted: String,
    },
}

impl EvalError {
    pub(crate) fn io(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        |source| Self::Io { path, source }
    }
}
