//! The shipped files inside the binary (feature `embed`).

use include_dir::{Dir, include_dir};
use std::path::{Path, PathBuf};

static CONFIG: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../config");
static BAGS: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../bags");

/// Differs between builds whose files differ (build.rs).
const FINGERPRINT: &str = env!("PSEUDOFLOW_SHIPPED_FINGERPRINT");

/// Lets paths of shipped files lead to those that this binary carries where no folder has them.
pub fn carry() {
    pseudoflow_runtime::shipped::carry(unpack);
}

/// The folder with the files, unpacked below `cache` unless an earlier run did so.
///
/// # Errors
/// The folder cannot be written.
fn unpack(cache: &Path) -> Result<PathBuf, String> {
    let folder = cache.join(format!("shipped-{FINGERPRINT}"));
    if folder.is_dir() {
        return Ok(folder);
    }
    let beside = cache.join(format!("shipped-{FINGERPRINT}.{}", std::process::id()));
    write(&beside).map_err(|error| {
        format!(
            "{}: the files that come with pseudoflow cannot be unpacked: {error}: free 40 MB, or set XDG_CACHE_HOME",
            beside.display()
        )
    })?;
    match std::fs::rename(&beside, &folder) {
        Ok(()) => log::info!("unpacked {} for this and later runs", folder.display()),
        // Another process was faster; its files are the same.
        Err(_) if folder.is_dir() => drop(std::fs::remove_dir_all(&beside)),
        Err(error) => return Err(format!("{}: {error}", folder.display())),
    }
    Ok(folder)
}

fn write(folder: &Path) -> std::io::Result<()> {
    for (name, files) in [("config", &CONFIG), ("bags", &BAGS)] {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder)?;
        files.extract(&folder)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_unpacked_once_and_whole() {
        let tmp = tempfile::tempdir().unwrap();
        let folder = unpack(tmp.path()).unwrap();
        let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for file in ["config/graphs/demo.yaml", "config/weights/refiner.safetensors", "bags/README.md"] {
            assert_eq!(
                std::fs::read(folder.join(file)).unwrap(),
                std::fs::read(repository.join(file)).unwrap(),
                "{file}"
            );
        }
        let mark = folder.join("config/mark");
        std::fs::write(&mark, "").unwrap();
        assert_eq!(unpack(tmp.path()).unwrap(), folder);
        assert!(mark.exists(), "the second run unpacked again");
    }

    #[test]
    fn a_cache_that_cannot_be_written_is_named() {
        let tmp = tempfile::tempdir().unwrap();
        let file = tmp.path().join("file");
        std::fs::write(&file, "").unwrap();
        let message = unpack(&file).unwrap_err();
        assert!(message.contains("file") && message.contains("XDG_CACHE_HOME"), "{message}");
    }
}
