//! BOP scene folders without their ground truth: nothing here names `scene_gt.json`.

use crate::{DepthImage, ImagingError, RgbImage, files, objects::read_json};
use pseudoflow_geometry::{Intrinsics, Pose, pose_from_row_major};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A rough pose of an object in an image (`init_poses.json`).
#[derive(Debug, Clone, PartialEq)]
pub struct InitialPose {
    /// The BOP object id.
    pub object_id: u32,
    /// The pose, metres.
    pub camera_from_object: Pose,
}

/// One image of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct BopFrame {
    /// The BOP image id.
    pub image_id: u32,
    /// The image file.
    pub image_path: PathBuf,
    /// The depth file, where the scene has one.
    pub depth_path: Option<PathBuf>,
    /// The camera, pixels.
    pub intrinsics: Intrinsics,
    /// Millimetres per step of the depth image.
    pub depth_scale: f64,
    /// The initial poses; empty where the file has none for this image.
    pub initial_poses: Vec<InitialPose>,
}

/// A scene folder (`SPLIT/000001`): images, cameras and initial poses.
#[derive(Debug, Clone)]
pub struct BopScene {
    /// The folder.
    pub folder: PathBuf,
    /// The number in the folder's name; 0 when the name is no number.
    pub scene_id: u32,
    /// The images by ascending id.
    pub frames: Vec<BopFrame>,
}

#[derive(Deserialize)]
struct CameraEntry {
    #[serde(rename = "cam_K")]
    camera_matrix: [f64; 9],
    #[serde(default = "one")]
    depth_scale: f64,
}

fn one() -> f64 {
    1.0
}

#[derive(Deserialize)]
#[allow(non_snake_case)] // the names of the file format
struct PoseEntry {
    obj_id: u32,
    cam_R_m2c: [f64; 9],
    cam_t_m2c: [f64; 3],
}

/// The scene folders of a split (`train`, `test`), by name.
///
/// # Errors
/// When the folder cannot be read, or holds no folder with a `scene_camera.json`.
pub fn list_scenes(split: &Path) -> Result<Vec<PathBuf>, ImagingError> {
    let mut scenes = Vec::new();
    for entry in std::fs::read_dir(split).map_err(ImagingError::io(split))? {
        let path = entry.map_err(ImagingError::io(split))?.path();
        if path.join("scene_camera.json").is_file() {
            scenes.push(path);
        }
    }
    if scenes.is_empty() {
        return Err(ImagingError::field(
            split,
            "*/scene_camera.json",
            "no scene",
            "name a split such as test/ or train/",
        ));
    }
    scenes.sort();
    Ok(scenes)
}

/// Reads a file of initial poses (`init_poses.json`, millimetres) by image id.
///
/// # Errors
/// When the file cannot be read, or an entry is no pose.
pub fn read_initial_poses(path: &Path) -> Result<BTreeMap<u32, Vec<InitialPose>>, ImagingError> {
    let entries: BTreeMap<u32, Vec<PoseEntry>> = read_json(path)?;
    entries.into_iter().map(|(id, entries)| Ok((id, initial_poses(path, id, entries)?))).collect()
}

impl BopScene {
    /// Reads `scene_camera.json` and, if there, `init_poses.json`; images are found but not read.
    ///
    /// # Errors
    /// When a file is missing or damaged, an image is missing, or a camera or pose is not valid.
    pub fn open(folder: &Path) -> Result<Self, ImagingError> {
        Self::open_where(folder, &|_| true)
    }

    /// As [`BopScene::open`], with only the images whose id is `wanted`; the others need not be there (archives of a
    /// target list hold fewer images than their `scene_camera.json` names).
    ///
    /// # Errors
    /// As [`BopScene::open`].
    pub fn open_where(folder: &Path, wanted: &dyn Fn(u32) -> bool) -> Result<Self, ImagingError> {
        let camera_path = folder.join("scene_camera.json");
        let cameras: BTreeMap<u32, CameraEntry> = read_json(&camera_path)?;
        let poses_path = folder.join("init_poses.json");
        let mut poses = if poses_path.is_file() { read_initial_poses(&poses_path)? } else { BTreeMap::new() };
        let mut frames = Vec::with_capacity(cameras.len());
        for (image_id, camera) in cameras.iter().filter(|(id, _)| wanted(**id)) {
            let intrinsics =
                Intrinsics::from_row_major(&camera.camera_matrix).map_err(|source| ImagingError::Intrinsics {
                    path: camera_path.clone(),
                    field: format!("{image_id}.cam_K"),
                    source: Box::new(source),
                })?;
            frames.push(BopFrame {
                image_id: *image_id,
                image_path: find_image(folder, *image_id)?,
                depth_path: Some(folder.join(format!("depth/{image_id:06}.png"))).filter(|p| p.is_file()),
                intrinsics,
                depth_scale: camera.depth_scale,
                initial_poses: poses.remove(image_id).unwrap_or_default(),
            });
        }
        let scene_id = folder.file_name().and_then(|n| n.to_str()).and_then(|n| n.parse().ok()).unwrap_or(0);
        Ok(Self { folder: folder.to_owned(), scene_id, frames })
    }

    /// The frame of an image id.
    ///
    /// # Errors
    /// [`ImagingError::MissingImage`].
    pub fn frame(&self, image_id: u32) -> Result<&BopFrame, ImagingError> {
        let found = self.frames.iter().find(|f| f.image_id == image_id);
        found.ok_or_else(|| ImagingError::MissingImage { path: self.folder.clone(), image_id })
    }
}

impl BopFrame {
    /// Reads the image; grey images get three equal channels.
    ///
    /// # Errors
    /// When the file cannot be read or decoded.
    pub fn load_image(&self) -> Result<RgbImage, ImagingError> {
        files::load_rgb(&self.image_path)
    }

    /// Reads the depth sensor's image, metres; `None` where the scene has none.
    ///
    /// # Errors
    /// When the file cannot be read or decoded.
    pub fn load_depth(&self) -> Result<Option<DepthImage>, ImagingError> {
        self.depth_path.as_deref().map(|path| files::load_depth(path, self.depth_scale)).transpose()
    }
}

fn find_image(folder: &Path, image_id: u32) -> Result<PathBuf, ImagingError> {
    let names = ["rgb", "gray"].iter().flat_map(|d| ["png", "jpg", "jpeg"].map(|e| format!("{d}/{image_id:06}.{e}")));
    let found = names.map(|name| folder.join(name)).find(|path| path.is_file());
    found.ok_or_else(|| ImagingError::MissingImage { path: folder.to_owned(), image_id })
}

fn initial_poses(path: &Path, image_id: u32, entries: Vec<PoseEntry>) -> Result<Vec<InitialPose>, ImagingError> {
    let convert = |(i, entry): (usize, PoseEntry)| {
        let camera_from_object =
            pose_from_row_major(&entry.cam_R_m2c, &entry.cam_t_m2c.map(|mm| mm * 1e-3)).map_err(|source| {
                ImagingError::Pose { path: path.to_owned(), field: format!("{image_id}[{i}]"), source }
            })?;
        Ok(InitialPose { object_id: entry.obj_id, camera_from_object })
    };
    entries.into_iter().enumerate().map(convert).collect()
}
