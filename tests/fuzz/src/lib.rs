//! Everything that reads what strangers wrote, each as a function over bytes: no answer matters, only that there is one.
//!
//! `cargo fuzz` runs them from `fuzz_targets` (it needs a nightly compiler); `tests/tests/hostile` runs the same functions
//! on known bad files and on mutated good ones with the stable compiler, under the budgets below.

use pseudoflow_bag::{BagReader, RecoverOptions, recover};
use pseudoflow_edge::camera::Lens;
use pseudoflow_edge::pixels::write_rgb;
use pseudoflow_imaging::{decode_rgb, image_size, load_obj, load_ply, read_initial_poses};
use pseudoflow_metrics::parse_results;
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection3DArray, DiagnosticArray, Image, Naming, PoseStamped, RosMessage, TFMessage,
    from_cdr, object_poses,
};
use pseudoflow_network::Weights;
use pseudoflow_runtime::{Graph, Registry, graph};
use std::path::{Path, PathBuf};

/// A reader and what it may cost.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Reads the bytes.
    pub read: fn(&[u8]),
    /// Bytes of memory it may hold at once, whatever the input.
    pub plain_bytes: usize,
    /// And for each byte of the input.
    pub bytes_per_byte: usize,
}

const MIB: usize = 1 << 20;

/// All of them. A chunk of a bag may unpack to 64 MiB, and is held twice with a window of zstd; a picture may have 67 million
/// pixels; a bag's smallest message takes nine bytes in the file.
pub const TARGETS: [Target; 9] = [
    Target { name: "bag", read: bag, plain_bytes: 400 * MIB, bytes_per_byte: 300 },
    Target { name: "ply", read: ply, plain_bytes: MIB, bytes_per_byte: 150 },
    Target { name: "obj", read: obj, plain_bytes: MIB, bytes_per_byte: 300 },
    Target { name: "picture", read: picture, plain_bytes: 900 * MIB, bytes_per_byte: 10 },
    Target { name: "graph", read: graph, plain_bytes: MIB, bytes_per_byte: 2000 },
    Target { name: "results", read: results, plain_bytes: MIB, bytes_per_byte: 100 },
    Target { name: "poses", read: poses, plain_bytes: MIB, bytes_per_byte: 200 },
    Target { name: "weights", read: weights, plain_bytes: MIB, bytes_per_byte: 50 },
    Target { name: "cdr", read: cdr, plain_bytes: MIB, bytes_per_byte: 100 },
];

/// A file with these bytes, in memory where the system has such a place; gone with the returned folder.
fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let memory = Path::new("/dev/shm");
    let place = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let folder = tempfile::tempdir_in(place).expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a file");
    (folder, path)
}

/// A recording: opened, described, every topic's first message read, recovered.
pub fn bag(bytes: &[u8]) {
    let (folder, path) = file("a.mcap", bytes);
    if let Ok(mut reader) = BagReader::open(&path) {
        let _ = reader.info().map(|info| info.to_string());
        for topic in 0..reader.topics().len() {
            let _ = reader.message(topic, 0);
        }
    }
    let _ = recover(&RecoverOptions { bag: path, out: Some(folder.path().join("out")) });
}

/// A PLY mesh.
pub fn ply(bytes: &[u8]) {
    let (_folder, path) = file("a.ply", bytes);
    let _ = load_ply(&path, 1e-3);
}

/// What parts an OBJ from its material file, `a.mtl`, in one input.
pub const MTL_BEGINS: &[u8] = b"\n%%MTL%%\n";

/// An OBJ mesh with its materials.
pub fn obj(bytes: &[u8]) {
    let at = bytes.windows(MTL_BEGINS.len()).position(|window| window == MTL_BEGINS);
    let (mesh, materials) = at.map_or((bytes, None), |at| (&bytes[..at], Some(&bytes[at + MTL_BEGINS.len()..])));
    let (folder, path) = file("a.obj", mesh);
    if let Some(materials) = materials {
        std::fs::write(folder.path().join("a.mtl"), materials).expect("a file");
    }
    let _ = load_obj(&path, 1.0);
}

/// A JPEG or PNG.
pub fn picture(bytes: &[u8]) {
    let _ = image_size(bytes, "input");
    let _ = decode_rgb(bytes, "input");
}

/// A graph, an override, a check.
pub fn graph(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Ok(mut read) = Graph::parse(&text, Path::new("input.yaml")) {
        let _ = graph::check(&read, &Registry::new());
        let _ = read.set("window", &text);
        let _ = read.to_yaml();
    }
}

/// A BOP result file.
pub fn results(bytes: &[u8]) {
    let _ = parse_results(&String::from_utf8_lossy(bytes), None);
}

/// Rough poses as JSON.
pub fn poses(bytes: &[u8]) {
    let (_folder, path) = file("init_poses.json", bytes);
    let _ = read_initial_poses(&path);
}

/// A file of weights.
pub fn weights(bytes: &[u8]) {
    let (_folder, path) = file("a.safetensors", bytes);
    let _ = Weights::read_info(&path);
}

/// Every message of ROS 2 that is received or read from bags, and what becomes of it.
pub fn cdr(bytes: &[u8]) {
    fn read<M: RosMessage>(bytes: &[u8]) -> Option<M> {
        from_cdr(bytes).ok()
    }
    if let Some(image) = read::<Image>(bytes) {
        let _ = write_rgb(&image, &mut Vec::new());
    }
    if let Some(info) = read::<CameraInfo>(bytes) {
        let _ = Lens::new(&info, (16, 12), false);
        let _ = Lens::new(&info, (16, 12), true);
    }
    if let Some(array) = read::<Detection3DArray>(bytes) {
        let _ = object_poses(&array, &Naming::default());
    }
    let _ = read::<CompressedImage>(bytes);
    let _ = read::<PoseStamped>(bytes);
    let _ = read::<TFMessage>(bytes);
    let _ = read::<DiagnosticArray>(bytes);
}
