use super::*;
use std::collections::HashMap;

/// What [`Places::choose`] finds with these variables for a binary at `binary`.
fn choose(
    variables: &[(&'static str, &Path)],
    binary: Option<PathBuf>,
    carried: Option<Unpack>,
) -> Result<PathBuf, String> {
    let values: HashMap<_, _> = variables.iter().map(|(name, value)| (*name, value.as_os_str().to_owned())).collect();
    Places { variable: &|name| values.get(name).cloned(), binary }.choose(carried)
}

/// A folder with the shipped files' `config`.
fn with_files(folder: &Path) -> PathBuf {
    std::fs::create_dir_all(folder.join("config")).unwrap();
    folder.to_owned()
}

#[test]
fn the_variable_comes_first_and_must_name_a_folder_that_has_the_files() {
    let tmp = tempfile::tempdir().unwrap();
    let stated = with_files(&tmp.path().join("stated"));
    with_files(&tmp.path().join("prefix/share/pseudoflow"));
    let binary = Some(tmp.path().join("prefix/bin/pseudoflow"));
    assert_eq!(choose(&[(VARIABLE, &stated)], binary.clone(), None), Ok(stated));
    let message = choose(&[(VARIABLE, &tmp.path().join("empty"))], binary, None).unwrap_err();
    assert!(message.contains(VARIABLE) && message.contains("empty"), "{message}");
}

#[test]
fn a_package_has_its_files_beside_the_binary() {
    let tmp = tempfile::tempdir().unwrap();
    let share = with_files(&tmp.path().join("share/pseudoflow"));
    for binary in ["bin/pseudoflow", "lib/pseudoflow/pseudoflow"] {
        assert_eq!(choose(&[], Some(tmp.path().join(binary)), None), Ok(share.clone()), "{binary}");
    }
}

#[test]
fn the_users_data_folder_comes_before_the_systems() {
    let tmp = tempfile::tempdir().unwrap();
    let shares = tmp.path().join("usr/share");
    let system = with_files(&shares.join("pseudoflow"));
    let home = tmp.path().join("home");
    let variables = [("HOME", home.as_path()), ("XDG_DATA_DIRS", &shares)];
    assert_eq!(choose(&variables, None, None), Ok(system));
    let own = with_files(&home.join(".local/share/pseudoflow"));
    assert_eq!(choose(&variables, None, None), Ok(own));
}

#[test]
fn what_the_binary_carries_comes_last_and_without_it_the_places_are_listed() {
    let tmp = tempfile::tempdir().unwrap();
    let variables = [("XDG_CACHE_HOME", tmp.path()), ("XDG_DATA_DIRS", tmp.path())];
    let unpacked = choose(&variables, None, Some(|cache| Ok(cache.join("carried"))));
    assert_eq!(unpacked, Ok(tmp.path().join("pseudoflow/carried")));
    let message = choose(&variables, None, None).unwrap_err();
    assert!(message.contains(&tmp.path().display().to_string()) && message.contains(VARIABLE), "{message}");
}

#[test]
fn other_paths_of_a_graph_stay_as_they_are_written() {
    let text = "mode: replay\nparams: {weights: my/w.safetensors}\n\
                nodes:\n  a: {kind: flow, config: {model: $weights, more: [/config/file, configs/file, 7]}}\n";
    let mut graph = Graph::parse(text, Path::new("test.yaml")).unwrap();
    let before = graph.to_yaml().unwrap();
    fill_in(&mut graph).unwrap();
    assert_eq!(graph.to_yaml().unwrap(), before);
}
