//! What cannot be played is refused when the player is made, before any node has written anything, with one error
//! that names file, field and remedy.

use pseudoflow_imaging::{RgbImage, encode_jpeg, encode_png};
use pseudoflow_msgs::ros::{
    BagMessage, CameraInfo, CompressedImage, Detection3DArray, Header, Image, Naming, Time, detections,
};
use pseudoflow_msgs::{CameraFrame, Message, ObjectPose, ObjectPoses, PoseSource, PoseStatus};
use pseudoflow_player::{FromBop, InitialPoses, PlayerConfig, PlayerNode, from_bop};
use pseudoflow_runtime::bag::{BagReader, BagWriter, Packing, Qos};
use pseudoflow_runtime::{Context, InMemory, Node, Produced};
use std::path::{Path, PathBuf};

const SIZE: (u32, u32) = (32, 24);
const K: [f64; 4] = [40.0, 41.0, 15.5, 11.5];

/// Frame `number` of the recordings here.
fn picture(number: u32, size: (u32, u32)) -> RgbImage {
    RgbImage::from_fn(size.0, size.1, |x, y| image_pixel(number, x, y))
}

fn image_pixel(number: u32, x: u32, y: u32) -> image::Rgb<u8> {
    image::Rgb([(x * 7) as u8, (y * 9) as u8, (number * 40) as u8])
}

fn header(number: u32) -> Header {
    let stamp = Time::from_ns(1_000_000_000 + i64::from(number) * 33_000_000).unwrap();
    Header { stamp, frame_id: "camera".into() }
}

fn pose(object_id: u32) -> ObjectPose {
    ObjectPose {
        object_id,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: 1.0,
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        translation_m: [0.0, 0.1, 0.8],
        covariance: [0.0; 36],
    }
}

/// A recording of three good frames that a test spoils in one place.
struct Recording {
    encode: fn(u32) -> CompressedImage,
    raw: Option<fn(u32) -> Image>,
    info: Option<fn(u32) -> CameraInfo>,
    poses: fn(u32) -> Detection3DArray,
}

impl Default for Recording {
    fn default() -> Self {
        Self {
            encode: |number| compressed(number, SIZE, "png"),
            raw: None,
            info: Some(|number| CameraInfo::pinhole(header(number), SIZE, K)),
            poses: |number| detections(&header(number), &[pose(1), pose(5)], &Naming::default()),
        }
    }
}

fn compressed(number: u32, size: (u32, u32), format: &str) -> CompressedImage {
    let picture = picture(number, size);
    let data = if format == "png" { encode_png(&picture) } else { encode_jpeg(&picture, 90) };
    CompressedImage { header: header(number), format: format.into(), data: data.unwrap() }
}

fn raw(number: u32, encoding: &str, order: &[usize]) -> Image {
    let rgb = picture(number, SIZE).into_raw();
    let mut data = Vec::new();
    for row in rgb.chunks_exact(SIZE.0 as usize * 3) {
        data.extend(row.chunks_exact(3).flat_map(|pixel| order.iter().map(|c| pixel[*c])));
        data.extend([0; 5]); // padding
    }
    let step = SIZE.0 * order.len() as u32 + 5;
    let encoding = encoding.to_owned();
    Image { header: header(number), height: SIZE.1, width: SIZE.0, encoding, is_bigendian: 0, step, data }
}

impl Recording {
    fn write(&self, directory: &Path) -> PathBuf {
        let mut writer = BagWriter::create(directory, Packing::None).unwrap();
        let mut put = |name: &str, messages: Vec<Put>| messages.into_iter().for_each(|m| m(&mut writer, name));
        match self.raw {
            Some(raw) => put("/camera/image", (0..3).map(|n| put_of(n, raw(n))).collect()),
            None => put("/camera/compressed", (0..3).map(|n| put_of(n, (self.encode)(n))).collect()),
        }
        if let Some(info) = self.info {
            put("/camera/camera_info", (0..3).map(|n| put_of(n, info(n))).collect());
        }
        put("/initial_poses", (0..2).map(|n| put_of(n, (self.poses)(n))).collect());
        writer.finish().unwrap();
        directory.to_owned()
    }

    /// What the player says to it.
    fn refused(&self) -> String {
        let folder = tempfile::tempdir().unwrap();
        let bag = self.write(&folder.path().join("bag"));
        refused(config(&bag))
    }
}

type Put = Box<dyn FnOnce(&mut BagWriter, &str)>;

fn put_of<M: BagMessage>(number: u32, message: M) -> Put {
    Box::new(move |writer, name| {
        let topic = writer.add_topic::<M>(name, Qos::RELIABLE).unwrap();
        writer.write(topic, header(number).stamp.as_ns(), number, &message).unwrap();
    })
}

fn config(source: &Path) -> PlayerConfig {
    PlayerConfig {
        initial_poses: InitialPoses { topic: Some("/initial_poses".into()), file: None },
        ..PlayerConfig::new(source.to_owned())
    }
}

fn context() -> Context {
    Context { name: "player".into(), seed: 1, out_dir: PathBuf::new(), restarts: 0, replay: true }
}

fn create(config: PlayerConfig) -> Result<PlayerNode, String> {
    PlayerNode::check(&config).map_err(|error| error.to_string())?;
    PlayerNode::create(config, &context()).map_err(|error| error.to_string())
}

fn refused(config: PlayerConfig) -> String {
    create(config).err().expect("it must be refused")
}

/// Image id, pixels and initial poses of a frame.
fn played(node: &mut PlayerNode, index: u64) -> Option<(u32, Vec<u8>, Vec<ObjectPose>)> {
    let mut sent = InMemory::default();
    match node.produce(index, &mut sent, &context()).unwrap() {
        Produced::Frame(_) => {
            let bytes = |port: &str| &sent.messages.iter().find(|(name, _)| name == port).unwrap().1;
            let frame = CameraFrame::view(bytes("frame")).unwrap();
            let poses = ObjectPoses::view(bytes("initial_poses")).unwrap();
            Some((frame.header.image_id, frame.rgb.to_vec(), poses.poses.to_vec()))
        }
        _ => None,
    }
}

fn assert_says(text: &str, wanted: &[&str]) {
    for word in wanted {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

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

/// A set of two boxes with ids 1 and 5.
fn object_set(folder: &Path) -> PathBuf {
    let models = folder.join("models");
    std::fs::create_dir_all(&models).unwrap();
    let info =
        r#"{"diameter": 173.2, "min_x": -50, "min_y": -50, "min_z": -50, "size_x": 100, "size_y": 100, "size_z": 100}"#;
    std::fs::write(models.join("models_info.json"), format!(r#"{{"1": {info}, "5": {info}}}"#)).unwrap();
    let mut ply =
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n".to_owned();
    ply += "element face 12\nproperty list uchar int vertex_indices\nend_header\n";
    for i in 0..8 {
        let at = |bit: i32| if i & bit == 0 { -50 } else { 50 };
        ply += &format!("{} {} {}\n", at(1), at(2), at(4));
    }
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        ply += &format!("3 {a} {b} {c}\n3 {a} {c} {d}\n");
    }
    [1, 5].iter().for_each(|id| std::fs::write(models.join(format!("obj_{id:06}.ply")), &ply).unwrap());
    models
}

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

/// A BOP scene of three images.
fn bop_scene(folder: &Path, sizes: [(u32, u32); 3], suffix: &str) -> PathBuf {
    let scene = folder.join("000042");
    std::fs::create_dir_all(scene.join("rgb")).unwrap();
    let camera = r#"{"cam_K": [40, 0, 15.5, 0, 41, 11.5, 0, 0, 1], "depth_scale": 1}"#;
    let cameras: Vec<_> = (0..3).map(|i| format!(r#""{}": {camera}"#, i * 10)).collect();
    std::fs::write(scene.join("scene_camera.json"), format!("{{{}}}", cameras.join(","))).unwrap();
    let pose = r#"{"obj_id": 5, "cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [10, 20, 800]}"#;
    std::fs::write(scene.join("init_poses.json"), format!(r#"{{"10": [{pose}, {pose}]}}"#)).unwrap();
    for (number, size) in sizes.into_iter().enumerate() {
        let picture = picture(number as u32, size);
        let bytes = if suffix == "png" { encode_png(&picture) } else { encode_jpeg(&picture, 80) };
        std::fs::write(scene.join(format!("rgb/{:06}.{suffix}", number * 10)), bytes.unwrap()).unwrap();
    }
    scene
}

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
