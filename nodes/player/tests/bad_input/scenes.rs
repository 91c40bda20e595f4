//! BOP scenes, and the bags that are made of them.

use crate::recordings::*;
use pseudoflow_bag::BagReader;
use pseudoflow_imaging::encode_jpeg;
use pseudoflow_msgs::ros::CompressedImage;
use pseudoflow_player::{FromBop, InitialPoses, PlayerConfig, from_bop};
use std::path::Path;

#[test]
fn a_bag_made_from_a_scene_plays_as_the_scene_does() {
    for suffix in ["png", "jpg"] {
        let folder = tempfile::tempdir().unwrap();
        let scene = bop_scene(folder.path(), [SIZE; 3], suffix);
        let out = folder.path().join("bag");
        assert_eq!(
            from_bop(&FromBop { scene: scene.clone(), out: out.clone(), every: 1, max_frames: None }).unwrap(),
            3
        );
        let mut from_scene = create(PlayerConfig { initial_poses: InitialPoses::default(), ..config(&scene) }).unwrap();
        let mut from_bag = create(config(&out)).unwrap();
        for index in 0..3 {
            let (a, b) = (played(&mut from_scene, index).unwrap(), played(&mut from_bag, index).unwrap());
            assert_eq!((a.0, a.1.len()), (index as u32 * 10, (SIZE.0 * SIZE.1 * 3) as usize));
            assert!(a.0 == b.0 && a.1 == b.1);
            assert_eq!(a.2.len(), if index == 1 { 2 } else { 0 });
            assert!(a.2.iter().zip(&b.2).all(|(a, b)| a.translation_m == b.translation_m && a.instance == b.instance));
        }
        let mut reader = BagReader::open(&out).unwrap();
        let topic = reader.topics().iter().position(|t| t.type_name.ends_with("CompressedImage")).unwrap();
        let message: CompressedImage = reader.read(topic, 1).unwrap();
        assert!(
            message.data == std::fs::read(scene.join(format!("rgb/000010.{suffix}"))).unwrap(),
            "bytes were changed"
        );
    }
}

#[test]
fn a_scene_that_cannot_become_a_bag_leaves_nothing_behind() {
    let attempt = |spoil: fn(&Path), change: fn(&mut FromBop)| {
        let folder = tempfile::tempdir().unwrap();
        let scene = bop_scene(folder.path(), [SIZE; 3], "jpg");
        spoil(&scene);
        let mut options = FromBop { scene, out: folder.path().join("out/bag"), every: 1, max_frames: None };
        std::fs::create_dir(folder.path().join("out")).unwrap();
        change(&mut options);
        let said = from_bop(&options).unwrap_err().to_string();
        assert_eq!(std::fs::read_dir(folder.path().join("out")).unwrap().count(), 0, "{said}");
        said
    };
    let keep: fn(&mut FromBop) = |_| {};
    assert_says(&attempt(|s| std::fs::write(s.join("rgb/000020.jpg"), b"no image").unwrap(), keep), &["000020.jpg"]);
    assert_says(&attempt(|s| std::fs::remove_file(s.join("rgb/000010.jpg")).unwrap(), keep), &["000042", "10"]);
    assert_says(&attempt(|s| std::fs::write(s.join("scene_camera.json"), "{}").unwrap(), keep), &["no image"]);
    assert_says(&attempt(|s| std::fs::remove_file(s.join("scene_camera.json")).unwrap(), keep), &["scene_camera.json"]);
    assert_says(
        &attempt(
            |s| {
                let text = std::fs::read_to_string(s.join("scene_camera.json")).unwrap();
                std::fs::write(s.join("scene_camera.json"), text.replacen("40, 0", "-40, 0", 1)).unwrap();
            },
            keep,
        ),
        &["scene_camera.json", "0.cam_K", "focal"],
    );
    assert_says(&attempt(|_| {}, |options| options.every = 0), &["every"]);
    let small = encode_jpeg(&picture(2, (16, 16)), 80).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = bop_scene(folder.path(), [SIZE; 3], "jpg");
    std::fs::write(scene.join("rgb/000020.jpg"), small).unwrap();
    let out = folder.path().join("bag");
    let said = from_bop(&FromBop { scene: scene.clone(), out: out.clone(), every: 1, max_frames: None }).unwrap_err();
    assert_says(&said.to_string(), &["000020.jpg", "(16, 16)", "(32, 24)"]);
    assert!(!out.exists());
    let said = refused(PlayerConfig { initial_poses: InitialPoses::default(), ..config(&scene) });
    assert_says(&said, &["000020.jpg", "(16, 16)"]);
}

#[test]
fn an_existing_bag_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let scene = bop_scene(folder.path(), [SIZE; 3], "jpg");
    let options = FromBop { scene, out: folder.path().join("bag"), every: 2, max_frames: None };
    assert_eq!(from_bop(&options).unwrap(), 2);
    let before = std::fs::read(options.out.join("bag_0.mcap")).unwrap();
    assert_says(&from_bop(&options).unwrap_err().to_string(), &["bag", "exists already"]);
    assert!(before == std::fs::read(options.out.join("bag_0.mcap")).unwrap());
}
