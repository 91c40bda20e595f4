//! Every example of `nodes/cli/examples` does what it says, and every library has one of its own.
#![allow(dead_code, reason = "the examples' own `main` is not called")]

mod common;

#[path = "../../nodes/cli/examples/read_poses.rs"]
mod read_poses;
#[path = "../../nodes/cli/examples/refine_by_contour.rs"]
mod refine_by_contour;
#[path = "../../nodes/cli/examples/render_views.rs"]
mod render_views;
#[path = "../../nodes/cli/examples/solve_pnp.rs"]
mod solve_pnp;
#[path = "../../nodes/cli/examples/write_a_node.rs"]
mod write_a_node;

use common::root;
use nalgebra::Vector3;
use pseudoflow_geometry::{Pose, rotation_angle_rad};
use pseudoflow_metrics::{SceneTruth, read_results};
use std::path::{Path, PathBuf};

#[test]
fn a_node_of_ones_own_lets_through_what_is_within_reach() {
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("reach_tabletop-test.csv");
    assert_eq!(write_a_node::run(&root().join("bags/tabletop_demo"), &csv).expect("it runs"), 15);
    let kept = read_results(&csv, None).expect("poses");
    let all = read_poses::poses(&root().join("bags/tabletop_demo"), "/initial_poses").expect("poses");
    let distance_m = |p: &[f64; 3]| Vector3::from(*p).norm();
    let near = all.iter().filter(|seen| distance_m(&seen.position_m) <= 0.8).count();
    assert!(near > 0 && near < all.len(), "{near} of {}: the reach parts nothing", all.len());
    assert_eq!(kept.len(), near);
}

#[test]
fn the_pose_of_correspondences_is_found_among_wrong_ones() {
    let truth = Pose::new(Vector3::new(0.05, -0.02, 0.7), Vector3::new(0.4, -0.9, 0.2));
    let far = Pose::translation(0.0, 0.0, 1.5);
    let found = solve_pnp::solve(&solve_pnp::pixels(&truth), &far).expect("good settings");
    assert!(found.status.is_ok() && found.inliers >= 200, "{}", found.status);
    assert!(rotation_angle_rad(&found.camera_from_object, &truth) < 1e-4);
}

#[test]
fn four_views_of_every_object_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = render_views::render(&root().join("config/objects/tabletop"), folder.path()).expect("rendered");
    assert_eq!(files.len(), 4 * 5);
    let picture = pseudoflow_imaging::load_rgb(&files[0]).expect("a picture");
    let colours: std::collections::BTreeSet<[u8; 3]> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() > 1000, "{} colours only", colours.len());
}

#[test]
fn the_contour_alone_brings_a_rough_pose_nearer_to_the_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("refined.png");
    let (rough, region) = refine_by_contour::refine(&root(), 2, &picture).expect("refined");
    assert!(region.status.is_ok() && picture.is_file(), "{}", region.status);
    let truth = SceneTruth::read(&root().join("bags/tabletop_demo_truth")).expect("the truth");
    let first = truth.images.values().next().expect("an image");
    let truth = first.iter().find(|t| t.object_id == 2).expect("the bottle").camera_from_object.pose();
    let shift_m = |pose: &Pose| (pose.translation.vector - truth.translation.vector).norm();
    let turn_rad = |pose: &Pose| rotation_angle_rad(pose, &truth);
    let refined = region.camera_from_object;
    assert!(2.0 * shift_m(&refined) < shift_m(&rough), "{} m, rough {} m", shift_m(&refined), shift_m(&rough));
    assert!(2.0 * turn_rad(&refined) < turn_rad(&rough), "{} rad, rough {} rad", turn_rad(&refined), turn_rad(&rough));
}

#[test]
fn a_recording_gives_its_poses() {
    let seen = read_poses::poses(&root().join("bags/tabletop_demo"), "/initial_poses").expect("poses");
    assert_eq!(seen.len(), 75);
    assert_eq!((seen[0].stamp_ns, seen[0].object.as_str()), (1_000_000_000, "1"));
    let error = read_poses::poses(&root().join("bags/tabletop_demo"), "/nowhere").expect_err("no such topic");
    assert!(error.to_string().contains("/initial_poses"), "{error}");
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn files(folder: &str) -> impl Iterator<Item = PathBuf> {
    std::fs::read_dir(root().join(folder)).expect("a folder").flatten().map(|entry| entry.path())
}

#[test]
fn every_example_is_short_and_listed() {
    let page = text(&root().join("docs/examples.md"));
    for example in files("nodes/cli/examples") {
        let name = example.file_name().and_then(|name| name.to_str()).expect("a name");
        assert!(page.contains(&format!("nodes/cli/examples/{name}")), "docs/examples.md does not know {name}");
        assert!(text(&example).lines().count() < 80, "{name} is too long to be read in one go");
    }
}

#[test]
fn every_library_says_where_to_begin_and_shows_it() {
    let libraries = files("nodes/shared").chain([root().join("msgs")]).map(|folder| folder.join("src/lib.rs"));
    for library in libraries {
        let page: String =
            text(&library).lines().take_while(|line| line.starts_with("//!")).map(|l| format!("{l}\n")).collect();
        assert!(page.contains("//! Begin with "), "{}", library.display());
        let shown = page.contains("//! ```\n") || library.ends_with("msgs/src/lib.rs");
        assert!(shown, "{}: no example on its page", library.display());
    }
}
