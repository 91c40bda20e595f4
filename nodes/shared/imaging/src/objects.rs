use crate::models::{self, INFO, MILLIMETRE_M, MeshFile, Model, ModelInfo};
use crate::{ImagingError, Mesh, load_obj, load_ply};
use nalgebra::{Point3, Vector3};
use pseudoflow_geometry::{ContinuousSymmetry, Symmetries, pose_from_row_major};
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
    /// Where the mesh was read from; `None` of one that was made here.
    pub mesh_file: Option<MeshFile>,
    /// Largest distance between two points, metres (`models_info.json`, else [`Mesh::diameter_m`]).
    pub diameter_m: f64,
    /// Lowest corner of the bounding box, metres (`models_info.json`, else the mesh's).
    pub low_m: Point3<f64>,
    /// Size of the bounding box, metres (`models_info.json`, else the mesh's).
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
    /// Reads a BOP `models/` folder: `models_info.json`; for each object `obj_XXXXXX.ply` or, where there is none, `obj_XXXXXX.obj`;
    /// their textures and materials; and `names.json` (id to name) if there.
    ///
    /// Meshes are in millimetres unless `models_info.json` says otherwise: `"mesh_unit": "m"` (`mm`, `cm`, `m`, `in`). Without
    /// `models_info.json` each mesh named as above is an object; diameters and boxes that nobody states are those of the mesh.
    ///
    /// ```
    /// use pseudoflow_imaging::ObjectSet;
    ///
    /// let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/objects/tabletop");
    /// let set = ObjectSet::load(folder.as_ref())?;
    /// let bottle = set.get(2)?;
    /// assert_eq!(bottle.name, "mustard_bottle");
    /// assert!((bottle.diameter_m - 0.1965).abs() < 1e-4);
    /// # Ok::<(), pseudoflow_imaging::ImagingError>(())
    /// ```
    /// # Errors
    /// When a file is missing or damaged, a diameter is outside 5 mm .. 5 m, or the mesh and `models_info.json`
    /// disagree on the size by more than 10 %.
    pub fn load(folder: &Path) -> Result<Self, ImagingError> {
        let models = models::list(folder)?;
        let names_path = folder.join("names.json");
        let names: BTreeMap<u32, String> = if names_path.is_file() { read_json(&names_path)? } else { BTreeMap::new() };
        let load = |(id, model): (u32, Model)| {
            let name = names.get(&id).cloned().unwrap_or_else(|| format!("obj_{id:06}"));
            Ok((id, load_object(&folder.join(INFO), id, name, model)?))
        };
        let objects = models.into_iter().map(load).collect::<Result<_, ImagingError>>()?;
        Ok(Self { folder: folder.to_owned(), objects })
    }

    /// Whether [`ObjectSet::load`] would find objects in a folder, without reading their meshes.
    ///
    /// # Errors
    /// When it would find none, a mesh is not there, or `models_info.json` is damaged.
    pub fn check(folder: &Path) -> Result<(), ImagingError> {
        models::list(folder).map(|_| ())
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

fn load_object(info_path: &Path, id: u32, name: String, model: Model) -> Result<Object, ImagingError> {
    let Model { info, mesh: file } = model;
    let stated_m = info.diameter.map(|diameter| diameter * MILLIMETRE_M);
    if let Some(diameter_m) = stated_m {
        check_diameter(info_path, format!("{id}.diameter"), diameter_m)?;
    }
    let mesh = match file.path.extension().is_some_and(|extension| extension == "obj") {
        true => load_obj(&file.path, file.metres_per_unit)?,
        false => load_ply(&file.path, file.metres_per_unit)?,
    };
    let measured_m = mesh.diameter_m();
    check_diameter(&file.path, "x, y, z".into(), measured_m)?;
    let diameter_m = stated_m.unwrap_or(measured_m);
    if (measured_m / diameter_m - 1.0).abs() > 0.1 {
        let what = format!("{diameter_m} m, but the mesh of {} measures {measured_m} m", file.path.display());
        let remedy = "make models_info.json (millimetres) and the mesh (`mesh_unit`, else millimetres) agree";
        return Err(ImagingError::field(info_path, format!("{id}.diameter"), what, remedy));
    }
    let (low_m, extents_m) = bounds_m(&info, id, info_path, &mesh)?;
    Ok(Object {
        id,
        name,
        diameter_m,
        low_m,
        extents_m,
        symmetries: symmetries(&info, id, info_path)?,
        hull_m: mesh.hull_points(),
        mesh: Arc::new(mesh),
        mesh_file: Some(file),
    })
}

/// Lowest corner and size of the bounding box: as stated, else those of the mesh.
fn bounds_m(
    info: &ModelInfo,
    id: u32,
    info_path: &Path,
    mesh: &Mesh,
) -> Result<(Point3<f64>, Vector3<f64>), ImagingError> {
    let (low, high) = mesh.bounds_m();
    Ok(match info.bounds(id, info_path)? {
        Some([low, size]) => (Point3::from(low) * MILLIMETRE_M, Vector3::from(size) * MILLIMETRE_M),
        None => (low, high - low),
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
