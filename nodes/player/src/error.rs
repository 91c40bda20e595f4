use pseudoflow_bag::BagError;
use pseudoflow_imaging::ImagingError;
use std::path::PathBuf;

/// Why a recording cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum PlayerError {
    /// The bag itself.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The BOP folder, its images or poses.
    #[error(transparent)]
    Imaging(#[from] ImagingError),
    /// A BOP result file of initial poses.
    #[error(transparent)]
    Results(#[from] pseudoflow_metrics::ResultsError),
    /// A target list.
    #[error("`targets`: {0}")]
    Targets(#[from] pseudoflow_metrics::TruthError),
    /// A calibration file.
    #[error(transparent)]
    Calibration(#[from] pseudoflow_edge::camera::CalibrationFileError),
    /// Neither a bag nor a BOP scene.
    #[error(
        "`source: {0}`: no recording there: give a rosbag2 folder, an .mcap file, a BOP scene folder (with scene_camera.json) or a folder of such"
    )]
    NoRecording(PathBuf),
    /// No topic has the wanted type.
    #[error("{path}: there is no topic of type {types} (`{key}`): record one along; the bag has {topics}", path = path.display())]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// The types that would fit.
        types: String,
        /// The key of the configuration.
        key: &'static str,
        /// What the bag has.
        topics: String,
    },
    /// More than one topic could be the wanted one.
    #[error("{path}: {found} topics are of type {types}: name one with `{key}`; the bag has {topics}", path = path.display())]
    Topic {
        /// The bag.
        path: PathBuf,
        /// How many topics fit.
        found: usize,
        /// The types that fit.
        types: String,
        /// The key of the configuration.
        key: &'static str,
        /// What the bag has.
        topics: String,
    },
    /// An image without a camera.
    #[error("{path}: image {number} (stamp {stamp_ns} ns) has no CameraInfo of its stamp or before it on `{topic}`: record it along", path = path.display())]
    NoCameraInfo {
        /// The bag.
        path: PathBuf,
        /// Number of the image.
        number: usize,
        /// Its stamp.
        stamp_ns: i64,
        /// Topic of the CameraInfo.
        topic: String,
    },
    /// A message that cannot be played.
    #[error("{path}: topic `{topic}`, message {number}: {cause}", path = path.display())]
    Message {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its count in the topic, from 0.
        number: usize,
        /// What is wrong with it, and what to do.
        cause: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The image and its CameraInfo differ in size, or the size changes.
    #[error("{path}: image {number} is {found:?} pixels, expected {expected:?} ({what}): play recordings of one camera and one mode at a time", path = path.display())]
    Size {
        /// The recording.
        path: PathBuf,
        /// Number of the image.
        number: usize,
        /// Width and height of the image.
        found: (u32, u32),
        /// What they should be.
        expected: (u32, u32),
        /// Where the expectation comes from.
        what: &'static str,
    },
    /// An image that cannot be decoded.
    #[error("{path}: image {number}: {cause}", path = path.display())]
    Image {
        /// The recording.
        path: PathBuf,
        /// Number of the image.
        number: usize,
        /// What is wrong.
        cause: String,
    },
    /// A pose of an object that the set lacks.
    #[error("{path}: frame {number} has an initial pose of object {object_id}, the object set has {known:?}: add the object, or list those wanted in `only_objects`", path = path.display())]
    UnknownObject {
        /// The recording.
        path: PathBuf,
        /// Number of the frame.
        number: usize,
        /// The object.
        object_id: u32,
        /// The set's objects.
        known: Vec<u32>,
    },
    /// An object that is wanted but that the set lacks.
    #[error("`only_objects`: there is no object {object_id}; {objects} has {known:?}: list those alone", objects = objects.display())]
    UnknownWanted {
        /// The object.
        object_id: u32,
        /// The object set.
        objects: PathBuf,
        /// The set's objects.
        known: Vec<u32>,
    },
    /// A training without a sample.
    #[error(
        "{path}: none of {frames} frames has an initial pose that can be used: training needs initial poses (a topic, a file, or a \
         BOP scene's init_poses.json), and `held_out_every` and `budget_frames` must leave frames", path = path.display()
    )]
    NothingToSample {
        /// The first recording.
        path: PathBuf,
        /// All frames.
        frames: usize,
    },
    /// A selection that leaves nothing.
    #[error("{path}: no image is selected: `every` and `max_frames` must be at least 1, and the scene have images", path = path.display())]
    NothingSelected {
        /// The scene.
        path: PathBuf,
    },
}
