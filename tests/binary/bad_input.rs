//! What people get wrong: each is one clear error that names file, field and remedy, with a non-zero exit and nothing
//! left behind.

mod common;

use common::run;
use std::path::Path;

/// Runs and returns what was said; fails when the run succeeds.
fn refused(args: &[&str]) -> String {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success(), "{args:?} should fail");
    assert!(!said.contains("panicked"), "{said}");
    said
}

fn assert_says(said: &str, words: &[&str]) {
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in: {said}");
    }
}

fn demo_bag() -> std::path::PathBuf {
    let bag = common::root().join("bags/tabletop_demo");
    std::fs::read_dir(&bag)
        .expect("the demo bag")
        .flatten()
        .map(|e| e.path())
        .find(|p| p.extension().is_some_and(|e| e == "mcap"))
        .expect("its file")
}

fn check_with(setting: &str) -> String {
    refused(&["check", "config/graphs/refine.yaml", "--set", setting])
}

fn play(bag: &Path) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("run");
    let source = format!("player.source={}", bag.display());
    let mut args = vec!["run", "config/graphs/refine.yaml", "--set", &source, "--out", out.to_str().expect("utf-8")];
    let settings = common::into(folder.path());
    args.extend(settings.iter().map(String::as_str));
    refused(&args)
}

#[test]
fn every_graph_that_is_shipped_has_no_problem() {
    let graphs = std::fs::read_dir(common::root().join("config/graphs")).expect("the graphs");
    let graphs: Vec<_> = graphs.flatten().map(|entry| entry.path()).collect();
    assert!(graphs.len() >= 3, "{graphs:?}");
    for graph in graphs {
        let output = run(&["check", graph.to_str().expect("utf-8")]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn parameters_and_nodes_that_a_graph_does_not_have() {
    assert_says(&check_with("size=256"), &["size=256", "a parameter (source", "size_px"]);
    let said = refused(&["check", "config/graphs/refine.yaml", "--without", "judge"]);
    assert_says(&said, &["--without judge", "no such node", "evaluator"]);
    let without =
        run(&["check", "config/graphs/refine.yaml", "--without", "evaluator,recorder", "--set", "size_px=256"]);
    assert!(without.status.success(), "{}", String::from_utf8_lossy(&without.stderr));
    assert!(String::from_utf8_lossy(&without.stdout).contains("5 nodes"));
}

#[test]
fn unknown_keys_and_files_that_are_not_there() {
    assert_says(&check_with("renderer.sise_px=128"), &["renderer", "sise_px"]);
    assert_says(&check_with("flow.model=nowhere.safetensors"), &["flow", "nowhere.safetensors"]);
    assert_says(&check_with("player.source=nowhere"), &["player", "nowhere"]);
    assert_says(&check_with("renderer.objects=bags"), &["renderer", "models_info.json"]);
    assert_says(&check_with("flow.size_px=100"), &["flow", "size_px", "multiple of 8"]);
}

#[test]
fn devices_that_are_not_there_or_no_devices() {
    for (device, words) in [("vulkan:999", "vulkan"), ("cuda:999", "cuda"), ("gpu", "vulkan:N")] {
        let said = refused(&["bench-device", "--device", device]);
        assert_says(&said, &[&format!("`{device}`"), words]);
        let said = refused(&[
            "pretrain",
            "--objects",
            "config/objects/tabletop",
            "--device",
            device,
            "--out",
            "x.safetensors",
        ]);
        assert_says(&said, &[&format!("`{device}`"), words]);
        assert!(!common::root().join("x.run.json").exists(), "nothing is written before the device is open");
    }
    let said = check_with("flow.device=gpu");
    assert_says(&said, &["gpu", "vulkan:N"]);
}

/// Looks at `pretrain`'s pictures for backgrounds, of which it makes a sheet into `folder`.
fn sheet_with(backgrounds: &Path, folder: &Path) -> std::process::Output {
    let path = |name: &str| folder.join(name).to_str().expect("utf-8").to_owned();
    let backgrounds = backgrounds.to_str().expect("utf-8");
    let objects =
        ["pretrain", "--objects", "config/objects/tabletop", "--network", "nano", "--backgrounds", backgrounds];
    let (sheet, out) = (path("sheet.png"), path("w.safetensors"));
    run(&[&objects[..], &["--preview", &sheet, "--out", &out]].concat())
}

#[test]
fn backgrounds_without_pictures() {
    let folder = tempfile::tempdir().expect("a folder");
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).expect("a folder");
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &std::fs::read(demo_bag()).expect("the demo bag")[..3000]).expect("it can be written");
    for (backgrounds, words) in [
        (&empty, ["empty", "no picture"]),
        (&folder.path().join("none"), ["none", "folder"]),
        (&cut, ["cut.mcap", "cut.mcap"]),
    ] {
        let output = sheet_with(backgrounds, folder.path());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && !said.contains("panicked"), "{said}");
        assert_says(&said, &words);
        assert!(!folder.path().join("sheet.png").exists());
    }
}

#[test]
fn a_recording_without_any_annotation_gives_backgrounds() {
    let folder = tempfile::tempdir().expect("a folder");
    for _ in 0..2 {
        // The second time the frames are there.
        let output = sheet_with(&common::root().join("bags/tabletop_demo"), folder.path());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(folder.path().join("sheet.png").is_file());
        let frames = std::fs::read_dir(folder.path().join("w.backgrounds/00")).expect("its frames").count();
        assert!(frames > 3, "{frames}");
    }
}

#[test]
fn damaged_empty_and_foreign_bags() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(demo_bag()).expect("the demo bag");
    let mut flipped = whole.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    for (name, bytes) in [
        ("truncated.mcap", &whole[..whole.len() / 2]),
        ("flipped.mcap", &flipped[..]),
        ("empty.mcap", &[][..]),
        ("foreign.mcap", &b"this is no recording, but a text of some length"[..]),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("it can be written");
        assert_says(&refused(&["bag", "info", path.to_str().expect("utf-8")]), &[name]);
        assert_says(&play(&path), &[name]);
    }
}

#[test]
fn a_truncated_bag_can_be_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(demo_bag()).expect("the demo bag");
    let (cut, out) = (folder.path().join("cut.mcap"), folder.path().join("kept"));
    std::fs::write(&cut, &whole[..whole.len() * 2 / 3]).expect("it can be written");
    let output = run(&["bag", "recover", cut.to_str().expect("utf-8"), "--out", out.to_str().expect("utf-8")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(run(&["bag", "info", out.to_str().expect("utf-8")]).status.success());
}

#[test]
fn weights_of_another_network() {
    let said = refused(&[
        "export",
        "--weights",
        "config/weights/raft_small.safetensors",
        "--network",
        "paper",
        "--out",
        "/dev/null",
    ]);
    assert_says(&said, &["raft_small.safetensors", "paper"]);
}

#[test]
fn a_mesh_in_the_wrong_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let models = common::root().join("config/objects/tabletop");
    for entry in std::fs::read_dir(models).expect("objects").flatten() {
        std::fs::copy(entry.path(), folder.path().join(entry.file_name())).expect("it can be copied");
    }
    let info = folder.path().join("models_info.json");
    let text = std::fs::read_to_string(&info).expect("text").replace("\"diameter\": 269.50", "\"diameter\": 0.26950");
    std::fs::write(&info, text).expect("it can be written");
    let out = tempfile::tempdir().expect("a folder");
    let run_dir = out.path().join("run");
    let objects = format!("renderer.objects={}", folder.path().display());
    let mut args =
        vec!["run", "config/graphs/refine.yaml", "--set", &objects, "--out", run_dir.to_str().expect("utf-8")];
    let settings = common::into(out.path());
    args.extend(settings.iter().map(String::as_str));
    assert_says(&refused(&args), &["models_info.json", "diameter"]);
}

#[test]
fn result_files_and_their_names() {
    let weights = "config/weights/nano_tabletop.safetensors";
    let folder = tempfile::tempdir().expect("a folder");
    let named = |name: &str| folder.path().join(name).display().to_string();
    // A dataset of no images will do: the name is looked at before anything is refined.
    let dataset = folder.path().join("set");
    std::fs::create_dir_all(dataset.join("test")).expect("a folder");
    let objects = common::root().join("config/objects/tabletop");
    std::os::unix::fs::symlink(objects, dataset.join("models")).expect("a link");
    let dataset = dataset.display().to_string();
    let eval = |csv: &str, more: &[&str]| refused(&[&["eval", "--dataset", &dataset, "--csv", csv], more].concat());
    assert_says(&eval(&named("poses.csv"), &["--weights", weights]), &["poses.csv", "METHOD_set-test.csv"]);
    assert_says(&eval(&named("a_b_set-test.csv"), &["--weights", weights]), &["METHOD without `_`"]);
    assert_says(&eval(&named("nowhere_set-test.csv"), &[]), &["set"]);
    assert_says(&refused(&["eval"]), &["--dataset"]);
    assert_says(&refused(&["eval", "--compare", "a.json", "b.json"]), &["pseudoflow compare"]);
    assert!(std::fs::read_dir(folder.path()).expect("the folder").count() == 1, "nothing is left behind");
}
