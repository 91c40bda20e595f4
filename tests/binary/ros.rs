//! Started as ROS 2 starts things: what reaches nothing is one line and the run goes on; what cannot work is refused with the reason.

mod common;

use pseudoflow_bag::BagReader;
use std::path::Path;
use std::process::{Command, Output};

/// Two frames go from a recording to ROS 2, with nothing computed in between.
fn graph(folder: &Path) -> String {
    let path = folder.join("graph.yaml");
    let text = "mode: replay\nnodes:\n  player:\n    kind: player\n    config: {source: bags/tabletop_demo, max_frames: 2, initial_poses: {topic: /initial_poses}}\n  \
                bridge:\n    kind: bridge\n    inputs: {frame: player/frame, poses: player/initial_poses}\n    config: {objects: config/objects/tabletop}\n";
    std::fs::write(&path, text).expect("it can be written");
    path.display().to_string()
}

/// The command `pseudoflow run` of that graph.
fn run(folder: &Path) -> Command {
    let mut command = common::pseudoflow();
    command.args(["run", &graph(folder), "--out", &folder.join("run").display().to_string()]);
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn assert_said_once(output: &Output, lines: &[&str]) {
    let said = said(output);
    assert!(output.status.success(), "{said}");
    for line in lines {
        assert_eq!(said.matches(line).count(), 1, "`{line}` in: {said}");
    }
}

#[test]
fn ros_arguments_that_reach_nothing_are_one_line_each() {
    let folder = tempfile::tempdir().expect("a folder");
    let others = folder.path().join("others.yaml");
    std::fs::write(&others, "/somebody/else:\n  ros__parameters: {window: 99}\n").expect("it can be written");
    let output = run(folder.path())
        .args(["--ros-args", "-r", "never:=ever", "-r", "nobody:object_pose:=cup", "-r", "__what:=x", "--params-file"])
        .arg(&others)
        .args(["-p", "qos_overrides./never.publisher.depth:=3", "--enclave", "/secret"])
        .output()
        .expect("it starts");
    let lines = [
        "remapping /never:=/ever matches no topic of this node",
        "no node is called `nobody`",
        "-r __what:=x: matches nothing",
        "others.yaml: no parameters for /pseudoflow",
        "qos_overrides./never matches no topic of this node",
        "--enclave /secret: does nothing here",
    ];
    assert_said_once(&output, &lines);
}

#[test]
fn what_of_the_environment_is_not_honoured_is_named_and_new_releases_are_no_error() {
    let folder = tempfile::tempdir().expect("a folder");
    let names = ["ROS_STATIC_PEERS", "CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER"];
    let output = run(folder.path()).envs(names.map(|name| (name, "x"))).env("ROS_DISTRO", "lyrical").output();
    let output = output.expect("it starts");
    assert_said_once(&output, &names.map(|name| format!("{name} is not honoured")).each_ref().map(String::as_str));
    let said = said(&output);
    assert!(!said.contains("lyrical") && !said.contains(" ERROR "), "{said}");
}

#[test]
fn a_middleware_that_cannot_hear_dds_is_refused_unless_that_is_wanted() {
    let folder = tempfile::tempdir().expect("a folder");
    let zenoh = || {
        let mut command = run(folder.path());
        command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
        command
    };
    let refused = zenoh().output().expect("it starts");
    let reason = said(&refused);
    assert!(!refused.status.success() && !reason.contains("panicked"), "{reason}");
    for word in ["rmw_zenoh_cpp", "DDS", "--allow-rmw-mismatch"] {
        assert!(reason.contains(word), "`{word}` is missing in: {reason}");
    }
    let allowed = zenoh().arg("--allow-rmw-mismatch").output().expect("it starts");
    assert_said_once(&allowed, &["its nodes do not hear DDS"]);
}

/// Records what `source` gives as poses on `topic`; the messages of `/object_poses` then.
fn recorded(source: &Path, topic: &str, folder: &Path) -> Vec<Vec<u8>> {
    let (graph, bag) = (folder.with_extension("yaml"), folder.join("bag"));
    let text = format!(
        "mode: replay\nnodes:\n  player:\n    kind: player\n    config: {{source: {source}, objects: config/objects/tabletop, max_frames: 2, \
         initial_poses: {{topic: {topic}}}}}\n  recorder:\n    kind: recorder\n    inputs: {{frame: player/frame, poses: player/initial_poses}}\n    \
         config: {{path: {bag}, objects: config/objects/tabletop}}\n",
        source = source.display(),
        bag = bag.display()
    );
    std::fs::write(&graph, text).expect("it can be written");
    let (graph, out) = (graph.display().to_string(), folder.join("run").display().to_string());
    let output = common::run(&["run", &graph, "--out", &out, "--in-process"]);
    assert!(output.status.success(), "{}", said(&output));
    let mut messages = Vec::new();
    BagReader::open_visiting(&bag, &mut |visited| {
        if visited.topic.name == "/object_poses" {
            messages.push(visited.message.data.to_vec());
        }
        Ok(())
    })
    .expect("the recording is whole");
    messages
}

#[test]
fn poses_of_one_run_are_initial_poses_of_the_next_by_name_and_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = folder.path().join("first");
    let poses = recorded(&common::root().join("bags/tabletop_demo"), "/initial_poses", &first);
    let names = |bytes: &[u8]| bytes.windows(11).any(|word| word == b"cracker_box");
    assert!(poses.len() == 2 && poses.iter().all(|message| names(message)), "{} messages", poses.len());
    assert!(recorded(&first.join("bag"), "/object_poses", &folder.path().join("second")) == poses);
}
