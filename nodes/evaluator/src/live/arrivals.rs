use crate::EvalError;
use pseudoflow_msgs::{ObjectPose, PoseSource, PoseStatus};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A frame's poses, as they came.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arrival {
    /// Number of the frame at its source.
    pub index: u64,
    /// Stamp of the frame, nanoseconds.
    pub stamp_ns: i64,
    /// From when the frame was due to when its poses were here, milliseconds.
    pub age_ms: f64,
    /// BOP scene of the frame.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// The likeliest pose of each instance, whatever its status.
    pub poses: Vec<ArrivedPose>,
    /// Phase and reason of each object's track, where the graph says them.
    #[serde(default)]
    pub tracks: BTreeMap<u32, String>,
}

/// A pose, as it came.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArrivedPose {
    /// Object.
    pub object_id: u32,
    /// Which of its instances.
    pub instance: u32,
    /// Whether it goes out as a pose (status `Ok`).
    pub published: bool,
    /// Whether it is marked as predicted: it was not measured in this frame.
    pub predicted: bool,
    /// Confidence.
    pub score: f64,
    /// Rotation of `camera_from_object`, x, y, z, w.
    pub rotation_xyzw: [f64; 4],
    /// Translation of `camera_from_object`, metres.
    pub translation_m: [f64; 3],
}

impl From<&ObjectPose> for ArrivedPose {
    fn from(pose: &ObjectPose) -> Self {
        let ObjectPose { object_id, instance, score, rotation_xyzw, translation_m, .. } = *pose;
        let published = pose.status() == Some(PoseStatus::Ok);
        let predicted = pose.source == PoseSource::Tracked as u32;
        Self { object_id, instance, published, predicted, score, rotation_xyzw, translation_m }
    }
}

/// Reads all arrivals of a file, by frame; a line cut off by a crash is left out.
///
/// # Errors
/// When the file cannot be read.
pub fn read_arrivals(path: &Path) -> Result<Vec<Arrival>, EvalError> {
    let text = std::fs::read_to_string(path).map_err(|source| EvalError::Io { path: path.to_owned(), source })?;
    let lines = text.lines().filter_map(|line| serde_json::from_str::<Arrival>(line).ok());
    let by_frame: BTreeMap<u64, Arrival> = lines.map(|arrival| (arrival.index, arrival)).collect();
    Ok(by_frame.into_values().collect())
}

/// Follows a file of arrivals that grows.
#[derive(Debug)]
pub struct Arrivals {
    path: PathBuf,
    read: u64,
}

impl Arrivals {
    /// Of a file that need not exist yet.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        Self { path, read: 0 }
    }

    /// What has come since the last call; a line that is still being written comes with the next.
    pub fn more(&mut self) -> Vec<Arrival> {
        let Ok(file) = std::fs::File::open(&self.path) else { return Vec::new() };
        let mut reader = BufReader::new(file);
        if reader.seek(SeekFrom::Start(self.read)).is_err() {
            return Vec::new();
        }
        let (mut arrivals, mut line) = (Vec::new(), String::new());
        while matches!(reader.read_line(&mut line), Ok(bytes) if bytes > 0) && line.ends_with('\n') {
            self.read += line.len() as u64;
            arrivals.extend(serde_json::from_str(&line).ok());
            line.clear();
        }
        arrivals
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_growing_file_is_read_line_by_line_each_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("arrivals.jsonl");
        let mut arrivals = Arrivals::new(path.clone());
        assert!(arrivals.more().is_empty());
        let line = |index| {
            let tracks = BTreeMap::new();
            let arrival =
                Arrival { index, stamp_ns: 0, age_ms: 1.5, scene_id: 1, image_id: 2, poses: Vec::new(), tracks };
            serde_json::to_string(&arrival).unwrap()
        };
        let mut file = std::fs::File::create(&path).unwrap();
        write!(file, "{}\n{}", line(0), &line(1)[..20]).unwrap();
        assert_eq!(arrivals.more().len(), 1);
        assert!(arrivals.more().is_empty(), "half a line is none");
        writeln!(file, "{}", &line(1)[20..]).unwrap();
        assert_eq!(arrivals.more()[0].index, 1);
        assert_eq!(read_arrivals(&path).unwrap().len(), 2);
    }
}
