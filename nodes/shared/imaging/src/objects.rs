use crate::{ImagingError, Mesh, load_ply};
use nalgebra::{Point3, Vector3};
use pseudoflow_geometry::{ContinuousSymmetry, Symmetries, pose_from_row_major};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// One object of a set.
#[derive(Debug, Clone)]
pub struct Object {
    /// The BOP object id.
    pub id: u32,
    /// From `names.json`, else `obj_000001` and so on.
    pub name: String,
    /// The mesh, shared with the rasterisers.
    pub mesh: Arc<Mesh>,
    /// Largest distance between two points, metres (`models_info.json`).
    pub diameter_m: f64,
    /// Lowest corner of the bounding box, metres.
    pub low_m: Point3<f64>,
    /// Size of the bounding box, metres.
    pub extents_m: Vector3<f64>,
    /// Symmetries, metres.
    pub symmetries: Symmetries,
    /// Few vertices that bound the projection ([`Mesh::hull_points`]), metres.
    pub hull_m: Vec<Point3<f64>>,
}

/// The objects of a BOP `models/` folder, by id.
#[derive(Debug, Clone)]
pub struct ObjectSet {
    folder: PathBuf,
    objects: BTreeMap<u32, Object>,
}

/// An entry of `models_info.json`, millimetres. BOP sets carry further keys, so unknown ones are let through.
#[derive(Deserialize)]
struct ModelInfo {
    diameter: f64,
    min_x: f64,
    min_y: f64,
    min_z: f64,
    size_x: f64,
    size_y: f64,
    size_z: f64,
    #[serde(default)]
    symmetries_discrete: Vec<[f64; 16]>,
    #[serde(default)]
    symmetries_continuous: Vec<ContinuousInfo>,
}

#[derive(Deserialize)]
struct ContinuousInfo {
    axis: [f64; 3],
    offset: [f64; 3],
}

const MILLIMETRE_M: f64 = 1e-3;

impl Object {
    /// The middle of the bounding box, metres.
    #[must_use]
    pub fn box_centre_m(&self) -> Point3<f64> {
        self.low_m + self.extents_m / 2.0
    }

    /// The corners of the bounding box, metres: corner i has the high end of axis k where bit k of i is set.
    #[must_use]
    pub fn box_corners_m(&self) -> [Point3<f64>; 8] {
        let end = |i: usize, k: usize| self.low_m[k] + if i >> k & 1 == 1 { self.extents_m[k] } else { 0.0 };
        std::array::from_fn(|i| Point3::new(end(i, 0), end(i, 1), end(i, 2)))
    }
}

impl ObjectSet {
    /// Reads a BOP `models/` folder: `models_info.json`, `obj_XXXXXX.ply` in millimetres, their textures, and
    /// `names.json` (id to name) if there.
    ///
    /// # Errors
    /// When a file is missing or damaged, a diameter is outside 5 mm .. 5 m, or the mesh and `models_info.json`
    /// disagree on the size by more than 10 %.
    pub fn load(folder: &Path) -> Result<Self, ImagingError> {
        let info_path = folder.join("models_info.json");
        let infos: BTreeMap<u32, ModelInfo> = read_json(&info_path)?;
        if infos.is_empty() {
            return Err(ImagingError::field(&info_path, "{}", "no objects", "list at least one object"));
        }
        let names_path = folder.join("names.json");
        let names: BTreeMap<u32, String> = if names_path.is_file() { read_json(&names_path)? } else { BTreeMap::new() };
        let load = |(id, info): (&u32, &ModelInfo)| {
            let name = names.get(id).cloned().unwrap_or_else(|| format!("obj_{id:06}"));
            Ok((*id, load_object(folder, &info_path, *id, name, info)?))
        };
        let objects = infos.iter().map(load).collect::<Result<_, ImagingError>>()?;
        Ok(Self { folder: folder.to_owned(), objects })
    }

    /// The object with an id.
    ///
    /// # Errors
    /// [`ImagingError::UnknownObject`].
    pub fn get(&self, id: u32) -> Result<&Object, ImagingError> {
        self.objects.get(&id).ok_or_else(|| ImagingError::UnknownObject {
            path: self.folder.clone(),
            id,
            known: self.ids(),
        })
    }

    /// The ids, ascending.
    #[must_use]
    pub fn ids(&self) -> Vec<u32> {
        self.objects.keys().copied().collect()
    }

    /// The objects by ascending id.
    pub fn iter(&self) -> impl Iterator<Item = &Object> {
        self.objects.values()
    }

    /// How many objects there are (at least one).
    #[must_use]
    #[allow(clippy::len_without_is_empty)] // a set is never empty
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// The folder that the set was read from.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

pub(crate) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ImagingError> {
    let text = std::fs::read_to_string(path).map_err(ImagingError::io(path))?;
    serde_json::from_str(&text).map_err(|source| ImagingError::Json { path: path.to_owned(), source })
}

fn load_object(
    folder: &Path,
    info_path: &Path,
    id: u32,
    name: String,
    info: &ModelInfo,
) -> Result<Object, ImagingError> {
    let diameter_m = info.diameter * MILLIMETRE_M;
    check_diameter(info_path, format!("{id}.diameter"), diameter_m)?;
    let path = folder.join(format!("obj_{id:06}.ply"));
    let mesh = load_ply(&path, MILLIMETRE_M)?;
    let measured_m = mesh.diameter_m();
    check_diameter(&path, "x, y, z".into(), measured_m)?;
    if (measured_m / diameter_m - 1.0).abs() > 0.1 {
        let what = format!("{diameter_m} m, but the mesh of {} measures {measured_m} m", path.display());
        let remedy = "make models_info.json and the mesh agree (both in millimetres)";
        return Err(ImagingError::field(info_path, format!("{id}.diameter"), what, remedy));
    }
    let symmetries = symmetries(info, id, info_path)?;
    Ok(Object {
        id,
        name,
        diameter_m,
        low_m: Point3::new(info.min_x, info.min_y, info.min_z) * MILLIMETRE_M,
        extents_m: Vector3::new(info.size_x, info.size_y, info.size_z) * MILLIMETRE_M,
        symmetries,
        hull_m: mesh.hull_points(),
        mesh: Arc::new(mesh),
    })
}

fn check_diameter(path: &Path, field: String, diameter_m: f64) -> Result<(), ImagingError> {
    if (0.005..=5.0).contains(&diameter_m) {
        return Ok(());
    }
    Err(ImagingError::Diameter { path: path.to_owned(), field, diameter_m })
}

fn symmetries(info: &ModelInfo, id: u32, path: &Path) -> Result<Symmetries, ImagingError> {
    let discrete = info.symmetries_discrete.iter().enumerate().map(|(i, m)| {
        let rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        let field = || format!("{id}.symmetries_discrete[{i}]");
        pose_from_row_major(&rotation, &[m[3], m[7], m[11]].map(|mm| mm * MILLIMETRE_M))
            .map_err(|source| ImagingError::Pose { path: path.to_owned(), field: field(), source })
    });
    let continuous = info.symmetries_continuous.iter().enumerate().map(|(i, c)| {
        let axis = Vector3::from(c.axis);
        match axis.norm().is_normal() {
            true => Ok(ContinuousSymmetry { axis: axis.normalize(), offset_m: Point3::from(c.offset) * MILLIMETRE_M }),
            false => {
                let field = format!("{id}.symmetries_continuous[{i}].axis");
                Err(ImagingError::field(path, field, format!("{:?} has no direction", c.axis), "give a unit vector"))
            }
        }
    });
    Ok(Symmetries { discrete: discrete.collect::<Result<_, _>>()?, continuous: continuous.collect::<Result<_, _>>()? })
}
