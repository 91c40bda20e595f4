//! Rough poses that cannot be used.

use crate::recordings::*;
use pseudoflow_msgs::ros::{Detection3DArray, Naming, detections};
use pseudoflow_player::{InitialPoses, PlayerConfig};
use std::path::Path;

#[test]
fn unknown_objects() {
    let folder = tempfile::tempdir().unwrap();
    let objects = Some(object_set(folder.path()));
    let good = Recording::default().write(&folder.path().join("good"));
    let strange: fn(u32) -> Detection3DArray =
        |n| detections(&header(n), &[pose(1), pose(if n == 1 { 9 } else { 5 })], &Naming::default());
    let strange = Recording { poses: strange, ..Recording::default() }.write(&folder.path().join("strange"));
    let with = |source: &Path, only_objects: Option<Vec<u32>>| {
        create(PlayerConfig { objects: objects.clone(), only_objects, ..config(source) })
    };
    assert!(with(&good, None).is_ok());
    assert_says(&with(&strange, None).err().unwrap(), &["strange", "frame 1", "object 9", "[1, 5]", "only_objects"]);
    let mut chosen = with(&strange, Some(vec![5])).unwrap();
    assert_eq!(played(&mut chosen, 0).unwrap().2.len(), 1);
    assert_eq!(played(&mut chosen, 1).unwrap().2.len(), 0);
    assert_says(&with(&good, Some(vec![1, 77])).err().unwrap(), &["only_objects", "77", "[1, 5]", "models"]);
    let named: fn(u32) -> Detection3DArray = |n| {
        let mut array = detections(&header(n), &[pose(1)], &Naming::default());
        array.detections[0].results[0].hypothesis.class_id = "teapot".into();
        array
    };
    let named = Recording { poses: named, ..Recording::default() }.write(&folder.path().join("named"));
    assert_says(&with(&named, None).err().unwrap(), &["/initial_poses", "message 0", "teapot"]);
}

#[test]
fn poses_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let bag = Recording::default().write(&folder.path().join("bag"));
    let file = folder.path().join("poses.json");
    let config = || PlayerConfig {
        initial_poses: InitialPoses { topic: None, file: Some(file.clone()) },
        objects: Some(object_set(folder.path())),
        ..config(&bag)
    };
    let entry = |id: u32, r: &str| format!(r#"{{"obj_id": {id}, "cam_R_m2c": [{r}], "cam_t_m2c": [0, 0, 800]}}"#);
    let unit = "1,0,0,0,1,0,0,0,1";
    let write = |text: String| std::fs::write(&file, text).unwrap();

    write(format!(r#"{{"2": [{}]}}"#, entry(5, unit)));
    let mut node = create(config()).unwrap();
    assert_eq!(played(&mut node, 0).unwrap().2.len(), 0);
    let poses = played(&mut node, 2).unwrap().2;
    assert_eq!((poses.len(), poses[0].object_id, poses[0].translation_m), (1, 5, [0.0, 0.0, 0.8]));

    write(format!(r#"{{"2": [{}]}}"#, entry(8, unit)));
    assert_says(&refused(config()), &["poses.json", "object 8", "[1, 5]"]);
    write(format!(r#"{{"2": [{}]}}"#, entry(5, "2,0,0,0,1,0,0,0,1")));
    assert_says(&refused(config()), &["poses.json", "2[0]", "rotation"]);
    write("{".into());
    assert_says(&refused(config()), &["poses.json", "line 1"]);
    let both = InitialPoses { topic: Some("/initial_poses".into()), file: Some(file.clone()) };
    assert_says(&refused(PlayerConfig { initial_poses: both, ..config() }), &["`topic`", "`file`"]);
}

#[test]
fn poses_from_a_result_file() {
    let folder = tempfile::tempdir().unwrap();
    let scene = bop_scene(folder.path(), [(32, 24); 3], "png");
    let file = folder.path().join("method_set-test.csv");
    let config = || PlayerConfig {
        initial_poses: InitialPoses { topic: None, file: Some(file.clone()) },
        objects: Some(object_set(folder.path())),
        ..config(&scene)
    };
    let header = "scene_id,im_id,obj_id,score,R,t,time\n";
    let row = |scene: u32, image: u32, object: u32, z: u32| {
        format!("{scene},{image},{object},0.5,1 0 0 0 1 0 0 0 1,0 0 {z},-1\n")
    };
    let write = |rows: String| std::fs::write(&file, format!("{header}{rows}")).unwrap();
    // Of the two scenes of the file this is 42; the scene's own poses (image 10) are not taken.
    write(row(42, 20, 5, 500) + &row(42, 20, 5, 250) + &row(7, 10, 1, 500));
    let mut node = create(config()).unwrap();
    assert_eq!([0, 1].map(|number| played(&mut node, number).unwrap().2.len()), [0, 0]);
    let poses = played(&mut node, 2).unwrap().2;
    let seen: Vec<_> = poses.iter().map(|p| (p.object_id, p.instance, p.translation_m[2], p.score)).collect();
    assert_eq!(seen, [(5, 0, 0.5, 0.5), (5, 1, 0.25, 0.5)]);
    write(row(42, 20, 8, 700));
    assert_says(&refused(config()), &["method_set-test.csv", "object 8", "[1, 5]"]);
    write("42,20,5,0.5,1 0 0 0 1 0 0 0 NaN,0 0 700,-1\n".into());
    assert_says(&refused(config()), &["method_set-test.csv", "2"]);
}
