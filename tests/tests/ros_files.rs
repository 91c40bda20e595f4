//! What other tools of ROS 2 read of this repository: package.xml, launch files, rviz's configuration. Every file, setting,
//! topic and type that they name exists.

use pseudoflow_bridge::{BridgeConfig, Direction, topics};
use serde_yaml::Value;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn yaml(path: &str) -> Value {
    let text = std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
    serde_yaml::from_str(&text).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The type of a topic that we publish.
fn published(name: &str) -> Option<String> {
    let named = |topic: &str| topic.trim_start_matches('/').to_owned();
    let all = topics().into_iter().filter(|topic| topic.direction == Direction::Out);
    all.filter(|topic| named(topic.name) == named(name)).map(|topic| topic.message).next()
}

#[test]
fn launch_files_start_graphs_that_exist_with_settings_that_exist() {
    for file in ["launch/track.launch.yaml", "launch/refine.launch.yaml"] {
        let launch = yaml(file);
        let entries = launch["launch"].as_sequence().unwrap();
        let arguments: Vec<&str> = entries.iter().filter_map(|entry| entry["arg"]["name"].as_str()).collect();
        let node = entries.iter().find_map(|entry| entry.get("node")).unwrap();
        assert_eq!((node["pkg"].as_str(), node["exec"].as_str()), (Some("pseudoflow"), Some("pseudoflow")));
        let text = serde_yaml::to_string(node).unwrap();
        for part in text.split("$(var ").skip(1) {
            let name = part.split(')').next().unwrap();
            assert!(arguments.contains(&name), "{file}: no argument is called `{name}`");
        }
        let words: Vec<&str> = node["args"].as_str().unwrap().split_whitespace().collect();
        assert_eq!((words[0], words[2]), ("run", "--out"), "{file}");
        let graph = yaml(words[1]);
        for param in node["param"].as_sequence().unwrap() {
            let name = param["name"].as_str().unwrap();
            if graph["params"].get(name).is_some() {
                continue;
            }
            let (first, rest) = name.split_once('.').unwrap();
            let known = graph["nodes"].get(first).is_some_and(|node| node["config"].get(rest).is_some());
            let of_bridge = serde_json::to_value(schemars::schema_for!(BridgeConfig)).unwrap();
            assert!(
                known || of_bridge["properties"].get(first).is_some(),
                "{file}: `{name}` is no setting of {}",
                words[1]
            );
        }
    }
}

#[test]
fn rviz_shows_topics_that_exist_with_the_types_that_they_have() {
    let config = yaml("rviz/pseudoflow.rviz");
    let displays = config["Visualization Manager"]["Displays"].as_sequence().unwrap().clone();
    let types = [
        ("RobotModel", "std_msgs/String"),
        ("Pose", "geometry_msgs/PoseStamped"),
        ("PoseWithCovariance", "geometry_msgs/PoseWithCovarianceStamped"),
        ("Detection3DArray", "vision_msgs/Detection3DArray"),
    ];
    let mut shown = 0;
    for display in &displays {
        let class = display["Class"].as_str().unwrap().rsplit('/').next().unwrap();
        let topic = ["Topic", "Description Topic"].iter().find_map(|key| display.get(*key)?["Value"].as_str());
        match (class, topic) {
            ("TF", None) => assert!(published("/tf").is_some()),
            ("Image", Some(topic)) => assert_eq!(topic, "/camera/image_raw"),
            (class, Some(topic)) => {
                let (_, wanted) = types.iter().find(|(name, _)| *name == class).unwrap_or_else(|| panic!("{class}?"));
                assert_eq!(published(topic).as_deref(), Some(*wanted), "{topic}");
            }
            (class, None) => panic!("{class} has no topic"),
        }
        shown += 1;
    }
    assert_eq!(shown, 5);
}

#[test]
fn the_package_is_the_binary_and_names_what_it_speaks() {
    let package = std::fs::read_to_string(root().join("nodes/cli/package.xml")).unwrap();
    let manifest = std::fs::read_to_string(root().join("nodes/cli/Cargo.toml")).unwrap();
    assert!(package.contains("<name>pseudoflow</name>") && manifest.contains("name = \"pseudoflow\""));
    assert!(package.contains("<build_type>ament_cargo</build_type>"));
    for topic in topics() {
        let depends = format!("<exec_depend>{}</exec_depend>", topic.message.split('/').next().unwrap());
        assert!(package.contains(&depends), "package.xml lacks {depends}");
    }
}

/// Of `cargo metadata`: the table `[package.metadata.deb]` of the binary's package.
fn deb() -> serde_json::Value {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = std::process::Command::new(cargo);
    command.args(["metadata", "--format-version", "1", "--no-deps", "--offline"]).current_dir(root());
    let metadata: serde_json::Value = serde_json::from_slice(&command.output().unwrap().stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    packages.iter().find(|package| package["name"] == "pseudoflow").unwrap()["metadata"]["deb"].clone()
}

#[test]
fn what_the_debian_package_holds_exists() {
    let deb = deb();
    let sources: Vec<&str> = deb["assets"].as_array().unwrap().iter().map(|asset| asset[0].as_str().unwrap()).collect();
    assert!(sources.len() > 5, "{sources:?}");
    for source in sources.into_iter().filter(|source| !source.starts_with("target/")) {
        // The last part may be a pattern: its folder holds files that begin as it does.
        let (folder, pattern) = source.trim_end_matches("/**/*").rsplit_once('/').unwrap();
        let begin = pattern.trim_end_matches('*');
        let folder = root().join("nodes/cli").join(folder);
        let mut entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{source}: {error}")).flatten();
        assert!(entries.any(|entry| entry.file_name().to_string_lossy().starts_with(begin)), "{source}: no file");
    }
}
