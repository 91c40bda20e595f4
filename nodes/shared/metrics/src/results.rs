//! Result files of the BOP Challenge: `METHOD_DATASET-SPLIT.csv` with the columns
//! `scene_id,im_id,obj_id,score,R,t,time` (R row-major, t in millimetres, time in seconds for the whole image).
//! <https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults>

mod error;
mod parse;
mod writer;

pub use error::{Problem, ResultsError};
pub use parse::{KnownIds, parse_results, read_results};
pub use writer::{ResultsWriter, file_name, write_results};

use crate::MatrixPose;

/// The first line of a result file.
const HEADER: &str = "scene_id,im_id,obj_id,score,R,t,time";

/// One estimated pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Scene of the dataset.
    pub scene_id: u32,
    /// Image of the scene.
    pub image_id: u32,
    /// Object of the dataset.
    pub object_id: u32,
    /// Confidence; only the order matters.
    pub score: f64,
    /// Pose, metres; of one's own: `pose.into()`.
    pub camera_from_object: MatrixPose,
    /// Time spent on the whole image, seconds: the same for all estimates of the image. `None` (-1 in the file) when
    /// it was not measured.
    pub image_time_s: Option<f64>,
}
