//! Files that come with the program (graphs, weights, objects, the demo's recording), found from any working directory.
//!
//! A path that begins with `config/` or `bags/` and names nothing in the working directory is looked for in the folder of
//! `PSEUDOFLOW_SHARE` where that is set; else in `share/pseudoflow` beside the binary's folder (as packages and `colcon` lay files
//! out), in `pseudoflow` of the data folders of the user and of the system (`XDG_DATA_HOME`, `XDG_DATA_DIRS`), and last in the
//! copy that the binary carries, which is unpacked into the user's cache folder once.

use crate::Graph;
use serde_yaml::Value;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};
use std::sync::OnceLock;

/// Folders of the repository whose files belong to the program.
const FOLDERS: [&str; 2] = ["config", "bags"];

/// Names the folder of the shipped files, before all others.
const VARIABLE: &str = "PSEUDOFLOW_SHARE";

/// Writes the files that a binary carries below the given cache folder, unless an earlier run did so, and says where.
pub type Unpack = fn(&Path) -> Result<PathBuf, String>;

static CARRIED: OnceLock<Unpack> = OnceLock::new();

/// Why shipped files could not be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NoShippedFiles(String);

/// Says at the start of a binary that it carries the shipped files. The first call counts.
pub fn carry(unpack: Unpack) {
    // A second call would say the same.
    let _ = CARRIED.set(unpack);
}

/// A path that is read: a shipped file's where the working directory has none of that name. Any other path stays as it is, and
/// so does one that no place has: the message about it then names what the user wrote.
///
/// # Errors
/// The path names a shipped file, and `PSEUDOFLOW_SHARE` names no folder of shipped files, or the carried ones cannot be unpacked.
pub fn find(path: &Path) -> Result<PathBuf, NoShippedFiles> {
    let folder = path.components().next();
    let is_shipped = FOLDERS.iter().any(|name| folder == Some(Component::Normal(name.as_ref())));
    if !is_shipped || path.exists() {
        return Ok(path.to_owned());
    }
    let places = Places { variable: &|name| std::env::var_os(name), binary: std::env::current_exe().ok() };
    let found = places.find(path, CARRIED.get().copied()).map_err(NoShippedFiles)?;
    if let Some(found) = &found {
        log::debug!("{}: {}", path.display(), found.display());
    }
    Ok(found.unwrap_or_else(|| path.to_owned()))
}

/// [`find`] for a parser of arguments.
///
/// # Errors
/// As [`find`].
pub fn input(text: &str) -> Result<PathBuf, NoShippedFiles> {
    find(Path::new(text))
}

/// [`find`] for all paths in the settings of a graph's nodes and in its parameters.
///
/// # Errors
/// As [`find`].
pub fn fill_in(graph: &mut Graph) -> Result<(), NoShippedFiles> {
    let settings = graph.nodes.values_mut().map(|node| &mut node.config);
    settings.chain(graph.params.values_mut()).try_for_each(fill_in_value)
}

fn fill_in_value(value: &mut Value) -> Result<(), NoShippedFiles> {
    match value {
        Value::String(text) => {
            let path = find(Path::new(text.as_str()))?;
            if path != Path::new(text.as_str()) {
                *text = path.display().to_string();
            }
            Ok(())
        }
        Value::Sequence(items) => items.iter_mut().try_for_each(fill_in_value),
        Value::Mapping(entries) => entries.iter_mut().map(|(_, value)| value).try_for_each(fill_in_value),
        _ => Ok(()),
    }
}

/// Where shipped files may be.
struct Places<'a> {
    /// Reads the environment.
    variable: &'a dyn Fn(&str) -> Option<OsString>,
    /// The file of the running program.
    binary: Option<PathBuf>,
}

impl Places<'_> {
    /// The shipped file of this name in the first place that has it.
    fn find(&self, path: &Path, carried: Option<Unpack>) -> Result<Option<PathBuf>, String> {
        let in_folder = |folder: &Path| Some(folder.join(path)).filter(|there| there.exists());
        if let Some(folder) = (self.variable)(VARIABLE) {
            let folder = PathBuf::from(folder);
            let missing = || format!("{VARIABLE}={}: there is no folder `config` in it", folder.display());
            return if folder.join("config").is_dir() { Ok(in_folder(&folder)) } else { Err(missing()) };
        }
        let places = self.beside_the_binary().into_iter().chain(self.data_folders());
        let installed = places.filter_map(|folder| in_folder(&folder)).next();
        match (installed, carried) {
            (None, Some(unpack)) => {
                let cache = self.user_folder("XDG_CACHE_HOME", ".cache").unwrap_or_else(std::env::temp_dir);
                Ok(in_folder(&unpack(&cache.join("pseudoflow"))?))
            }
            (installed, _) => Ok(installed),
        }
    }

    /// `bin/pseudoflow` has its files in `share/pseudoflow`; so has `lib/pseudoflow/pseudoflow`, as ROS lays packages out.
    fn beside_the_binary(&self) -> Vec<PathBuf> {
        let prefixes = self.binary.iter().flat_map(|binary| binary.ancestors().skip(2).take(2));
        prefixes.map(|prefix| prefix.join("share/pseudoflow")).collect()
    }

    /// `pseudoflow` in the data folders of the XDG Base Directory Specification.
    fn data_folders(&self) -> Vec<PathBuf> {
        let system = (self.variable)("XDG_DATA_DIRS").filter(|list| !list.is_empty());
        let system = system.unwrap_or_else(|| "/usr/local/share:/usr/share".into());
        let home = self.user_folder("XDG_DATA_HOME", ".local/share");
        home.into_iter().chain(std::env::split_paths(&system)).map(|folder| folder.join("pseudoflow")).collect()
    }

    /// A folder of the user: what the variable says, or its default below the home folder.
    fn user_folder(&self, name: &str, default: &str) -> Option<PathBuf> {
        let stated = (self.variable)(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
        stated.or_else(|| Some(PathBuf::from((self.variable)("HOME")?).join(default)))
    }
}

#[cfg(test)]
mod tests;
