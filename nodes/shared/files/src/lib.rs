//! Files that appear whole or not at all: nothing that was recorded or learned is half there after a crash.
//!
//! Begin with [`write()`]; [`write_private`] for what shows somebody's room.
//!
//! ```
//! # let folder = tempfile::tempdir()?;
//! let file = folder.path().join("weights.safetensors");
//! pseudoflow_files::write(&file, b"learned")?;
//! assert_eq!(std::fs::read(&file)?, b"learned");
//! # std::io::Result::Ok(())
//! ```

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{Result, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

/// Rights of private folders: images are.
const FOLDER_RIGHTS: u32 = 0o700;
/// Rights of private files.
const PRIVATE_RIGHTS: u32 = 0o600;
/// Rights of other files, less what the user's mask takes.
const RIGHTS: u32 = 0o666;

/// Writes a file beside its place, waits until the disk has it, and renames it: readers meet the old one or the whole
/// new one, also after a power failure.
///
/// # Errors
/// The system's; nothing is left beside then.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes, RIGHTS)
}

/// As [`write()`], readable by its owner alone.
///
/// # Errors
/// As [`write()`].
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes, PRIVATE_RIGHTS)
}

fn replace(path: &Path, bytes: &[u8], rights: u32) -> Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let beside = path.with_file_name(format!(".{name}.part-{}", std::process::id()));
    let written = write_through(&beside, bytes, rights).and_then(|()| std::fs::rename(&beside, path));
    if written.is_err() {
        let _ = std::fs::remove_file(&beside);
    }
    written?;
    // The name itself: file systems that cannot sync a folder keep it their own way.
    let _ = path
        .parent()
        .map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
        .map(File::open)
        .map(|folder| folder?.sync_all());
    Ok(())
}

fn write_through(path: &Path, bytes: &[u8], rights: u32) -> Result<()> {
    let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(rights).open(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Makes a folder, with those above it, that only its owner can enter. One that is there stays as it is.
///
/// # Errors
/// The system's.
pub fn private_folder(path: &Path) -> Result<()> {
    DirBuilder::new().recursive(true).mode(FOLDER_RIGHTS).create(path)
}

/// Makes a file, which must not exist, that only its owner can read.
///
/// # Errors
/// The system's.
pub fn create_private(path: &Path) -> Result<File> {
    OpenOptions::new().write(true).create_new(true).mode(PRIVATE_RIGHTS).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_file_is_replaced_whole_and_for_its_owner_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        std::fs::write(&path, "old and longer").unwrap();
        write_private(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside");
        let place = folder.path().join("taken");
        std::fs::create_dir(&place).unwrap();
        assert!(write(&place, b"x").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn folders_keep_others_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b");
        private_folder(&path).unwrap();
        private_folder(&path).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o700);
    }
}
