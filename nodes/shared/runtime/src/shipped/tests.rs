use super::*;
use std::collections::HashMap;

const GRAPH: &str = "config/graphs/demo.yaml";

/// What [`Places::find`] says of the demo's graph, with these variables, for a binary at `binary`.
fn find(
    variables: &[(&'static str, &Path)],
    binary: Option<PathBuf>,
    carried: Option<Unpack>,
) -> Result<Option<PathBuf>, String> {
    let values: HashMap<_, _> = variables.iter().map(|(name, value)| (*name, value.as_os_str().to_owned())).collect();
    Places { variable: &|name| values.get(name).cloned(), binary }.find(Path::new(GRAPH), carried)
}

/// Makes a folder of shipped files; returns the demo's graph in it.
fn with_files(folder: &Path) -> PathBuf {
    let graph = folder.join(GRAPH);
    std::fs::create_dir_all(graph.parent().unwrap()).unwrap();
    std::fs::write(&graph, "").unwrap();
    graph
}

#[test]
fn the_variable_comes_first_and_must_name_a_folder_that_has_the_files() {
    let tmp = tempfile::tempdir().unwrap();
    let stated = tmp.path().join("stated");
    let graph = with_files(&stated);
    with_files(&tmp.path().join("prefix/share/pseudoflow"));
    let binary = Some(tmp.path().join("prefix/bin/pseudoflow"));
    assert_eq!(find(&[(VARIABLE, &stated)], binary.clone(), None), Ok(Some(graph)));
    let message = find(&[(VARIABLE, &tmp.path().join("empty"))], binary, None).unwrap_err();
    assert!(message.contains(VARIABLE) && message.contains("empty"), "{message}");
}

#[test]
fn a_package_has_its_files_beside_the_binary() {
    let tmp = tempfile::tempdir().unwrap();
    let graph = with_files(&tmp.path().join("share/pseudoflow"));
    for binary in ["bin/pseudoflow", "lib/pseudoflow/pseudoflow"] {
        assert_eq!(find(&[], Some(tmp.path().join(binary)), None), Ok(Some(graph.clone())), "{binary}");
    }
}

#[test]
fn the_users_data_folder_comes_before_the_systems() {
    let tmp = tempfile::tempdir().unwrap();
    let shares = tmp.path().join("usr/share");
    let system = with_files(&shares.join("pseudoflow"));
    let home = tmp.path().join("home");
    let variables = [("HOME", home.as_path()), ("XDG_DATA_DIRS", &shares)];
    assert_eq!(find(&variables, None, None), Ok(Some(system)));
    let own = with_files(&home.join(".local/share/pseudoflow"));
    assert_eq!(find(&variables, None, None), Ok(Some(own)));
}

#[test]
fn what_the_binary_carries_comes_last() {
    let tmp = tempfile::tempdir().unwrap();
    let variables = [("XDG_CACHE_HOME", tmp.path()), ("XDG_DATA_DIRS", tmp.path())];
    let unpack: Unpack = |cache| {
        with_files(&cache.join("carried"));
        Ok(cache.join("carried"))
    };
    let carried = tmp.path().join("pseudoflow/carried").join(GRAPH);
    assert_eq!(find(&variables, None, Some(unpack)), Ok(Some(carried)));
    assert_eq!(find(&variables, None, None), Ok(None));
    assert_eq!(find(&variables, None, Some(|_| Err("full".into()))), Err("full".into()));
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
