//! Calibration files as ROS 2's `camera_calibration` writes them (YAML of `camera_calibration_parsers`).

use pseudoflow_msgs::ros::CameraInfo;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A file of a few numbers; what is larger is none.
const MOST_BYTES: u64 = 64 * 1024;

/// Why a calibration file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("calibration {path}: {cause}: give the YAML file that camera_calibration writes", path = path.display())]
pub struct CalibrationFileError {
    path: PathBuf,
    cause: String,
}

/// Other keys (`camera_name`) say nothing that is needed.
#[derive(Deserialize)]
struct File {
    image_width: u32,
    image_height: u32,
    camera_matrix: Matrix,
    distortion_model: String,
    distortion_coefficients: Matrix,
    #[serde(default)]
    rectification_matrix: Option<Matrix>,
    #[serde(default)]
    projection_matrix: Option<Matrix>,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

/// Reads a calibration. The header is left empty.
///
/// # Errors
/// When the file cannot be read or is no calibration. Whether it is a usable one, [`super::Lens::new`] says.
pub fn read_calibration(path: &Path) -> Result<CameraInfo, CalibrationFileError> {
    let failed = |cause: String| CalibrationFileError { path: path.to_owned(), cause };
    let about = std::fs::metadata(path).map_err(|error| failed(error.to_string()))?;
    if about.len() > MOST_BYTES {
        return Err(failed(format!("{} bytes are too many for a calibration", about.len())));
    }
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    parse(&text).map_err(failed)
}

fn parse(text: &str) -> Result<CameraInfo, String> {
    let file: File = serde_yaml::from_str(text).map_err(|error| error.to_string())?;
    Ok(CameraInfo {
        width: file.image_width,
        height: file.image_height,
        distortion_model: file.distortion_model,
        d: file.distortion_coefficients.data,
        k: array("camera_matrix", &file.camera_matrix)?,
        r: file.rectification_matrix.as_ref().map_or(Ok([0.0; 9]), |m| array("rectification_matrix", m))?,
        p: file.projection_matrix.as_ref().map_or(Ok([0.0; 12]), |m| array("projection_matrix", m))?,
        ..CameraInfo::default()
    })
}

fn array<const N: usize>(key: &str, matrix: &Matrix) -> Result<[f64; N], String> {
    matrix.data.as_slice().try_into().map_err(|_| format!("`{key}.data` has {} numbers, not {N}", matrix.data.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
        data: [600, 0, 320, 0, 610.5, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  \
        data: [-0.1, 0.01, 0, 0, 0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
        projection_matrix:\n  rows: 3\n  cols: 4\n  data: [590, 0, 321, 0, 0, 600, 241, 0, 0, 0, 1, 0]\n";

    #[test]
    fn a_file_of_camera_calibration_is_read() {
        let info = parse(TEXT).unwrap();
        assert_eq!((info.width, info.k[4], info.d.len(), info.p[2]), (640, 610.5, 5, 321.0));
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        assert!(parse(&TEXT.replace("610.5, ", "")).unwrap_err().contains("camera_matrix"));
        assert!(parse("image_width: 3").unwrap_err().contains("image_height"));
        let missing = read_calibration(Path::new("/nowhere.yaml")).unwrap_err().to_string();
        assert!(missing.contains("/nowhere.yaml"), "{missing}");
    }
}
