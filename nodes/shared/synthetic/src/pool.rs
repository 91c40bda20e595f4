//! The objects of a training: those of several BOP `models/` folders together.

use super::card::{Origin, Statements};
use crate::SyntheticError;
use pseudoflow_imaging::raster::openness;
use pseudoflow_imaging::{Mesh, Object, ObjectSet};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// Objects to train on. Their ids need not be unique: an object is known by its place in the pool.
#[derive(Debug, Clone)]
pub struct ObjectPool {
    objects: Vec<Arc<Object>>,
    names: Vec<String>,
    origins: Vec<Origin>,
}

impl ObjectPool {
    /// Reads all objects of all folders, in the order given.
    ///
    /// # Errors
    /// When no folder is given, a `meta.json` is damaged, or as [`ObjectSet::load`].
    pub fn load(folders: &[PathBuf]) -> Result<Self, SyntheticError> {
        let sets = folders.iter().map(|folder| ObjectSet::load(folder)).collect::<Result<Vec<_>, _>>()?;
        let pool = Self::of_sets(&sets)?;
        if pool.objects.is_empty() {
            return Err(SyntheticError::NoObjects { folder: folders.first().cloned().unwrap_or_default() });
        }
        let triangles: usize = pool.objects.iter().map(|o| o.mesh.triangles.len()).sum();
        log::info!("{} objects of {} folders, {triangles} triangles", pool.len(), folders.len());
        for object in pool.objects.iter().filter(|o| o.mesh.texture.is_none() && o.mesh.colours.is_empty()) {
            log::warn!(
                "object {} ({}) has neither texture nor vertex colours: it is drawn light grey",
                object.id,
                object.name
            );
        }
        Ok(pool)
    }

    /// The objects of sets that are loaded.
    ///
    /// # Errors
    /// When the `meta.json` of a set's folder is damaged.
    pub fn of_sets(sets: &[ObjectSet]) -> Result<Self, SyntheticError> {
        let objects: Vec<&Object> = sets.iter().flat_map(ObjectSet::iter).collect();
        let objects = objects.par_iter().map(|object| Arc::new(with_openness((*object).clone()))).collect();
        // One set keeps its names; of several, each name says where it comes from.
        let folder = |set: &ObjectSet| set.folder().iter().rev().take(2).collect::<PathBuf>();
        let name = |set: &ObjectSet, object: &Object| match sets.len() {
            1 => object.name.clone(),
            _ => format!("{}/{}", folder(set).iter().rev().collect::<PathBuf>().display(), object.name),
        };
        let names: Vec<String> = sets.iter().flat_map(|set| set.iter().map(move |object| name(set, object))).collect();
        let stated = sets.iter().map(|set| Statements::of_folder(set.folder())).collect::<Result<Vec<_>, _>>()?;
        let of_set = |(set, stated): (&ObjectSet, &Statements)| -> Vec<Origin> {
            set.iter().map(|object| stated.origin(&object.id.to_string(), &object.name)).collect()
        };
        let origins = sets.iter().zip(&stated).flat_map(of_set).collect();
        Ok(Self { objects, names, origins })
    }

    /// Without the objects that are not stated to be shippable; those of which nothing is stated count as the user's own.
    ///
    /// # Errors
    /// When none is left.
    pub fn only_shippable(self) -> Result<Self, SyntheticError> {
        let before = self.len();
        let free: Vec<bool> = self.origins.iter().map(Origin::is_free).collect();
        let (kept, _) = self.parted(|place| !free[place]);
        log::info!("{} of {before} objects may be shipped; the others are left out", kept.objects.len());
        match kept.objects.is_empty() {
            true => {
                Err(SyntheticError::Message("none of the objects may be shipped (`meta.json`); give others".to_owned()))
            }
            false => Ok(kept),
        }
    }

    /// Takes every n-th object out, for measuring on what a training never saw: (the rest, those taken out). Pools of fewer than
    /// n objects stay whole, and nothing is taken.
    #[must_use]
    pub fn hold_out(self, every: usize) -> (Self, Option<Self>) {
        if self.objects.len() < every {
            return (self, None);
        }
        let (kept, held) = self.parted(|place| (place + 1).is_multiple_of(every));
        (kept, Some(held))
    }

    /// (The rest, the chosen ones.)
    fn parted(self, chosen: impl Fn(usize) -> bool) -> (Self, Self) {
        let none = || Self { objects: vec![], names: vec![], origins: vec![] };
        let (mut rest, mut taken) = (none(), none());
        let all = self.objects.into_iter().zip(self.names).zip(self.origins);
        for (place, ((object, name), origin)) in all.enumerate() {
            let pool = if chosen(place) { &mut taken } else { &mut rest };
            pool.objects.push(object);
            pool.names.push(name);
            pool.origins.push(origin);
        }
        (rest, taken)
    }

    /// How many there are (at least one, when loaded).
    #[must_use]
    #[allow(clippy::len_without_is_empty)] // a pool that was loaded is never empty
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// The object at a place.
    ///
    /// # Panics
    /// When the place is not below [`ObjectPool::len`].
    #[must_use]
    pub fn at(&self, place: usize) -> &Arc<Object> {
        &self.objects[place]
    }

    /// All of them, by place.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Object>> {
        self.objects.iter()
    }

    /// Where they come from, by place.
    #[must_use]
    pub fn origins(&self) -> &[Origin] {
        &self.origins
    }

    /// Their names, by place.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }
}

/// Directions in which a mesh's own occlusion is looked for.
const DIRECTIONS: usize = 48;

/// The object with the openness of its mesh.
pub(super) fn with_openness(object: Object) -> Object {
    let openness = openness(&object.mesh, DIRECTIONS);
    Object { mesh: Arc::new(Mesh { openness, ..Mesh::clone(&object.mesh) }), ..object }
}
