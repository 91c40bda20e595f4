//! The node as the runtime runs it, with a Rust participant as the world outside.

use pseudoflow_bridge::{Bridge, BridgeConfig, CameraConfig, DdsEnvironment, Participant, publisher_qos, sensor_qos};
use pseudoflow_msgs::ros::{
    CameraInfo, Detection3DArray, Header, Image, Naming, PoseStamped, RosMessage, TFMessage, Time, detections,
};
use pseudoflow_msgs::{CameraFrame, FrameKey, Message, ObjectPose, ObjectPoses, PoseSource, PoseStatus};
use pseudoflow_runtime::{Context, InMemory, Inputs, Node, Outputs, Produced};
use ros2_client::{Name, Publisher, Subscription};
use std::time::{Duration, Instant};

const STAMP_NS: i64 = 1_700_000_000_000_000_042;

fn context() -> Context {
    Context { name: "bridge".into(), seed: 0, out_dir: ".".into(), restarts: 0, replay: false }
}

/// A namespace of this run alone.
fn namespace() -> String {
    format!("/run{}", std::process::id())
}

fn config(camera: bool) -> BridgeConfig {
    let topic = |name: &str| format!("{}/{name}", namespace());
    let camera = camera.then(|| CameraConfig {
        image: topic("image"),
        transport: Default::default(),
        camera_info: topic("camera_info"),
        rectified: false,
        detections: Some(topic("detections")),
        queue_depth: 10,
    });
    BridgeConfig { namespace: namespace(), object_names: names(), camera, ..BridgeConfig::default() }
}

fn names() -> std::collections::BTreeMap<u32, String> {
    [(5, "mustard".to_owned())].into()
}

fn pose() -> ObjectPose {
    ObjectPose {
        object_id: 5,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: PoseSource::Given as u32,
        score: 0.5,
        rotation_xyzw: [0.5, 0.5, 0.5, 0.5],
        translation_m: [0.1, 0.2, 0.3],
        covariance: std::array::from_fn(|i| i as f64),
    }
}

fn poses(key: FrameKey) -> InMemory {
    let mut inputs = InMemory::new(key);
    let fill = &mut |bytes: &mut [u8]| ObjectPoses::write(bytes, 0, 0, &[pose()]);
    inputs.send("poses", key, ObjectPoses::byte_len(1), fill).unwrap();
    inputs
}

/// The world outside: a camera and a detector, and somebody who wants poses.
struct World {
    _participant: Participant,
    images: Publisher<Image>,
    infos: Publisher<CameraInfo>,
    detections: Publisher<Detection3DArray>,
    object_pose: Subscription<PoseStamped>,
    tf: Subscription<TFMessage>,
}

impl World {
    fn new() -> Self {
        let mut participant = Participant::open(DdsEnvironment::of_process().unwrap(), "/", "world").unwrap();
        fn publish<M: RosMessage>(participant: &mut Participant, name: &str) -> Publisher<M> {
            participant.publisher(&Name::new(&namespace(), name).unwrap(), &publisher_qos(10)).unwrap()
        }
        Self {
            images: publish(&mut participant, "image"),
            infos: publish(&mut participant, "camera_info"),
            detections: publish(&mut participant, "detections"),
            object_pose: participant
                .subscription(&Name::new(&namespace(), "object_pose").unwrap(), &sensor_qos(10))
                .unwrap(),
            tf: participant.subscription(&Name::new("/", "tf").unwrap(), &sensor_qos(10)).unwrap(),
            _participant: participant,
        }
    }

    fn take_picture(&self, stamp_ns: i64) {
        let header = Header { stamp: Time::from_ns(stamp_ns).unwrap(), frame_id: "optical".into() };
        let info = CameraInfo {
            header: header.clone(),
            height: 2,
            width: 2,
            k: [9.0, 0.0, 0.5, 0.0, 8.0, 0.25, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        };
        let image = Image {
            header: header.clone(),
            height: 2,
            width: 2,
            encoding: "bgr8".into(),
            is_bigendian: 0,
            step: 6,
            data: (0..12).collect(),
        };
        self.infos.publish(info).unwrap();
        self.detections.publish(detections(&header, &[pose()], &Naming::new(names()).unwrap())).unwrap();
        self.images.publish(image).unwrap();
    }
}

/// Repeats `step` until it gives something: participants need a moment to find each other.
fn until<T>(what: &str, mut step: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(result) = step() {
            return result;
        }
        assert!(start.elapsed() < Duration::from_secs(30), "{what} did not come within 30 s");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_live_camera_goes_in_and_its_poses_come_out() {
    let mut bridge = Bridge::create(config(true), &context()).unwrap();
    let world = World::new();
    let mut sent = InMemory::default();
    let mut stamp_ns = STAMP_NS;
    let key = until("a frame", || {
        stamp_ns += 1;
        world.take_picture(stamp_ns);
        match bridge.poll(&mut sent, &context()).unwrap() {
            Produced::Frame(key) => Some(key),
            _ => None,
        }
    });
    assert!(key.index == 0 && (STAMP_NS..=stamp_ns).contains(&key.stamp_ns), "{key:?}");
    let frame = CameraFrame::view(sent.bytes("frame").unwrap()).unwrap();
    assert_eq!(frame.rgb, [2, 1, 0, 5, 4, 3, 8, 7, 6, 11, 10, 9]);
    assert_eq!((frame.header.intrinsics, frame.header.frame_id()), ([9.0, 8.0, 0.5, 0.25], "optical"));
    let initial = ObjectPoses::view(sent.bytes("initial_poses").unwrap()).unwrap();
    assert_eq!(initial.poses, [pose()]);

    // The refined poses come back without their image: the bridge knows its frame.
    let (stamped, tf) = until("a pose", || {
        bridge.process(&poses(key), &mut InMemory::default(), &context()).unwrap();
        Some((world.object_pose.take().unwrap()?.0, world.tf.take().unwrap()?.0))
    });
    let header = Header { stamp: Time::from_ns(key.stamp_ns).unwrap(), frame_id: "optical".into() };
    assert_eq!((stamped.header, stamped.pose.position.z), (header.clone(), 0.3));
    assert_eq!(
        (&tf.transforms[0].header, tf.transforms[0].child_frame_id.as_str()),
        (&header, format!("run{}/mustard", std::process::id()).as_str())
    );
}

#[test]
fn a_bridge_without_camera_says_what_the_graph_lacks() {
    let mut bridge = Bridge::create(BridgeConfig { namespace: "/alone".into(), ..config(false) }, &context()).unwrap();
    let no_camera = bridge.poll(&mut InMemory::default(), &context()).unwrap_err();
    assert!(no_camera.to_string().contains("camera: ..."), "{no_camera}");
    let key = FrameKey { index: 0, stamp_ns: STAMP_NS };
    let no_frame = bridge.process(&poses(key), &mut InMemory::default(), &context()).unwrap_err();
    assert!(no_frame.to_string().contains("`frame`"), "{no_frame}");
    let no_poses = bridge.process(&InMemory::new(key), &mut InMemory::default(), &context()).unwrap_err();
    assert!(no_poses.to_string().contains("`poses`"), "{no_poses}");
}
