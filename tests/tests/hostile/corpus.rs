//! Small good files of every kind, from which mutation begins, and bad ones that once cost a crash, minutes or gigabytes.

use pseudoflow_imaging::{RgbImage, encode_jpeg, encode_png};
use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection3D, Detection3DArray, DiagnosticArray, Header, Image,
    ObjectHypothesisWithPose, PoseStamped, TFMessage, to_cdr,
};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode], &(content.len() as u64).to_le_bytes()[..], content].concat()
}

fn schema(id: u16) -> Vec<u8> {
    record(3, &[id.to_le_bytes().to_vec(), string("a_msgs/msg/A"), string("ros2msg"), string("int8 a")].concat())
}

fn channel(id: u16, topic: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), 1_u16.to_le_bytes()].concat();
    record(4, &[ids, string(topic), string("cdr"), 0_u32.to_le_bytes().to_vec()].concat())
}

fn message(channel: u16, data: &[u8]) -> Vec<u8> {
    let head = [&channel.to_le_bytes()[..], &1_u32.to_le_bytes(), &5_u64.to_le_bytes(), &5_u64.to_le_bytes()].concat();
    record(5, &[&head, data].concat())
}

/// A chunk without a checksum.
fn chunk(unpacked: u64, compression: &str, records: &[u8]) -> Vec<u8> {
    let sizes = [&5_u64.to_le_bytes()[..], &5_u64.to_le_bytes(), &unpacked.to_le_bytes(), &[0; 4]].concat();
    record(6, &[&sizes[..], &string(compression), &(records.len() as u64).to_le_bytes(), records].concat())
}

/// An mcap file around records of the data section, without checksums.
fn mcap(records: &[Vec<u8>]) -> Vec<u8> {
    let header = record(1, &[string("ros2"), string("test")].concat());
    let end = [record(15, &[0; 4]), record(2, &[0; 20])].concat();
    [MAGIC, &header, &records.concat(), &end, MAGIC].concat()
}

/// A frame of zstd that holds so many zero bytes: blocks of one repeated byte.
fn zstd_of_zeros(bytes: u32) -> Vec<u8> {
    const BLOCK: u32 = 128 << 10;
    let head = [&0xfd2f_b528_u32.to_le_bytes()[..], &[0b1010_0000], &bytes.to_le_bytes()].concat();
    let blocks = bytes.div_ceil(BLOCK);
    let block = |i: u32| {
        let size = if i + 1 == blocks { bytes - i * BLOCK } else { BLOCK };
        let head = (size << 3) | (1 << 1) | u32::from(i + 1 == blocks);
        [&head.to_le_bytes()[..3], &[0]].concat()
    };
    [head, (0..blocks).flat_map(block).collect()].concat()
}

fn good_bag() -> Vec<u8> {
    let records = [schema(1), channel(1, "/a"), message(1, &[0, 1, 0, 0, 7]), message(1, &[0, 1, 0, 0, 8])].concat();
    let metadata = [string("pseudoflow"), 14_u32.to_le_bytes().to_vec(), string("scene"), string("7")].concat();
    let message = message(1, &[0, 1, 0, 0, 9]);
    mcap(&[record(12, &metadata), chunk(records.len() as u64, "", &records), message])
}

/// A bag of so many topics with a message each.
fn many_topics(count: u16) -> Vec<u8> {
    let topics = (1..=count).flat_map(|id| [channel(id, &format!("/t{id}")), message(id, &[0, 1, 0, 0])].concat());
    mcap(&[schema(1), topics.collect()])
}

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
     property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 4\n\
     property list uchar int vertex_indices\nend_header\n0 0 0 1 2 3\n60 0 0 1 2 3\n0 60 0 1 2 3\n0 0 60 1 2 3\n\
     3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";

fn binary_ply() -> Vec<u8> {
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         element face 4\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n";
    let vertices: [[f32; 3]; 4] = [[0.0; 3], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 60.0]];
    let mut bytes = head.as_bytes().to_vec();
    vertices.iter().flatten().for_each(|c| bytes.extend(c.to_le_bytes()));
    for face in [[0_i32, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
        bytes.push(3);
        face.iter().for_each(|i| bytes.extend(i.to_le_bytes()));
        bytes.push(6);
        [0.0_f32, 0.0, 1.0, 0.0, 0.0, 1.0].iter().for_each(|c| bytes.extend(c.to_le_bytes()));
    }
    bytes
}

const OBJ: &str = "mtllib a.mtl\no thing\nv 0 0 0\nv 0.06 0 0\nv 0 0.06 0\nv 0 0 0.06\nvt 0 0\nvt 1 0\nvn 0 0 1\n\
     usemtl red\nf 1/1/1 3/2/1 2/1/1\nf 1/1/1 2/2/1 4/1/1\nf -4/-1/-1 -1/1/1 -2/-2/1\nf 2/1/1 3/2/1 4/1/1\n\n%%MTL%%\nnewmtl red\nKd 0.8 0.1 0.1\nKa 0 0 0\nd 1\n";

const GRAPH: &str = "mode: live\nwindow: 4\nfeedback: [b/out]\nnodes:\n  a: {kind: player, config: {source: x, list: [1, {y: 2}]}}\n\
       b: {kind: pnp, inputs: {in: a/frame}}\n";

const RESULTS: &str = "scene_id,im_id,obj_id,score,R,t,time\n1,2,3,0.5,1 0 0 0 1 0 0 0 1,10 20 300,-1\n\
     1,2,4,0.25,0 -1 0 1 0 0 0 0 1,1 2 3e2,0.5\n";

const POSES: &str =
    r#"{"0": [{"obj_id": 5, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 500]}], "7": []}"#;

fn weights() -> Vec<u8> {
    let header = r#"{"__metadata__":{"format":"x"},"a":{"dtype":"F32","shape":[2,2],"data_offsets":[0,16]}}"#;
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat()
}

fn messages() -> Vec<Vec<u8>> {
    let header = Header { frame_id: "camera".into(), ..Header::default() };
    let image = Image {
        header: header.clone(),
        width: 2,
        height: 2,
        encoding: "rgb8".into(),
        step: 6,
        data: vec![9; 12],
        is_bigendian: 0,
    };
    let detection = Detection3D { results: vec![ObjectHypothesisWithPose::default()], ..Detection3D::default() };
    let detections = Detection3DArray { header: header.clone(), detections: vec![detection; 2] };
    vec![
        to_cdr(&image).expect("CDR"),
        to_cdr(&CameraInfo::pinhole(header.clone(), (2, 2), [3.0, 3.0, 1.0, 1.0])).expect("CDR"),
        to_cdr(&detections).expect("CDR"),
        to_cdr(&CompressedImage { header, format: "jpeg".into(), data: vec![1; 20] }).expect("CDR"),
        to_cdr(&PoseStamped::default()).expect("CDR"),
        to_cdr(&TFMessage::default()).expect("CDR"),
        to_cdr(&DiagnosticArray::default()).expect("CDR"),
    ]
}

fn picture() -> RgbImage {
    RgbImage::from_fn(12, 9, |x, y| [(x * 20) as u8, (y * 25) as u8, 90].into())
}

/// Good files of a target.
pub(crate) fn good(target: &str) -> Vec<Vec<u8>> {
    let text = |text: &str| text.as_bytes().to_vec();
    match target {
        "bag" => vec![good_bag(), many_topics(5), mcap(&[chunk(5000, "zstd", &zstd_of_zeros(5000))])],
        "ply" => vec![text(PLY), binary_ply()],
        "obj" => vec![text(OBJ)],
        "picture" => vec![encode_png(&picture()).expect("PNG"), encode_jpeg(&picture(), 90).expect("JPEG")],
        "graph" => vec![text(GRAPH)],
        "results" => vec![text(RESULTS)],
        "poses" => vec![text(POSES)],
        "weights" => vec![weights()],
        "cdr" => messages(),
        other => panic!("no corpus for {other}"),
    }
}

/// A PNG or JPEG whose header claims another size.
fn claims(mut picture: Vec<u8>, at: usize, size: &[u8]) -> Vec<u8> {
    picture[at..at + size.len()].copy_from_slice(size);
    picture
}

fn huge_jpeg() -> Vec<u8> {
    let jpeg = encode_jpeg(&picture(), 90).expect("JPEG");
    let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).expect("a frame header");
    claims(jpeg, frame + 5, &[0xff, 0xdc, 0xff, 0xdc])
}

/// Bad files of a target by name.
pub(crate) fn bad(target: &str) -> Vec<(&'static str, Vec<u8>)> {
    let repeated = |text: &str, times: usize| text.repeat(times).into_bytes();
    match target {
        "bag" => vec![
            // 74 bytes that would reserve 4 GB.
            ("string length", [MAGIC, &record(1, &[4, 0, 0, 0, b'r', b'o', b's', b'2', 255, 255, 255, 255])].concat()),
            ("map length", mcap(&[record(12, &[string("a"), vec![255; 8]].concat())])),
            // 40 KB that cost 13 s and 1.2 GB.
            ("zstd bomb", mcap(&[chunk(1_200_000_000, "zstd", &zstd_of_zeros(1_200_000_000))])),
            ("zstd bombs", mcap(&vec![chunk(64 << 20, "zstd", &[0; 40]); 1000])),
            ("record in a chunk", mcap(&[chunk(20, "", &[5; 20])])),
            // 60 s with a search for each topic.
            ("many topics", many_topics(30_000)),
        ],
        "ply" => vec![
            ("a huge count without properties", text_ply("element nothing 9999999999999\n")),
            (
                "vertices without properties",
                repeated("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n", 1),
            ),
            ("two vertex elements", text_ply("element vertex 1\nproperty float w\n")),
            ("a huge list", [text_ply(""), b"3 0 1".to_vec()].concat()),
        ],
        "obj" => vec![
            ("a colour of one number", OBJ.replace("Kd 0.8 0.1 0.1", "Kd 0.5").into_bytes()),
            ("a library of the system", repeated("mtllib /dev/zero\n", 3)),
            ("one library many times", [repeated("mtllib a.mtl\n", 10_000), OBJ.into()].concat()),
            (
                "indices of the other end",
                OBJ.replace("f 1/1/1 2/2/1 4/1/1", "f -9223372036854775808 9223372036854775807 0").into_bytes(),
            ),
        ],
        "picture" => vec![
            (
                "a PNG of 400 gigapixels",
                claims(encode_png(&picture()).expect("PNG"), 16, &[0, 0x0a, 0, 0, 0, 0x0a, 0, 0]),
            ),
            ("a JPEG of 4 gigapixels", huge_jpeg()),
        ],
        "graph" => vec![
            ("brackets", repeated("[", 100_000)),
            ("braces", repeated("{a: [", 50_000)),
            ("blocks", repeated("- ", 50_000)),
            ("questions", repeated("? ", 50_000)),
            ("anchors", repeated("- &a a\n", 20_000)),
            ("tags", repeated("!a ", 30_000)),
            ("aliases of aliases", aliases()),
        ],
        "poses" => vec![("brackets", repeated("[", 100_000)), ("objects", repeated("{\"1\":", 100_000))],
        "results" => vec![("commas", repeated(",", 100_000)), ("lines", repeated("\n", 100_000))],
        "weights" => vec![
            ("a header of exabytes", [&u64::MAX.to_le_bytes()[..], b"{}"].concat()),
            ("a tensor of exabytes", bad_weights("[4294967295,4294967295,4294967295]", "[0,16]")),
            ("offsets beyond the end", bad_weights("[2,2]", "[0,1600000000000]")),
        ],
        "cdr" => vec![("a string of 4 GB", [&[0, 1, 0, 0][..], &[0; 8], &[255; 4]].concat())],
        other => panic!("no corpus for {other}"),
    }
}

fn text_ply(element: &str) -> Vec<u8> {
    PLY.replace("element face 4", &format!("{element}element face 4")).into_bytes()
}

fn bad_weights(shape: &str, offsets: &str) -> Vec<u8> {
    let header = format!(r#"{{"a":{{"dtype":"F32","shape":{shape},"data_offsets":{offsets}}}}}"#);
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat()
}

/// Each anchor names the one before nine times.
fn aliases() -> Vec<u8> {
    let mut text = "a0: &a0 x\n".to_owned();
    for i in 1..12 {
        let before = format!("*a{}, ", i - 1).repeat(9);
        text += &format!("a{i}: &a{i} [{before}]\n");
    }
    text.into_bytes()
}
