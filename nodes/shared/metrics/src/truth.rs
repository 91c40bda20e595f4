use crate::MatrixPose;
use pseudoflow_geometry::PoseError;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// One true pose.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthInstance {
    /// The object, as numbered by the dataset.
    pub object_id: u32,
    /// Pose, metres, as the file gives it.
    pub camera_from_object: MatrixPose,
    /// The visible share of the projected surface, where `scene_gt_info.json` says it.
    pub visible_fraction: Option<f64>,
}

/// The ground truth of one scene of a BOP dataset, by image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneTruth {
    /// Instances by image id, in the order of the file (their index is BOP's `gt_id`).
    pub images: BTreeMap<u32, Vec<TruthInstance>>,
}

/// One line of a target list: how many instances of an object are to be found in an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Target {
    /// Scene.
    pub scene_id: u32,
    /// Image of the scene.
    #[serde(rename = "im_id")]
    pub image_id: u32,
    /// Object.
    #[serde(rename = "obj_id")]
    pub object_id: u32,
    /// Number of instances.
    pub inst_count: u32,
}

/// Why ground truth could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The file is missing or unreadable.
    #[error("cannot read {path}: {source}; a scene to be scored needs its ground truth there")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not what BOP's format asks for.
    #[error("{path} is not in BOP's format: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause, with line and column.
        source: serde_json::Error,
    },
    /// A true pose is not a pose.
    #[error("{path}, image {image_id}, entry {index}: {source}")]
    Pose {
        /// The file.
        path: PathBuf,
        /// Image.
        image_id: u32,
        /// Index in the image's list.
        index: usize,
        /// The cause.
        source: PoseError,
    },
    /// `scene_gt_info.json` and `scene_gt.json` do not list the same instances.
    #[error("{path} lists {found} instances for image {image_id}, scene_gt.json {expected}: regenerate it")]
    InfoCount {
        /// The file.
        path: PathBuf,
        /// Image.
        image_id: u32,
        /// Entries found.
        found: usize,
        /// Entries of scene_gt.json.
        expected: usize,
    },
}

#[derive(Deserialize)]
struct RawTruth {
    obj_id: u32,
    #[serde(rename = "cam_R_m2c")]
    rotation: [f64; 9],
    #[serde(rename = "cam_t_m2c")]
    translation_mm: [f64; 3],
}

#[derive(Deserialize)]
struct RawInfo {
    visib_fract: Option<f64>,
    px_count_all: Option<f64>,
    px_count_visib: Option<f64>,
}

impl RawInfo {
    fn visible_fraction(&self) -> Option<f64> {
        let of_counts = || Some(self.px_count_visib? / self.px_count_all.filter(|n| *n > 0.0)?);
        self.visib_fract.or_else(of_counts)
    }
}

impl SceneTruth {
    /// Reads `scene_gt.json` and, if it is there, `scene_gt_info.json` of a scene's folder (millimetres become
    /// metres). <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>
    ///
    /// # Errors
    /// When a file cannot be read or is malformed, a pose is not a pose, or the two files disagree.
    pub fn read(scene_dir: &Path) -> Result<Self, TruthError> {
        let path = scene_dir.join("scene_gt.json");
        let raw: BTreeMap<u32, Vec<RawTruth>> = read_json(&path)?;
        let info_path = scene_dir.join("scene_gt_info.json");
        let infos: BTreeMap<u32, Vec<RawInfo>> =
            if info_path.exists() { read_json(&info_path)? } else { BTreeMap::new() };
        let mut images = BTreeMap::new();
        for (image_id, raw) in raw {
            let info = infos.get(&image_id);
            if let Some(found) = info.map(Vec::len).filter(|n| *n != raw.len()) {
                return Err(TruthError::InfoCount { path: info_path, image_id, found, expected: raw.len() });
            }
            let read = |(index, r): (usize, &RawTruth)| {
                let visible_fraction = info.and_then(|i| i[index].visible_fraction());
                instance(r, visible_fraction).map_err(|source| TruthError::Pose {
                    path: path.clone(),
                    image_id,
                    index,
                    source,
                })
            };
            images.insert(image_id, raw.iter().enumerate().map(read).collect::<Result<_, _>>()?);
        }
        Ok(Self { images })
    }
}

fn instance(raw: &RawTruth, visible_fraction: Option<f64>) -> Result<TruthInstance, PoseError> {
    let camera_from_object = MatrixPose::from_row_major(&raw.rotation, &raw.translation_mm.map(|v| v * 1e-3))?;
    Ok(TruthInstance { object_id: raw.obj_id, camera_from_object, visible_fraction })
}

/// Reads a target list such as `test_targets_bop19.json`.
///
/// # Errors
/// When the file cannot be read or is malformed.
pub fn read_targets(path: &Path) -> Result<Vec<Target>, TruthError> {
    read_json(path)
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, TruthError> {
    let text = std::fs::read_to_string(path).map_err(|source| TruthError::Io { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|source| TruthError::Json { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(gt: &str, info: Option<&str>) -> Result<SceneTruth, TruthError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("scene_gt.json"), gt).unwrap();
        if let Some(info) = info {
            std::fs::write(dir.path().join("scene_gt_info.json"), info).unwrap();
        }
        SceneTruth::read(dir.path())
    }

    const GT: &str = r#"{"7": [{"obj_id": 5, "cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [10, 20, 900]}]}"#;

    #[test]
    fn millimetres_become_metres() {
        let truth = scene(GT, Some(r#"{"7": [{"visib_fract": 0.25}]}"#)).unwrap();
        let instance = &truth.images[&7][0];
        assert!((instance.camera_from_object.translation_m() - nalgebra::Vector3::new(0.01, 0.02, 0.9)).norm() < 1e-12);
        assert_eq!((instance.object_id, instance.visible_fraction), (5, Some(0.25)));
    }

    #[test]
    fn visibility_may_be_missing_or_follow_from_pixel_counts() {
        assert_eq!(scene(GT, None).unwrap().images[&7][0].visible_fraction, None);
        let counts = scene(GT, Some(r#"{"7": [{"px_count_all": 200, "px_count_visib": 50}]}"#)).unwrap();
        assert_eq!(counts.images[&7][0].visible_fraction, Some(0.25));
    }

    #[test]
    fn errors_say_where() {
        let message = scene(GT, Some(r#"{"7": []}"#)).unwrap_err().to_string();
        assert!(message.contains("image 7") && message.contains("lists 0"), "{message}");
        let mirrored = GT.replace("0,0,0,1]", "0,0,0,-1]");
        let message = scene(&mirrored, None).unwrap_err().to_string();
        assert!(message.contains("image 7, entry 0") && message.contains("not a rotation"), "{message}");
        let message = SceneTruth::read(Path::new("/nowhere")).unwrap_err().to_string();
        assert!(message.contains("/nowhere/scene_gt.json"), "{message}");
    }
}
