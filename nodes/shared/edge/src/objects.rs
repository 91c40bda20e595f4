use pseudoflow_imaging::{ImagingError, MeshFile, ObjectSet};
use pseudoflow_msgs::ros::{Naming, NamingError, ObjectBox};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Names and boxes of an object set. Boxes hold every vertex of their mesh; those of `models_info.json` may be rounded.
///
/// # Errors
/// When two objects could not be told apart by name, topic or frame.
pub fn naming_of(set: &ObjectSet) -> Result<Naming, NamingError> {
    let naming = Naming::new(set.iter().map(|object| (object.id, object.name.clone())).collect())?;
    let boxes = set.iter().map(|object| {
        let (low, high) = object.mesh.bounds_m();
        let centre = nalgebra::center(&low, &high);
        (object.id, ObjectBox { centre_m: centre.coords.into(), size_m: (high - low).into() })
    });
    Ok(naming.with_boxes(boxes.collect()))
}

/// What the edges say about a set of objects.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Catalogue {
    /// Names, tokens and boxes.
    pub naming: Naming,
    /// Folder of the set; empty without one.
    pub folder: PathBuf,
    /// The mesh of each object, an absolute path.
    pub meshes: BTreeMap<u32, MeshFile>,
}

/// Why an object set cannot be named.
#[derive(Debug, thiserror::Error)]
pub enum CatalogueError {
    /// The set cannot be read.
    #[error(transparent)]
    Objects(#[from] ImagingError),
    /// Its names are ambiguous.
    #[error("{folder}: {source}", folder = folder.display())]
    Names {
        /// The set.
        folder: PathBuf,
        /// Which.
        source: NamingError,
    },
}

impl Catalogue {
    /// Reads the object set in a folder.
    ///
    /// # Errors
    /// When it cannot be read, or two of its objects could not be told apart outside.
    pub fn load(folder: &Path) -> Result<Self, CatalogueError> {
        let set = ObjectSet::load(folder)?;
        let naming = naming_of(&set).map_err(|source| CatalogueError::Names { folder: folder.to_owned(), source })?;
        let absolute = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let mesh = |file: &MeshFile| MeshFile { path: absolute(&file.path), ..*file };
        let meshes = set.iter().filter_map(|object| Some((object.id, mesh(object.mesh_file.as_ref()?)))).collect();
        Ok(Self { naming, folder: absolute(folder), meshes })
    }

    /// As [`Self::load`]; without a folder, objects have their ids for names.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_if(folder: Option<&Path>) -> Result<Self, CatalogueError> {
        folder.map_or_else(|| Ok(Self::default()), Self::load)
    }

    /// When meshes, names or `weights` were last changed, seconds since 1970: a version that goes up with them. 0 where no
    /// file can be looked at.
    #[must_use]
    pub fn version(&self, weights: &[PathBuf]) -> i32 {
        let about = ["models_info.json", "names.json"].map(|name| self.folder.join(name));
        let files = self.meshes.values().map(|mesh| &mesh.path).chain(weights).chain(&about);
        let changed_s = |path: &PathBuf| {
            let changed = std::fs::metadata(path).and_then(|about| about.modified()).ok()?;
            i32::try_from(changed.duration_since(UNIX_EPOCH).ok()?.as_secs()).ok()
        };
        files.filter_map(changed_s).max().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
    use pseudoflow_msgs::{ObjectPose, PoseStatus};

    fn tabletop() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/objects/tabletop")
    }

    #[test]
    fn every_vertex_lies_in_its_published_box() {
        let set = ObjectSet::load(&tabletop()).unwrap();
        let naming = naming_of(&set).unwrap();
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(0.3, -0.5, 0.1, 0.8));
        let translation = Vector3::new(0.1, -0.2, 0.7);
        for object in set.iter() {
            let pose = ObjectPose {
                object_id: object.id,
                instance: 0,
                status: PoseStatus::Ok as u32,
                source: 0,
                score: 1.0,
                rotation_xyzw: rotation.coords.into(),
                translation_m: translation.into(),
                covariance: [0.0; 36],
            };
            let found = naming.bounding_box(&pose);
            let centre = found.center.position;
            for vertex in object.mesh.points() {
                let seen = rotation * vertex + translation - Vector3::new(centre.x, centre.y, centre.z);
                let inside: Point3<f64> = rotation.inverse() * seen;
                let size = [found.size.x, found.size.y, found.size.z];
                assert!((0..3).all(|i| inside[i].abs() <= size[i] / 2.0 + 1e-4), "{} {inside}", object.name);
            }
        }
    }

    #[test]
    fn a_catalogue_has_names_meshes_and_a_version() {
        let catalogue = Catalogue::load(&tabletop()).unwrap();
        assert!(catalogue.meshes.values().all(|mesh| mesh.path.is_file() && mesh.path.is_absolute()));
        assert!(catalogue.naming.named().all(|(_, name)| !name.starts_with("obj_")));
        let newer = tempfile::NamedTempFile::new().unwrap();
        let version = catalogue.version(&[]);
        assert!(version > 1_600_000_000 && catalogue.version(&[newer.path().to_owned()]) >= version);
        assert_eq!(Catalogue::default().version(&[]), 0);
    }
}
