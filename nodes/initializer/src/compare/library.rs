//! The views of all objects: from disk where they are kept, else made a few at a time.

use super::cache;
use super::encoder::Encoder;
use super::views::{BATCH, View, rotations, views};
use super::{CompareConfig, Preparing};
use crate::InitializerError;
use nalgebra::UnitQuaternion;
use pseudoflow_imaging::raster::Rasteriser;
use pseudoflow_imaging::{Object, ObjectSet};
use std::collections::BTreeMap;
use std::hash::Hasher;
use std::path::PathBuf;

/// What is known of an object.
struct Shelf {
    rotations: Vec<UnitQuaternion<f64>>,
    views: Vec<View>,
    path: PathBuf,
}

impl Shelf {
    fn is_full(&self) -> bool {
        self.views.len() >= self.rotations.len()
    }
}

/// Views by object.
pub(super) struct Library(BTreeMap<u32, Shelf>);

impl Library {
    /// Takes what is kept on disk.
    ///
    /// # Errors
    /// When the weights cannot be read.
    pub(super) fn open(
        config: &CompareConfig,
        objects: &ObjectSet,
        encoder: &Encoder,
    ) -> Result<Self, InitializerError> {
        let folder = config.cache.clone().unwrap_or_else(cache::default_folder);
        let encoder = encoder_key(config, encoder)?;
        let shelf = |object: &Object| {
            let rotations = rotations(object, config);
            let path = cache::path(&folder, cache::key(&object.mesh, object.diameter_m, &rotations, encoder));
            let kept = cache::load(&path).filter(|views| views.len() == rotations.len());
            (object.id, Shelf { rotations, views: kept.unwrap_or_default(), path })
        };
        Ok(Self(objects.iter().map(shelf).collect()))
    }

    /// All views of an object, none before all are there.
    pub(super) fn views(&self, object_id: u32) -> &[View] {
        self.0.get(&object_id).filter(|shelf| shelf.is_full()).map_or(&[], |shelf| &shelf.views)
    }

    /// How many views there are of how many objects.
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.0.values().map(|shelf| shelf.views.len()).sum(), self.0.len())
    }

    /// Objects whose views are not all there, with the share that is.
    pub(super) fn unprepared(&self) -> impl Iterator<Item = Preparing> + '_ {
        let open = self.0.iter().filter(|(_, shelf)| !shelf.is_full());
        open.map(|(id, s)| Preparing { object_id: *id, share: s.views.len() as f64 / s.rotations.len() as f64 })
    }

    /// Renders and encodes a batch of the first object that needs it; `false` when none does.
    ///
    /// # Errors
    /// What renderer and engine say.
    pub(super) fn prepare_some(
        &mut self,
        objects: &ObjectSet,
        rasteriser: &dyn Rasteriser,
        encoder: &mut Encoder,
    ) -> Result<bool, InitializerError> {
        let Some((id, shelf)) = self.0.iter_mut().find(|(_, shelf)| !shelf.is_full()) else { return Ok(false) };
        let object = objects.get(*id)?;
        if shelf.views.is_empty() {
            log::info!("{}: {} views are rendered and encoded", object.name, shelf.rotations.len());
        }
        let next = shelf.views.len()..(shelf.views.len() + BATCH).min(shelf.rotations.len());
        let mut made = views(object, &shelf.rotations[next], None, rasteriser, encoder)?;
        made.iter_mut().for_each(View::round);
        shelf.views.extend(made);
        if shelf.is_full() {
            // Without it the search works as well, and the next start takes longer.
            match cache::keep(&shelf.views, &shelf.path) {
                Ok(()) => log::info!("{}: views are kept in {}", object.name, shelf.path.display()),
                Err(error) => log::warn!("{}: {error}: the views are not kept", shelf.path.display()),
            }
        }
        Ok(true)
    }
}

/// What the features depend on beside the picture: the weights, the size of the crops, and what computes.
fn encoder_key(config: &CompareConfig, encoder: &Encoder) -> Result<u64, InitializerError> {
    let failed = |e: std::io::Error| InitializerError::Model { path: config.model.clone(), cause: e.to_string() };
    let mut hash = cache::Digest::new();
    hash.write(&std::fs::read(&config.model).map_err(failed)?);
    hash.write_u32(encoder.size_px);
    hash.write(encoder.describe().as_bytes());
    Ok(hash.finish())
}
