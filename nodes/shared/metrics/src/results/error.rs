use pseudoflow_geometry::PoseError;
use std::path::PathBuf;

/// What is wrong with one line of a result file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Not seven columns.
    #[error("{found} columns instead of the 7 of scene_id,im_id,obj_id,score,R,t,time")]
    Columns {
        /// Columns found.
        found: usize,
    },
    /// A field is not a number of the kind that belongs there.
    #[error("{field} is `{text}`, which is not {expected}")]
    Number {
        /// Column.
        field: &'static str,
        /// What stands there.
        text: String,
        /// What should.
        expected: &'static str,
    },
    /// R or t has too few or too many numbers.
    #[error("{field} has {found} numbers instead of {expected}")]
    Count {
        /// Column.
        field: &'static str,
        /// Numbers found.
        found: usize,
        /// Numbers there should be.
        expected: usize,
    },
    /// R and t are not a pose.
    #[error("{0}")]
    Pose(PoseError),
    /// The dataset has no such image.
    #[error("the dataset has no image {image_id} in scene {scene_id}")]
    UnknownImage {
        /// Scene.
        scene_id: u32,
        /// Image.
        image_id: u32,
    },
    /// The dataset has no such object.
    #[error("the dataset has no object {object_id}")]
    UnknownObject {
        /// Object.
        object_id: u32,
    },
    /// The same pose of the same object in the same image stands in the file already.
    #[error("repeats the pose of line {first_line}")]
    Duplicate {
        /// The line that it repeats, counted from 1.
        first_line: usize,
    },
    /// The times of one image differ.
    #[error("time {time} s differs from the {first_time} s of line {first_line}: it is the time of the whole image")]
    Time {
        /// Time of this line.
        time: f64,
        /// Time of the image's first line.
        first_time: f64,
        /// The image's first line, counted from 1.
        first_line: usize,
    },
}

/// Why a result file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// Lines are wrong. Nothing of the file was used.
    #[error("{}", list(path, problems))]
    Lines {
        /// The file.
        path: PathBuf,
        /// All problems, with their lines counted from 1.
        problems: Vec<(usize, Problem)>,
    },
    /// A name that the file name cannot hold.
    #[error(
        "{part} name `{name}` cannot be part of METHOD_DATASET-SPLIT.csv: use letters, digits and dashes (dashes not in DATASET)"
    )]
    Name {
        /// Which part.
        part: &'static str,
        /// The name.
        name: String,
    },
    /// Estimates of one image with different times.
    #[error(
        "estimates of scene {scene_id}, image {image_id} have different times: BOP wants the time of the whole image in each"
    )]
    ImageTimes {
        /// Scene.
        scene_id: u32,
        /// Image.
        image_id: u32,
    },
}

fn list(path: &std::path::Path, problems: &[(usize, Problem)]) -> String {
    const SHOWN: usize = 20;
    let mut text = format!("{}: {} bad line(s), nothing was used:", path.display(), problems.len());
    for (line, problem) in problems.iter().take(SHOWN) {
        text += &format!("\n  line {line}: {problem}");
    }
    if problems.len() > SHOWN {
        text += &format!("\n  and {} more", problems.len() - SHOWN);
    }
    text
}
