//! Good recordings, which a test spoils in one place, and what the player says to them.

use pseudoflow_bag::{BagWriter, Packing, Qos};
use pseudoflow_imaging::{RgbImage, encode_jpeg, encode_png};
use pseudoflow_msgs::ros::{
    BagMessage, CameraInfo, CompressedImage, Detection3DArray, Header, Image, Naming, Time, detections,
};
use pseudoflow_msgs::{CameraFrame, Message, ObjectPose, ObjectPoses, PoseSource, PoseStatus};
use pseudoflow_player::{InitialPoses, PlayerConfig, PlayerNode};
use pseudoflow_runtime::{Context, InMemory, Node, Produced};
use std::path::{Path, PathBuf};

pub(crate) const SIZE: (u32, u32) = (32, 24);
pub(crate) const K: [f64; 4] = [40.0, 41.0, 15.5, 11.5];

/// Frame `number` of the recordings here.
pub(crate) fn picture(number: u32, size: (u32, u32)) -> RgbImage {
    RgbImage::from_fn(size.0, size.1, |x, y| image_pixel(number, x, y))
}

pub(crate) fn image_pixel(number: u32, x: u32, y: u32) -> image::Rgb<u8> {
    image::Rgb([(x * 7) as u8, (y * 9) as u8, (number * 40) as u8])
}

pub(crate) fn header(number: u32) -> Header {
    let stamp = Time::from_ns(1_000_000_000 + i64::from(number) * 33_000_000).unwrap();
    Header { stamp, frame_id: "camera".into() }
}

pub(crate) fn pose(object_id: u32) -> ObjectPose {
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
pub(crate) struct Recording {
    pub(crate) encode: fn(u32) -> CompressedImage,
    pub(crate) raw: Option<fn(u32) -> Image>,
    pub(crate) info: Option<fn(u32) -> CameraInfo>,
    pub(crate) poses: fn(u32) -> Detection3DArray,
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

pub(crate) fn compressed(number: u32, size: (u32, u32), format: &str) -> CompressedImage {
    let picture = picture(number, size);
    let data = if format == "png" { encode_png(&picture) } else { encode_jpeg(&picture, 90) };
    CompressedImage { header: header(number), format: format.into(), data: data.unwrap() }
}

pub(crate) fn raw(number: u32, encoding: &str, order: &[usize]) -> Image {
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
    pub(crate) fn write(&self, directory: &Path) -> PathBuf {
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
    pub(crate) fn refused(&self) -> String {
        let folder = tempfile::tempdir().unwrap();
        let bag = self.write(&folder.path().join("bag"));
        refused(config(&bag))
    }
}

pub(crate) type Put = Box<dyn FnOnce(&mut BagWriter, &str)>;

pub(crate) fn put_of<M: BagMessage>(number: u32, message: M) -> Put {
    Box::new(move |writer, name| {
        let topic = writer.add_topic::<M>(name, Qos::RELIABLE).unwrap();
        writer.write(topic, header(number).stamp.as_ns(), number, &message).unwrap();
    })
}

pub(crate) fn config(source: &Path) -> PlayerConfig {
    PlayerConfig {
        initial_poses: InitialPoses { topic: Some("/initial_poses".into()), file: None },
        ..PlayerConfig::new(source.to_owned())
    }
}

pub(crate) fn context() -> Context {
    Context { name: "player".into(), seed: 1, out_dir: PathBuf::new(), restarts: 0, replay: true }
}

pub(crate) fn create(config: PlayerConfig) -> Result<PlayerNode, String> {
    PlayerNode::check(&config).map_err(|error| error.to_string())?;
    PlayerNode::create(config, &context()).map_err(|error| error.to_string())
}

pub(crate) fn refused(config: PlayerConfig) -> String {
    create(config).err().expect("it must be refused")
}

/// Image id, pixels and initial poses of a frame.
pub(crate) fn played(node: &mut PlayerNode, index: u64) -> Option<(u32, Vec<u8>, Vec<ObjectPose>)> {
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

pub(crate) fn assert_says(text: &str, wanted: &[&str]) {
    for word in wanted {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

/// A set of two boxes with ids 1 and 5.
pub(crate) fn object_set(folder: &Path) -> PathBuf {
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

/// A BOP scene of three images.
pub(crate) fn bop_scene(folder: &Path, sizes: [(u32, u32); 3], suffix: &str) -> PathBuf {
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
