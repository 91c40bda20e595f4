//! The node as the runtime runs it, with a Rust participant as the world outside.

use pseudoflow_bridge::{Bridge, BridgeConfig, CameraConfig, DdsEnvironment, Participant, publisher_qos, sensor_qos};
use pseudoflow_msgs::ros::{
    CameraInfo, Detection3DArray, DiagnosticArray, Header, Image, Naming, PoseStamped, RosMessage, TFMessage, Time,
    detections,
};
use pseudoflow_msgs::{CameraFrame, FrameKey, Message, ObjectPose, ObjectPoses, PoseSource, PoseStatus};
use pseudoflow_runtime::{Context, InMemory, Inputs, Node, Outputs, Produced};
use ros2_client::{Name, Publisher, Subscription};
use std::time::{Duration, Instant};

const STAMP_NS: i64 = 1_700_000_000_000_000_042;

fn context() -> Context {
    Context { name: "bridge".into(), seed: 0, out_dir: ".".into(), restarts: 0, replay: false }
}

/// A namespace of one test in this run alone: tests of one process run side by side.
fn namespace(test: &str) -> String {
    format!("/run{}/{test}", std::process::id())
}

fn config(namespace: &str, camera: bool) -> BridgeConfig {
    // The transport is what is there, the calibration beside the images.
    let camera =
        camera.then(|| CameraConfig { detections: Some("detections".into()), ..CameraConfig::of_topic("image") });
    BridgeConfig { namespace: namespace.into(), object_names: names(), camera, ..BridgeConfig::default() }
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
    participant: Participant,
    images: Publisher<Image>,
    infos: Publisher<CameraInfo>,
    detections: Publisher<Detection3DArray>,
    object_pose: Subscription<PoseStamped>,
    tf: Subscription<TFMessage>,
    diagnostics: Subscription<DiagnosticArray>,
}

impl World {
    fn new(namespace: &str) -> Self {
        let mut participant = Participant::open(DdsEnvironment::of_process().unwrap(), "/", "world").unwrap();
        fn publish<M: RosMessage>(participant: &mut Participant, (namespace, name): (&str, &str)) -> Publisher<M> {
            participant.publisher(&Name::new(namespace, name).unwrap(), &publisher_qos(10)).unwrap()
        }
        Self {
            images: publish(&mut participant, (namespace, "image")),
            infos: publish(&mut participant, (namespace, "camera_info")),
            detections: publish(&mut participant, (namespace, "detections")),
            object_pose: participant
                .subscription(&Name::new(namespace, "object_pose").unwrap(), &sensor_qos(10))
                .unwrap(),
            tf: participant.subscription(&Name::new("/", "tf").unwrap(), &sensor_qos(10)).unwrap(),
            diagnostics: participant
                .subscription(&Name::new(namespace, "diagnostics").unwrap(), &publisher_qos(100))
                .unwrap(),
            participant,
        }
    }

    fn take_picture(&self, stamp_ns: i64) {
        self.take_changed(stamp_ns, |_| {}, |_| {}, |_| {});
    }

    /// A picture with something wrong about it.
    fn take_changed(
        &self,
        stamp_ns: i64,
        of_image: impl Fn(&mut Image),
        of_info: impl Fn(&mut CameraInfo),
        of_detections: impl Fn(&mut Detection3DArray),
    ) {
        let header = Header { stamp: Time::from_ns(stamp_ns).unwrap(), frame_id: "optical".into() };
        let mut info = CameraInfo {
            header: header.clone(),
            height: 2,
            width: 2,
            k: [9.0, 0.0, 0.5, 0.0, 8.0, 0.25, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        };
        let mut image = Image {
            header: header.clone(),
            height: 2,
            width: 2,
            encoding: "bgr8".into(),
            is_bigendian: 0,
            step: 6,
            data: (0..12).collect(),
        };
        let mut found = detections(&header, &[pose()], &Naming::new(names()).unwrap());
        of_image(&mut image);
        of_info(&mut info);
        of_detections(&mut found);
        self.infos.publish(info).unwrap();
        self.detections.publish(found).unwrap();
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
    let own = namespace("poses");
    let mut bridge = Bridge::create(config(&own, true), &context()).unwrap();
    let world = World::new(&own);
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
        (&header, format!("{}/mustard", &own[1..]).as_str())
    );
}

/// Polls for a while and counts the frames that come.
fn frames_of(bridge: &mut Bridge, seconds: f64) -> usize {
    let (start, mut sent, mut frames) = (Instant::now(), InMemory::default(), 0);
    while start.elapsed().as_secs_f64() < seconds {
        match bridge.poll(&mut sent, &context()).unwrap() {
            Produced::Frame(_) => frames += 1,
            _ => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    frames
}

/// The stamp has to go up: images older than one that went on are late.
fn next_stamp(stamp_ns: &mut i64) -> i64 {
    *stamp_ns += 1000;
    *stamp_ns
}

#[test]
fn every_wrong_field_is_dropped_and_named_and_the_camera_goes_on() {
    let own = namespace("hostile");
    let mut bridge = Bridge::create(config(&own, true), &context()).unwrap();
    let world = World::new(&own);
    let mut stamp_ns = STAMP_NS;
    let good = |bridge: &mut Bridge, stamp_ns: &mut i64| {
        until("a good frame", || {
            world.take_picture(next_stamp(stamp_ns));
            (frames_of(bridge, 0.02) > 0).then_some(())
        });
    };
    good(&mut bridge, &mut stamp_ns);
    frames_of(&mut bridge, 0.3);

    type Change<M> = Box<dyn Fn(&mut M)>;
    let images: Vec<(&str, Change<Image>)> = vec![
        ("image", Box::new(|m| m.encoding = "16UC1".into())),
        ("image", Box::new(|m| m.encoding = "x".repeat(5000))),
        ("image", Box::new(|m| m.data.truncate(5))),
        ("image", Box::new(|m| m.step = u32::MAX)),
        ("image", Box::new(|m| (m.width, m.height) = (0, 0))),
        ("image", Box::new(|m| (m.width, m.height) = (u32::MAX, u32::MAX))),
        ("calibration", Box::new(|m| (m.width, m.height, m.step, m.data) = (1, 1, 3, vec![0; 3]))),
        ("frame_id", Box::new(|m| m.header.frame_id = "f".repeat(64))),
        ("stamp", Box::new(|m| m.header.stamp.sec = -5)),
        ("stamp", Box::new(|m| m.header.stamp.nanosec = u32::MAX)),
    ];
    let infos: Vec<(&str, Change<CameraInfo>)> = vec![
        ("calibration", Box::new(|m| m.k = [f64::NAN; 9])),
        ("calibration", Box::new(|m| m.k[1] = 3.0)),
        ("calibration", Box::new(|m| m.d = vec![f64::INFINITY; 5])),
        ("calibration", Box::new(|m| (m.distortion_model, m.d) = ("none".into(), vec![1.0]))),
        ("calibration", Box::new(|m| m.roi.x_offset = u32::MAX)),
        ("calibration", Box::new(|m| (m.binning_x, m.binning_y) = (u32::MAX, u32::MAX))),
        ("calibration", Box::new(|m| m.width = 77)),
        ("stamp", Box::new(|m| m.header.stamp.sec = i32::MIN)),
    ];
    let mut wrong = std::collections::BTreeSet::new();
    for (kind, change) in &images {
        world.take_changed(next_stamp(&mut stamp_ns), change, |_| {}, |_| {});
        wrong.insert(*kind);
        assert_eq!(frames_of(&mut bridge, 0.05), 0, "{kind}");
        good(&mut bridge, &mut stamp_ns);
    }
    for (kind, change) in &infos {
        world.take_changed(next_stamp(&mut stamp_ns), |_| {}, change, |_| {});
        wrong.insert(*kind);
        good(&mut bridge, &mut stamp_ns);
    }
    let detections: Vec<(&str, Change<Detection3DArray>)> = vec![
        ("unknown object", Box::new(|m| m.detections[0].results[0].hypothesis.class_id = "teapot".into())),
        ("unknown object", Box::new(|m| m.detections[0].results[0].hypothesis.class_id = "6".into())),
        ("pose", Box::new(|m| m.detections[0].results[0].pose.pose.position.z = f64::NAN)),
        ("pose", Box::new(|m| m.detections[0].results[0].pose.pose.position.z = -1.0)),
        ("score", Box::new(|m| m.detections[0].results[0].hypothesis.score = f64::INFINITY)),
        ("empty", Box::new(|m| m.detections[0].results.clear())),
        ("frame_id", Box::new(|m| m.header.frame_id = "elsewhere".into())),
        ("stamp", Box::new(|m| m.header.stamp.sec = -1)),
    ];
    for (kind, change) in &detections {
        world.take_changed(next_stamp(&mut stamp_ns), |_| {}, |_| {}, change);
        wrong.insert(*kind);
        good(&mut bridge, &mut stamp_ns);
    }
    let mut named = std::collections::BTreeSet::new();
    until("the account of all that was dropped", || {
        frames_of(&mut bridge, 0.2);
        while let Some((report, _)) = world.diagnostics.take().unwrap() {
            named.extend(report.status.iter().map(|status| status.values[0].value.clone()));
        }
        wrong.iter().all(|kind| named.contains(*kind)).then_some(())
    });
}

#[test]
fn the_topics_are_those_of_the_page() {
    let own = namespace("page");
    let _bridge = Bridge::create(config(&own, false), &context()).unwrap();
    let world = World::new(&own);
    for topic in pseudoflow_bridge::topics().iter().filter(|t| t.direction == pseudoflow_bridge::Direction::Out) {
        let name = topic.name.replace("NAME", "mustard");
        let name = if name.starts_with('/') { name } else { format!("{own}/{name}") };
        until(&name, || (world.participant.publishers(&name) > 0).then_some(()));
    }
}

#[test]
fn a_bridge_without_camera_says_what_the_graph_lacks() {
    let mut bridge = Bridge::create(config(&namespace("alone"), false), &context()).unwrap();
    let no_camera = bridge.poll(&mut InMemory::default(), &context()).unwrap_err();
    assert!(no_camera.to_string().contains("camera: ..."), "{no_camera}");
    let key = FrameKey { index: 0, stamp_ns: STAMP_NS };
    let no_frame = bridge.process(&poses(key), &mut InMemory::default(), &context()).unwrap_err();
    assert!(no_frame.to_string().contains("`frame`"), "{no_frame}");
    let no_poses = bridge.process(&InMemory::new(key), &mut InMemory::default(), &context()).unwrap_err();
    assert!(no_poses.to_string().contains("`poses`"), "{no_poses}");
}
