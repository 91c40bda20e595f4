//! Which files make a bag.

use super::BagError;
use super::metadata::{self, METADATA_FILE};
use super::writer::split_number;
use std::path::{Path, PathBuf};

/// The files of a bag in their order: those that `metadata.yaml` lists, else all by their number.
pub(super) fn files_of(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let metadata_path = path.join(METADATA_FILE);
    if !metadata_path.is_file() {
        return mcap_files(path);
    }
    let information = metadata::read(&metadata_path)?;
    let listed: Vec<PathBuf> = information
        .relative_file_paths
        .iter()
        .filter_map(|file| Some(path.join(Path::new(file).file_name()?)))
        .collect();
    match listed.iter().find(|file| !file.is_file()) {
        Some(missing) => Err(BagError::Metadata {
            path: metadata_path,
            cause: format!("field `relative_file_paths` names {}, which does not exist", missing.display()),
        }),
        None if listed.is_empty() => Err(BagError::NoFiles { path: path.to_owned() }),
        None => Ok(listed),
    }
}

/// The .mcap files of a directory by their split number.
pub(super) fn mcap_files(directory: &Path) -> Result<Vec<PathBuf>, BagError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(directory).map_err(BagError::io(directory))? {
        let path = entry.map_err(BagError::io(directory))?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(BagError::NoFiles { path: directory.to_owned() });
    }
    files.sort_by_key(|path| (split_number(path), path.clone()));
    Ok(files)
}
