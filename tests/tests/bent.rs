//! A bent camera is the same camera live and from a recording: what the bridge hands on of an image that came over DDS, and the player of the
//! same messages in a bag, are the same bits. So what is measured from a bag holds live.

use pseudoflow_bag::{BagWriter, Packing, Qos};
use pseudoflow_bridge::{Bridge, BridgeConfig, CameraConfig, DdsEnvironment, Participant, publisher_qos};
use pseudoflow_msgs::ros::{
    BagMessage, CameraInfo, CompressedImage, Header, Image, RegionOfInterest, RosMessage, Time,
};
use pseudoflow_msgs::{CameraFrame, Message};
use pseudoflow_player::{BagOptions, BagSource, FrameSource};
use pseudoflow_runtime::{Context, InMemory, Inputs, Node, Produced};
use ros2_client::{Name, Publisher};
use std::path::Path;
use std::time::{Duration, Instant};

const SIZE: (u32, u32) = (48, 36);
const STAMP_NS: i64 = 1_700_000_000_000_000_000;

/// Size, fx, fy, cx, cy, pixels.
type Frame = ((u32, u32), [f64; 4], Vec<u8>);

fn header(stamp_ns: i64) -> Header {
    Header { stamp: Time::from_ns(stamp_ns).unwrap(), frame_id: "optical".into() }
}

fn noise(count: usize) -> Vec<u8> {
    (0..count as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect()
}

fn raw(encoding: &str, bytes_per_pixel: u32) -> Image {
    let step = SIZE.0 * bytes_per_pixel;
    let data = noise((step * SIZE.1) as usize);
    Image {
        header: header(STAMP_NS),
        height: SIZE.1,
        width: SIZE.0,
        encoding: encoding.into(),
        is_bigendian: 0,
        step,
        data,
    }
}

fn png() -> CompressedImage {
    let picture =
        pseudoflow_imaging::RgbImage::from_raw(SIZE.0, SIZE.1, noise((SIZE.0 * SIZE.1 * 3) as usize)).unwrap();
    let data = pseudoflow_imaging::encode_png(&picture).unwrap();
    CompressedImage { header: header(STAMP_NS), format: "png".into(), data }
}

fn camera(model: &str, d: &[f64]) -> CameraInfo {
    let pinhole = CameraInfo::pinhole(header(STAMP_NS), SIZE, [41.0, 40.0, 23.0, 18.5]);
    CameraInfo { distortion_model: model.into(), d: d.to_vec(), ..pinhole }
}

fn recorded<M: BagMessage>(image: &M, info: &CameraInfo, folder: &Path) -> Frame {
    let bag = folder.join("bag");
    let mut writer = BagWriter::create(&bag, Packing::None).unwrap();
    let images = writer.add_topic::<M>("/image", Qos::RELIABLE).unwrap();
    let infos = writer.add_topic::<CameraInfo>("/camera_info", Qos::RELIABLE).unwrap();
    writer.write(images, STAMP_NS, 0, image).unwrap();
    writer.write(infos, STAMP_NS, 0, info).unwrap();
    writer.finish().unwrap();
    let frame = BagSource::open(&bag, &BagOptions::default()).unwrap().load(0).unwrap();
    ((frame.header.width, frame.header.height), frame.header.intrinsics, frame.rgb)
}

/// Publishes an image and its calibration until the bridge hands a frame on.
fn live<M: RosMessage + std::fmt::Debug>(
    topic: &str,
    image: &M,
    info: &CameraInfo,
    restamp: fn(&M, i64) -> M,
) -> Frame {
    fn publisher<M: RosMessage>(participant: &mut Participant, name: &str) -> Publisher<M> {
        participant.publisher(&Name::parse(name).unwrap(), &publisher_qos(10)).unwrap()
    }
    let namespace = format!("/run{}/{}", std::process::id(), info.distortion_model);
    let context = Context { name: "bridge".into(), seed: 0, out_dir: ".".into(), restarts: 0, replay: false };
    let camera = Some(CameraConfig::of_topic("image"));
    let config = BridgeConfig { namespace: namespace.clone(), camera, ..BridgeConfig::default() };
    let mut bridge = Bridge::create(config, &context).unwrap();
    let mut driver = Participant::open(DdsEnvironment::of_process().unwrap(), "/", "driver").unwrap();
    let images = publisher::<M>(&mut driver, &format!("{namespace}/{topic}"));
    let infos = publisher::<CameraInfo>(&mut driver, &format!("{namespace}/camera_info"));
    let (mut sent, start) = (InMemory::default(), Instant::now());
    for stamp_ns in STAMP_NS.. {
        infos.publish(CameraInfo { header: header(stamp_ns), ..info.clone() }).unwrap();
        images.publish(restamp(image, stamp_ns)).unwrap();
        if matches!(bridge.poll(&mut sent, &context).unwrap(), Produced::Frame(_)) {
            break;
        }
        assert!(start.elapsed() < Duration::from_secs(30), "{}: no frame within 30 s", info.distortion_model);
        std::thread::sleep(Duration::from_millis(10));
    }
    let frame = CameraFrame::view(sent.bytes("frame").unwrap()).unwrap();
    ((frame.header.width, frame.header.height), frame.header.intrinsics, frame.rgb.to_vec())
}

fn assert_equal((live, recorded): (Frame, Frame), raw: &[u8], model: &str) {
    assert_eq!((live.0, live.1), (recorded.0, recorded.1), "{model}");
    assert!(live.2 == recorded.2, "{model}: other pixels live than from a bag");
    assert!(live.2 != raw, "{model}: the images were not rectified");
}

fn same_raw(encoding: &str, bytes_per_pixel: u32, info: &CameraInfo) {
    let folder = tempfile::tempdir().unwrap();
    let image = raw(encoding, bytes_per_pixel);
    let live = live("image", &image, info, |image, stamp_ns| Image { header: header(stamp_ns), ..image.clone() });
    assert_equal((live, recorded(&image, info, folder.path())), &image.data, &info.distortion_model);
}

#[test]
fn plumb_bob() {
    same_raw("rgb8", 3, &camera("plumb_bob", &[-0.28, 0.09, 0.0012, -0.0007, -0.013]));
}

#[test]
fn equidistant_in_a_region_of_a_bayer_sensor() {
    let roi = RegionOfInterest { x_offset: 8, y_offset: 4, width: SIZE.0, height: SIZE.1, do_rectify: false };
    let info = CameraInfo { roi, width: 64, height: 48, ..camera("equidistant", &[-0.013, 0.021, -0.017, 0.004]) };
    same_raw("bayer_rggb8", 1, &info);
}

#[test]
fn rational_polynomial_in_files() {
    let (folder, image) = (tempfile::tempdir().unwrap(), png());
    let d = [0.42, -2.1, 0.0006, -0.0003, 1.4, 0.31, -1.95, 1.33];
    let info = camera("rational_polynomial", &d);
    let restamp = |image: &CompressedImage, stamp_ns| CompressedImage { header: header(stamp_ns), ..image.clone() };
    let live = live("image/compressed", &image, &info, restamp);
    assert_equal((live, recorded(&image, &info, folder.path())), &noise((SIZE.0 * SIZE.1 * 3) as usize), "rational");
}
