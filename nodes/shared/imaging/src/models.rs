//! What an object folder states before any mesh is read: which objects, which files, which units.

use crate::ImagingError;
use crate::objects::read_json;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The file that states objects, sizes and symmetries.
pub(crate) const INFO: &str = "models_info.json";

/// Metres in a unit of `models_info.json`.
pub(crate) const MILLIMETRE_M: f64 = 1e-3;

/// The mesh of an object, a PLY or an OBJ.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshFile {
    /// The file.
    pub path: PathBuf,
    /// Metres in a unit of its coordinates.
    pub metres_per_unit: f64,
}

/// An entry of `models_info.json`: lengths in millimetres, whatever the unit of the mesh. BOP sets carry further keys, so unknown
/// ones are let through.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct ModelInfo {
    /// Ours alone: BOP's meshes are in millimetres.
    mesh_unit: MeshUnit,
    pub(crate) diameter: Option<f64>,
    min_x: Option<f64>,
    min_y: Option<f64>,
    min_z: Option<f64>,
    size_x: Option<f64>,
    size_y: Option<f64>,
    size_z: Option<f64>,
    pub(crate) symmetries_discrete: Vec<[f64; 16]>,
    pub(crate) symmetries_continuous: Vec<ContinuousInfo>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct ContinuousInfo {
    pub(crate) axis: [f64; 3],
    pub(crate) offset: [f64; 3],
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
enum MeshUnit {
    #[default]
    #[serde(rename = "mm")]
    Millimetre,
    #[serde(rename = "cm")]
    Centimetre,
    #[serde(rename = "m")]
    Metre,
    #[serde(rename = "in")]
    Inch,
}

impl MeshUnit {
    fn metres(self) -> f64 {
        match self {
            Self::Millimetre => MILLIMETRE_M,
            Self::Centimetre => 1e-2,
            Self::Metre => 1.0,
            Self::Inch => 0.0254,
        }
    }
}

impl ModelInfo {
    /// Lowest corner and size of the bounding box, millimetres; `None` where neither is stated.
    ///
    /// # Errors
    /// When some of the six values are stated and some are not.
    pub(crate) fn bounds(&self, id: u32, path: &Path) -> Result<Option<[[f64; 3]; 2]>, ImagingError> {
        let low = [self.min_x, self.min_y, self.min_z];
        let size = [self.size_x, self.size_y, self.size_z];
        if low.iter().chain(&size).all(Option::is_none) {
            return Ok(None);
        }
        let all = |values: [Option<f64>; 3]| match values {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            _ => None,
        };
        all(low).zip(all(size)).map(|(low, size)| Some([low, size])).ok_or_else(|| {
            let what = "min_x, min_y, min_z, size_x, size_y, size_z are not all there";
            ImagingError::field(path, id.to_string(), what, "give all six, or none: then the mesh is measured")
        })
    }
}

/// One object as its folder states it.
#[derive(Debug)]
pub(crate) struct Model {
    pub(crate) info: ModelInfo,
    pub(crate) mesh: MeshFile,
}

/// The objects of a folder: those of `models_info.json`, else one for each mesh that is named as BOP names them.
///
/// # Errors
/// When there is none, a mesh is missing, or `models_info.json` is damaged.
pub(crate) fn list(folder: &Path) -> Result<BTreeMap<u32, Model>, ImagingError> {
    let info_path = folder.join(INFO);
    let infos = match info_path.is_file() {
        true => read_json(&info_path)?,
        false => unstated(folder)?,
    };
    if infos.is_empty() {
        return Err(ImagingError::field(&info_path, "{}", "no objects", "list at least one object"));
    }
    let model = |(id, info): (u32, ModelInfo)| {
        let mesh = MeshFile { path: mesh_path(folder, id)?, metres_per_unit: info.mesh_unit.metres() };
        Ok((id, Model { info, mesh }))
    };
    infos.into_iter().map(model).collect()
}

/// PLY before OBJ: BOP's own meshes are PLY, and other tools want an OBJ beside them.
fn mesh_path(folder: &Path, id: u32) -> Result<PathBuf, ImagingError> {
    let names = ["ply", "obj"].map(|extension| folder.join(format!("obj_{id:06}.{extension}")));
    let found = names.iter().find(|path| path.is_file());
    found.cloned().ok_or_else(|| ImagingError::NoMesh { path: folder.to_owned(), id })
}

/// The objects of a folder without `models_info.json`.
fn unstated(folder: &Path) -> Result<BTreeMap<u32, ModelInfo>, ImagingError> {
    let files = meshes_in(folder);
    let ids: BTreeMap<u32, ModelInfo> =
        files.iter().filter_map(|name| Some((id_of(name)?, ModelInfo::default()))).collect();
    match ids.is_empty() {
        true => Err(ImagingError::NoObjects { path: folder.to_owned(), meshes: files }),
        false => Ok(ids),
    }
}

/// Names of PLY and OBJ files, sorted.
fn meshes_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.retain(|name| name.ends_with(".ply") || name.ends_with(".obj"));
    names.sort_unstable();
    names
}

/// 1 for `obj_000001.ply`.
fn id_of(name: &str) -> Option<u32> {
    let (digits, _) = name.strip_prefix("obj_")?.split_once('.')?;
    let id = (digits.len() == 6).then(|| digits.parse().ok())?;
    id.filter(|id: &u32| format!("{id:06}") == digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_bops_own_names_have_an_id() {
        assert_eq!(id_of("obj_000012.obj"), Some(12));
        for other in ["mug.obj", "obj_12.ply", "obj_+00012.ply", "obj_0000012.ply"] {
            assert_eq!(id_of(other), None, "{other}");
        }
    }

    #[test]
    fn a_box_is_whole_or_not_there() {
        let info = |text: &str| serde_json::from_str::<ModelInfo>(text).unwrap().bounds(3, Path::new("a"));
        assert_eq!(info("{}").unwrap(), None);
        let whole = r#"{"min_x": 1, "min_y": 2, "min_z": 3, "size_x": 4, "size_y": 5, "size_z": 6}"#;
        assert_eq!(info(whole).unwrap(), Some([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
        assert!(info(r#"{"min_x": 1}"#).unwrap_err().to_string().contains("all six"));
    }
}
