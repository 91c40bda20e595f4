use super::{BagError, bag_name};
use std::path::{Path, PathBuf};

/// A directory that is written beside its place and appears there whole or not at all: dropped before
/// [`Partial::keep`], it is removed.
#[derive(Debug)]
pub struct Partial {
    beside: PathBuf,
    place: PathBuf,
    kept: bool,
}

impl Partial {
    /// Makes an empty directory beside `place`.
    ///
    /// # Errors
    /// When `place` exists or the directory cannot be made.
    pub fn directory(place: &Path) -> Result<Self, BagError> {
        if place.exists() {
            return Err(BagError::Exists { path: place.to_owned() });
        }
        let beside = place.with_file_name(format!(".{}.partial-{}", bag_name(place)?, std::process::id()));
        if beside.exists() {
            std::fs::remove_dir_all(&beside).map_err(BagError::io(&beside))?;
        }
        pseudoflow_files::private_folder(&beside).map_err(BagError::io(&beside))?;
        Ok(Self { beside, place: place.to_owned(), kept: false })
    }

    /// Where to write meanwhile.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.beside
    }

    /// Moves the directory to its place.
    ///
    /// # Errors
    /// When it cannot be moved.
    pub fn keep(mut self) -> Result<(), BagError> {
        std::fs::rename(&self.beside, &self.place).map_err(BagError::io(&self.place))?;
        self.kept = true;
        Ok(())
    }

    /// Moves what was written under `inner`, in this directory, to its place; the rest is removed.
    ///
    /// # Errors
    /// When it cannot be moved.
    pub fn keep_inner(self, inner: &Path) -> Result<(), BagError> {
        std::fs::rename(inner, &self.place).map_err(BagError::io(&self.place))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.kept {
            let _ = std::fs::remove_dir_all(&self.beside);
        }
    }
}
