//! Files that come with the program (graphs, weights, objects, the demo's recording), found from any working directory.
//!
//! A path that begins with `config/` or `bags/` and names nothing in the working directory is looked for in one folder: that
//! of `PSEUDOFLOW_SHARE`, else `share/pseudoflow` beside the binary's folder (as packages and `colcon` lay files out), else
//! `pseudoflow` in the data folders of the user and of the system (`XDG_DATA_HOME`, `XDG_DATA_DIRS`), else the copy that the
//! binary carries, which is unpacked into the user's cache folder once.

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

/// Why no folder with shipped files could be had.
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
/// The path names a shipped file, and no place has shipped files.
pub fn find(path: &Path) -> Result<PathBuf, NoShippedFiles> {
    let folder = path.components().next();
    let is_shipped = FOLDERS.iter().any(|name| folder == Some(Component::Normal(name.as_ref())));
    if !is_shipped || path.exists() {
        return Ok(path.to_owned());
    }
    let there = root()?.join(path);
    Ok(if there.exists() { there } else { path.to_owned() })
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

/// The folder that holds `config` and `bags`, chosen once.
fn root() -> Result<&'static Path, NoShippedFiles> {
    static ROOT: OnceLock<Result<PathBuf, NoShippedFiles>> = OnceLock::new();
    let choice = ROOT.get_or_init(|| {
        let places = Places { variable: &|name| std::env::var_os(name), binary: std::env::current_exe().ok() };
        let chosen = places.choose(CARRIED.get().copied()).map_err(NoShippedFiles)?;
        log::info!("shipped files: {}", chosen.display());
        Ok(chosen)
    });
    choice.as_deref().map_err(Clone::clone)
}

/// Where shipped files may be.
struct Places<'a> {
    /// Reads the environment.
    variable: &'a dyn Fn(&str) -> Option<OsString>,
    /// The file of the running program.
    binary: Option<PathBuf>,
}

impl Places<'_> {
    /// The first folder that holds shipped files.
    fn choose(&self, carried: Option<Unpack>) -> Result<PathBuf, String> {
        if let Some(folder) = (self.variable)(VARIABLE) {
            let folder = PathBuf::from(folder);
            let missing = || format!("{VARIABLE}={}: there is no folder `config` in it", folder.display());
            return if holds(&folder) { Ok(folder) } else { Err(missing()) };
        }
        let places: Vec<_> = self.beside_the_binary().into_iter().chain(self.data_folders()).collect();
        if let Some(folder) = places.iter().find(|folder| holds(folder)) {
            return Ok(folder.clone());
        }
        let unpack = carried.ok_or_else(|| nowhere(&places))?;
        let cache = self.user_folder("XDG_CACHE_HOME", ".cache").unwrap_or_else(std::env::temp_dir);
        unpack(&cache.join("pseudoflow"))
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

fn holds(folder: &Path) -> bool {
    folder.join("config").is_dir()
}

fn nowhere(places: &[PathBuf]) -> String {
    let places: Vec<_> = places.iter().map(|place| place.display().to_string()).collect();
    format!(
        "the files that come with pseudoflow (config, bags) are in none of {}: copy them there, name their folder in {VARIABLE}, or \
         build with the feature `embed`",
        places.join(", ")
    )
}

#[cfg(test)]
mod tests;
