//! The node with a small untrained network: what it says without anything found, and how it waits for what it sent.

use pseudoflow_inference::{Backend, EngineConfig};
use pseudoflow_initializer::track::TrackConfig;
use pseudoflow_initializer::{CompareConfig, InitializerConfig, InitializerNode};
use pseudoflow_msgs::{
    AlignedBytes, CameraFrame, CameraFrameHeader, FrameKey, Message, ObjectPoses, ObjectStatuses, TrackPhase,
    TrackReason, Wanted,
};
use pseudoflow_network::{DetectorConfig, NetworkConfig, Weights};
use pseudoflow_runtime::{Context, InMemory, Node};
use std::path::{Path, PathBuf};

const NETWORK: &str = "name: tiny\ninput_px: [96, 64]\nwidths: [16, 24]\npyramid: 16\n";

fn objects() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop")
}

fn config(folder: &Path, ids: &[u32]) -> InitializerConfig {
    let network = folder.join("tiny.yaml");
    std::fs::write(&network, NETWORK).unwrap();
    let detector = DetectorConfig::named(&network.to_string_lossy(), ids.len()).unwrap();
    let mut weights = Weights::random(&detector, 1);
    weights.info.object_ids = ids.to_vec();
    let model = folder.join("w.safetensors");
    weights.save(&model).unwrap();
    InitializerConfig {
        network: network.to_string_lossy().into(),
        track: Some(TrackConfig::default()),
        engine: EngineConfig { backend: Backend::Rten, ..EngineConfig::default() },
        ..InitializerConfig::new(model, objects())
    }
}

fn context(replay: bool) -> Context {
    Context { name: "initializer".into(), seed: 1, out_dir: PathBuf::new(), restarts: 0, replay }
}

fn frame(index: u64) -> InMemory {
    let header = CameraFrameHeader {
        width: 64,
        height: 48,
        scene_id: 3,
        image_id: 10 + index as u32,
        intrinsics: [60.0, 60.0, 31.5, 23.5],
        frame_id: CameraFrameHeader::frame_id_bytes("camera").unwrap(),
    };
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(64, 48));
    CameraFrame::write(&mut bytes, header).rgb.iter_mut().enumerate().for_each(|(i, v)| *v = (31 * i) as u8);
    let mut inputs = InMemory::new(FrameKey { index, stamp_ns: 40_000_000 * index as i64 });
    inputs.messages.push(("frame".into(), bytes));
    inputs
}

/// The refined poses of a frame, none of them.
fn add_poses(inputs: &mut InMemory, image_id: u32) {
    let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(0));
    ObjectPoses::write(&mut bytes, 3, image_id, &[]);
    inputs.messages.push(("poses".into(), bytes));
}

fn process(node: &mut InitializerNode, inputs: &InMemory) -> InMemory {
    let mut outputs = InMemory::default();
    node.process(inputs, &mut outputs, &context(true)).unwrap();
    outputs
}

#[test]
fn nothing_found_is_said_and_every_object_is_searched_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = InitializerNode::create(config(folder.path(), &[1, 2, 3, 5, 7]), &context(true)).unwrap();
    let outputs = process(&mut node, &frame(0));
    let bytes = |port: &str| &outputs.messages.iter().find(|(name, _)| name == port).unwrap().1;
    let poses = ObjectPoses::view(bytes("initial_poses")).unwrap();
    assert_eq!((poses.header.scene_id, poses.header.image_id, poses.poses.len()), (3, 10, 0));
    let statuses = ObjectStatuses::view(bytes("status")).unwrap();
    assert_eq!(statuses.header.searched, 1);
    assert_eq!(statuses.statuses.iter().map(|s| s.object_id).collect::<Vec<_>>(), [1, 2, 3, 5, 7]);
    assert!(statuses.statuses.iter().all(|s| s.phase == TrackPhase::Searching as u32));
}

#[test]
fn a_frame_waits_for_the_refined_poses_of_the_one_before_where_nothing_may_be_lost() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), &[1, 2, 3, 5, 7]);
    let mut node = InitializerNode::create(config.clone(), &context(true)).unwrap();
    assert!(node.ready(&frame(0)).unwrap());
    let first = process(&mut node, &frame(0));
    assert!(!node.ready(&frame(1)).unwrap(), "no poses yet");
    let (mut early, mut good) = (frame(1), frame(1));
    add_poses(&mut early, 9);
    add_poses(&mut good, 10);
    assert!(!node.ready(&early).unwrap(), "those of another frame");
    assert!(node.ready(&good).unwrap());
    process(&mut node, &good);
    // Another node died: the first frame comes again, and gets what it got.
    assert!(node.ready(&frame(0)).unwrap());
    for ((_, again), (port, before)) in process(&mut node, &frame(0)).messages.iter().zip(&first.messages) {
        assert!(**again == **before, "{port}");
    }
    let mut live = InitializerNode::create(config, &context(false)).unwrap();
    process(&mut live, &frame(0));
    assert!(live.ready(&frame(1)).unwrap(), "a live camera does not wait");
}

/// Adds what a tracker wants.
fn add_wanted(inputs: &mut InMemory, ids: &[u32]) {
    let mut bytes = AlignedBytes::zeroed(Wanted::byte_len(ids.len()));
    Wanted::write(&mut bytes, 3, 10, ids);
    inputs.messages.push(("wanted".into(), bytes));
}

#[test]
fn only_what_is_wanted_is_searched_for_and_what_is_not_found_less_often() {
    let folder = tempfile::tempdir().unwrap();
    let config = InitializerConfig { track: None, ..config(folder.path(), &[1, 2, 3, 5, 7]) };
    let mut node = InitializerNode::create(config, &context(true)).unwrap();
    let searched = |node: &mut InitializerNode, index: u64, ids: &[u32]| {
        let mut inputs = frame(index);
        add_wanted(&mut inputs, ids);
        let outputs = process(node, &inputs);
        let status = &outputs.messages.iter().find(|(name, _)| name == "status").unwrap().1;
        ObjectStatuses::view(status).unwrap().header.searched == 1
    };
    assert!(!searched(&mut node, 0, &[]), "nothing is wanted");
    assert!(searched(&mut node, 1, &[2]));
    assert!(!searched(&mut node, 2, &[2]), "40 ms later it is too early");
    assert!(searched(&mut node, 3, &[2, 7]), "another one");
    assert!(searched(&mut node, 30, &[2]));
    assert!(searched(&mut node, 3, &[2, 7]), "a frame that comes again gets what it got");
}

#[test]
fn a_camera_is_told_what_is_being_prepared() {
    let folder = tempfile::tempdir().unwrap();
    let flow = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/weights/nano_tabletop.safetensors");
    let compare =
        CompareConfig { directions: 4, turns: 4, cache: Some(folder.path().join("views")), ..CompareConfig::new(flow) };
    let config = InitializerConfig { compare: Some(compare), track: None, ..config(folder.path(), &[1, 2, 3, 5, 7]) };
    let mut live = InitializerNode::create(config, &context(false)).unwrap();
    let reasons = |live: &mut InitializerNode, index: u64| {
        let mut inputs = frame(index);
        add_wanted(&mut inputs, &[]);
        let outputs = process(live, &inputs);
        let status = &outputs.messages.iter().find(|(name, _)| name == "status").unwrap().1;
        let statuses = ObjectStatuses::view(status).unwrap().statuses.to_vec();
        statuses.iter().filter(|s| s.reason == TrackReason::Preparing as u32).count()
    };
    let first = reasons(&mut live, 0);
    assert!(first > 0 && first <= 5, "{first}");
    assert_eq!((1..10).map(|index| reasons(&mut live, index)).min(), Some(0), "it comes to an end");
}

#[test]
fn weights_that_do_not_fit_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let refused =
        |config: InitializerConfig| InitializerNode::create(config, &context(true)).err().unwrap().to_string();
    let text = refused(config(folder.path(), &[1, 4]));
    assert!(text.contains("object 4") && text.contains("[1, 2, 3, 5, 7]"), "{text}");
    let good = config(folder.path(), &[1, 2]);
    Weights::random(&NetworkConfig::nano(), 1).save(&folder.path().join("flow.safetensors")).unwrap();
    let text = refused(InitializerConfig { model: folder.path().join("flow.safetensors"), ..good.clone() });
    assert!(text.contains("which objects it finds") && text.contains("--stage initializer"), "{text}");
    let text = refused(InitializerConfig { network: "nano".into(), ..good.clone() });
    assert!(text.contains("shape"), "{text}");
    let missing = InitializerConfig { model: folder.path().join("none.safetensors"), ..good };
    assert!(InitializerNode::check(&missing).unwrap_err().to_string().contains("no such file"));
}
