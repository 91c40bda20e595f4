//! The rules of the house over `cargo metadata`: who may depend on whom (docs/architecture.md, "The house").

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Members of the workspace with the names of what they depend on, tests and build scripts left out.
fn members() -> BTreeMap<String, BTreeSet<String>> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let name = |value: &Value| value["name"].as_str().expect("names are strings").to_owned();
    let packages = metadata["packages"].as_array().expect("packages");
    let of = |package: &Value| {
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        dependencies.iter().filter(|d| d["kind"].is_null()).map(name).collect()
    };
    packages.iter().map(|package| (name(package), of(package))).collect()
}

const NODES: [&str; 11] = [
    "pseudoflow-player",
    "pseudoflow-bridge",
    "pseudoflow-initializer",
    "pseudoflow-tracker",
    "pseudoflow-renderer",
    "pseudoflow-flow",
    "pseudoflow-consistency",
    "pseudoflow-pnp",
    "pseudoflow-trainer",
    "pseudoflow-evaluator",
    "pseudoflow-recorder",
];
const SHARED: [&str; 16] = [
    "pseudoflow-msgs",
    "pseudoflow-files",
    "pseudoflow-geometry",
    "pseudoflow-imaging",
    "pseudoflow-network",
    "pseudoflow-learning",
    "pseudoflow-synthetic",
    "pseudoflow-pretraining",
    "pseudoflow-inference",
    "pseudoflow-contour",
    "pseudoflow-solver",
    "pseudoflow-tracking",
    "pseudoflow-metrics",
    "pseudoflow-edge",
    "pseudoflow-runtime",
    "pseudoflow-bag",
];

fn users_of(package: &str) -> BTreeSet<String> {
    members().into_iter().filter(|(_, of)| of.contains(package)).map(|(name, _)| name).collect()
}

#[test]
fn every_crate_is_a_node_shared_or_the_cli() {
    let known: BTreeSet<String> =
        NODES.into_iter().chain(SHARED).chain(["pseudoflow", "pseudoflow-tests"]).map(String::from).collect();
    assert_eq!(members().into_keys().collect::<BTreeSet<_>>(), known, "a new crate needs its place in these rules");
}

#[test]
fn nodes_do_not_know_each_other() {
    for (name, dependencies) in members() {
        if name == "pseudoflow" {
            continue;
        }
        let nodes: Vec<_> = NODES.iter().filter(|node| dependencies.contains(**node)).collect();
        assert!(nodes.is_empty(), "{name} depends on the nodes {nodes:?}: only the cli may");
    }
}

#[test]
fn middleware_has_its_places() {
    for (package, place) in
        [("iceoryx2", "pseudoflow-runtime"), ("mcap", "pseudoflow-bag"), ("ros2-client", "pseudoflow-bridge")]
    {
        assert_eq!(users_of(package), BTreeSet::from([place.to_owned()]), "{package} belongs to {place} alone");
    }
}

#[test]
fn ground_truth_stays_with_those_who_score() {
    let allowed: BTreeSet<String> =
        ["pseudoflow-player", "pseudoflow-evaluator", "pseudoflow"].map(String::from).into();
    let users = users_of("pseudoflow-metrics");
    assert!(users.is_subset(&allowed), "{users:?} can name ground truth; only {allowed:?} may");
    for path in ["pseudoflow-trainer", "pseudoflow-pnp", "pseudoflow-flow", "pseudoflow-renderer"] {
        assert!(!users.contains(path));
    }
}

#[test]
fn training_engines_stay_with_learning() {
    let allowed: BTreeSet<String> = ["pseudoflow-learning"].map(String::from).into();
    for engine in ["burn", "burn-flex"] {
        let users = users_of(engine);
        assert!(users.is_subset(&allowed), "{engine} is used by {users:?}");
    }
}
