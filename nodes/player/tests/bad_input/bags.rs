//! Recordings whose images, calibrations or topics cannot be used.

use crate::recordings::*;
use pseudoflow_bag::{BagWriter, Packing};
use pseudoflow_msgs::ros::{CameraInfo, CompressedImage, Image};
use pseudoflow_player::{InitialPoses, PlayerConfig};

#[test]
fn good_recordings_play_at_random_in_every_encoding() {
    let recordings: [Recording; 5] = [
        Recording::default(),
        Recording { raw: Some(|n| raw(n, "rgb8", &[0, 1, 2])), ..Recording::default() },
        Recording { raw: Some(|n| raw(n, "bgr8", &[2, 1, 0])), ..Recording::default() },
        Recording { raw: Some(|n| raw(n, "mono8", &[1])), ..Recording::default() },
        Recording { encode: |n| compressed(n, SIZE, "jpeg"), ..Recording::default() },
    ];
    for (which, recording) in recordings.iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let mut node = create(config(&recording.write(&folder.path().join("bag")))).unwrap();
        for index in [2, 0, 1, 1] {
            let (image_id, rgb, poses) = played(&mut node, index).unwrap();
            let mut expected = picture(index as u32, SIZE).into_raw();
            if which == 3 {
                expected.chunks_exact_mut(3).for_each(|pixel| pixel.fill(pixel[1]));
            }
            let worst = rgb.iter().zip(&expected).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(rgb.len() == expected.len() && worst <= if which == 4 { 60 } else { 0 }, "{which}: {worst}");
            assert_eq!((image_id, poses.len()), (index as u32, if index < 2 { 2 } else { 0 }));
        }
        assert!(played(&mut node, 3).is_none());
    }
}

#[test]
fn a_bag_without_camera_info() {
    let said = Recording { info: None, ..Recording::default() }.refused();
    assert_says(&said, &["bag", "sensor_msgs/msg/CameraInfo", "camera_info_topic", "record"]);
}

#[test]
fn images_before_the_first_camera_info() {
    let said =
        Recording { info: Some(|n| CameraInfo::pinhole(header(n + 1), SIZE, K)), ..Recording::default() }.refused();
    assert_says(&said, &["image 0", "/camera/camera_info", "record it along"]);
}

#[test]
fn intrinsics_that_are_missing_nan_or_distorted() {
    let with = |change: fn(&mut CameraInfo)| {
        let info: fn(u32) -> CameraInfo = |n| CameraInfo::pinhole(header(n), SIZE, K);
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = BagWriter::create(&bag, Packing::None).unwrap();
        for number in 0..3 {
            put_of(number, compressed(number, SIZE, "png"))(&mut writer, "/camera/compressed");
            let mut message = info(number);
            change(&mut message);
            put_of(number, message)(&mut writer, "/camera/camera_info");
        }
        writer.finish().unwrap();
        refused(PlayerConfig { initial_poses: InitialPoses::default(), ..config(&bag) })
    };
    assert_says(&with(|c| c.k = [0.0; 9]), &["bag", "/camera/camera_info", "message 0", "`k`", "calibrate"]);
    assert_says(&with(|c| c.k[0] = f64::NAN), &["bag", "`k`", "NaN"]);
    assert_says(&with(|c| c.k[5] = f64::INFINITY), &["bag", "`k`", "inf"]);
    assert_says(&with(|c| c.d = vec![0.1; 3]), &["bag", "plumb_bob", "3 coefficients"]);
    assert_says(&with(|c| c.d = vec![0.1; 14]), &["bag", "plumb_bob", "14 coefficients"]);
    assert_says(&with(|c| c.d[0] = f64::NAN), &["bag", "d[0]", "NaN"]);
    let unknown = |c: &mut CameraInfo| (c.distortion_model, c.d[0]) = ("thin_prism".into(), 0.1);
    assert_says(&with(unknown), &["bag", "distortion_model", "thin_prism"]);
    assert_says(&with(|c| c.d[0] = -9.0), &["bag", "/camera/camera_info", "folds back", "radius"]);
    assert_says(&with(|c| c.k[1] = 3.0), &["bag", "skew"]);
    assert_says(&with(|c| c.binning_x = 2), &["bag", "image 0", "(16, 24)", "CameraInfo"]);
}

#[test]
fn a_frame_size_that_changes() {
    let changes = |n| compressed(n, if n == 2 { (16, 24) } else { SIZE }, "png");
    assert_says(
        &Recording { encode: changes, ..Recording::default() }.refused(),
        &["bag", "image 2", "(16, 24)", "(32, 24)"],
    );
    let other = Recording { info: Some(|n| CameraInfo::pinhole(header(n), (64, 48), K)), ..Recording::default() };
    assert_says(&other.refused(), &["bag", "image 0", "(32, 24)", "(64, 48)", "CameraInfo"]);
}

#[test]
fn an_image_that_is_none() {
    let odd = Recording { raw: Some(|n| raw(n, "16UC1", &[0, 1])), ..Recording::default() };
    assert_says(&odd.refused(), &["bag", "/camera/image", "message 0", "16UC1", "rgb8"]);
    let short: fn(u32) -> Image = |n| {
        let mut image = raw(n, "rgb8", &[0, 1, 2]);
        image.data.truncate(100);
        image
    };
    assert_says(&Recording { raw: Some(short), ..Recording::default() }.refused(), &["message 0", "100 bytes"]);
    let noise: fn(u32) -> CompressedImage =
        |n| CompressedImage { header: header(n), format: "jpeg".into(), data: vec![7; 50] };
    assert_says(&Recording { encode: noise, ..Recording::default() }.refused(), &["message 0", "jpeg", "JPEG or PNG"]);
    let long: fn(u32) -> CompressedImage = |n| {
        let mut image = compressed(n, SIZE, "png");
        image.header.frame_id = "x".repeat(64);
        image
    };
    assert_says(&Recording { encode: long, ..Recording::default() }.refused(), &["frame_id", "63 bytes"]);
}

#[test]
fn topics_that_are_ambiguous_unknown_or_of_another_type() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, Packing::None).unwrap();
    for name in ["/left", "/right"] {
        put_of(0, compressed(0, SIZE, "png"))(&mut writer, name);
    }
    put_of(0, CameraInfo::pinhole(header(0), SIZE, K))(&mut writer, "/camera_info");
    writer.finish().unwrap();
    let plain = PlayerConfig { initial_poses: InitialPoses::default(), ..config(&bag) };
    assert_says(&refused(plain.clone()), &["2 topics", "`image_topic`", "/left", "/right"]);
    let named = |name: &str| PlayerConfig { image_topic: Some(name.into()), ..plain.clone() };
    assert!(create(named("/left")).is_ok());
    assert_says(&refused(named("/up")), &["bag", "/up", "/left", "/right"]);
    assert_says(&refused(named("/camera_info")), &["/camera_info", "sensor_msgs/msg/Image"]);
    assert_says(
        &refused(PlayerConfig { initial_poses: config(&bag).initial_poses, ..named("/left") }),
        &["/initial_poses"],
    );
}

#[test]
fn damaged_bags() {
    let folder = tempfile::tempdir().unwrap();
    let bag = Recording::default().write(&folder.path().join("bag"));
    let file = bag.join("bag_0.mcap");
    let whole = std::fs::read(&file).unwrap();
    let said = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        refused(config(&bag))
    };
    assert_says(&said(&whole[..whole.len() / 2]), &["bag_0.mcap", "cut off", "bag recover"]);
    let mut flipped = whole.clone();
    flipped[whole.len() / 3] ^= 4;
    assert_says(&said(&flipped), &["bag_0.mcap", "checksum", "bag recover"]);
    assert_says(&said(b""), &["bag_0.mcap", "empty"]);
    assert_says(&said(b"\x89PNG\r\n\x1a\n..."), &["bag_0.mcap", "no recording", ".mcap"]);
    assert_says(&refused(config(&folder.path().join("nothing"))), &["`source", "nothing", "no recording"]);
    std::fs::remove_file(&file).unwrap();
    assert_says(&refused(config(&bag)), &["metadata.yaml", "bag_0.mcap", "does not exist"]);
}
