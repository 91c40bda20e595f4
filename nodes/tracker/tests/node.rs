//! The tracker node in memory: what it waits for in replay, what it sends, and that it repeats itself.

use pseudoflow_msgs::{
    AlignedBytes, CameraFrame, CameraFrameHeader, FrameKey, Message, ObjectPose, ObjectPoses, ObjectStatus,
    ObjectStatuses, TrackPhase, TrackReason, Wanted,
};
use pseudoflow_runtime::{Context, InMemory, Inputs, Node};
use pseudoflow_tracker::{TrackerNode, TrackerNodeConfig};
use std::path::{Path, PathBuf};

/// A frame with what has come late.
struct Arrived {
    key: FrameKey,
    frame: AlignedBytes,
    looks: Vec<(FrameKey, AlignedBytes)>,
    search: Option<AlignedBytes>,
}

impl Inputs for Arrived {
    fn key(&self) -> FrameKey {
        self.key
    }

    fn bytes(&self, port: &str) -> Option<&[u8]> {
        match port {
            "frame" => Some(&*self.frame),
            "search" => self.search.as_deref(),
            _ => None,
        }
    }

    fn late(&self, port: &str) -> Vec<(FrameKey, &[u8])> {
        let looks = self.looks.iter().filter(|_| port == "looks");
        looks.map(|(key, bytes)| (*key, &**bytes)).collect()
    }

    fn is_connected(&self, port: &str) -> bool {
        port != "found"
    }
}

fn key(index: u64) -> FrameKey {
    FrameKey { index, stamp_ns: 1_000_000_000 + index as i64 * 33_333_333 }
}

fn frame(index: u64, looks: &[(u64, Vec<ObjectPose>)]) -> Arrived {
    let header = CameraFrameHeader {
        width: 160,
        height: 120,
        scene_id: 1,
        image_id: index as u32,
        intrinsics: [150.0, 150.0, 79.5, 59.5],
        frame_id: CameraFrameHeader::frame_id_bytes("camera").unwrap(),
    };
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(160, 120));
    let rgb = CameraFrame::write(&mut bytes, header).rgb;
    rgb.iter_mut().enumerate().for_each(|(i, v)| *v = (i * 7 % 251) as u8);
    let message = |(of, poses): &(u64, Vec<ObjectPose>)| {
        let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(poses.len()));
        ObjectPoses::write(&mut bytes, 1, *of as u32, poses);
        (key(*of), bytes)
    };
    Arrived { key: key(index), frame: bytes, looks: looks.iter().map(message).collect(), search: None }
}

fn config() -> TrackerNodeConfig {
    let objects = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects/tabletop");
    let contours = Some(std::env::temp_dir().join("pseudoflow-contours"));
    TrackerNodeConfig { expected: Some(vec![7]), contours, look_delay: 2, ..TrackerNodeConfig::new(objects) }
}

fn context(replay: bool) -> Context {
    Context { name: "tracker".into(), seed: 1, out_dir: PathBuf::new(), restarts: 0, replay }
}

fn sent(node: &mut TrackerNode, arrived: &Arrived) -> InMemory {
    let mut out = InMemory::new(arrived.key);
    node.process(arrived, &mut out, &context(true)).unwrap();
    out
}

#[test]
fn what_cannot_be_searched_for_yet_is_said() {
    let mut node = TrackerNode::create(config(), &context(false)).unwrap();
    let reason = |node: &mut TrackerNode, index, reason: TrackReason| {
        let said = ObjectStatus {
            object_id: 7,
            instance: 0,
            phase: TrackPhase::Searching as u32,
            reason: reason as u32,
            good_frames: 0,
            bad_frames: 0,
            score: 0.25,
        };
        let mut bytes = AlignedBytes::zeroed(ObjectStatuses::byte_len(1));
        ObjectStatuses::write(&mut bytes, false, &[said]);
        let arrived = Arrived { search: Some(bytes), ..frame(index, &[]) };
        let mut out = InMemory::new(arrived.key);
        node.process(&arrived, &mut out, &context(false)).unwrap();
        let status = ObjectStatuses::view(out.bytes("status").unwrap()).unwrap().statuses[0];
        (status.reason, status.score)
    };
    assert_eq!(reason(&mut node, 0, TrackReason::Preparing), (TrackReason::Preparing as u32, 0.25));
    assert_eq!(
        reason(&mut node, 1, TrackReason::Detected),
        (TrackReason::NotFound as u32, 0.0),
        "the tracker's own word"
    );
}

#[test]
fn a_frame_waits_for_the_looks_of_an_earlier_one_in_replay_alone() {
    let mut node = TrackerNode::create(config(), &context(true)).unwrap();
    for index in 0..2 {
        assert!(node.ready(&frame(index, &[])).unwrap(), "nobody can have looked yet");
        let out = sent(&mut node, &frame(index, &[]));
        assert_eq!(out.messages.len(), 4, "each output once");
        assert_eq!(Wanted::view(out.bytes("wanted").unwrap()).unwrap().object_ids, [7]);
        let status = ObjectStatuses::view(out.bytes("status").unwrap()).unwrap().statuses[0];
        assert_eq!(status.reason, TrackReason::NotFound as u32);
    }
    assert!(!node.ready(&frame(2, &[])).unwrap());
    assert!(!node.ready(&frame(3, &[(0, Vec::new())])).unwrap(), "frame 1 has not been looked at");
    assert!(node.ready(&frame(2, &[(0, Vec::new())])).unwrap());
    let live = TrackerNode::create(config(), &context(false)).unwrap();
    assert!(live.ready(&frame(9, &[])).unwrap());
}

#[test]
fn live_nothing_is_asked_for_where_nothing_is_wanted() {
    for replay in [true, false] {
        let mut node = TrackerNode::create(config(), &context(replay)).unwrap();
        let out = sent(&mut node, &frame(0, &[]));
        assert_eq!(out.bytes("requests").is_some(), replay);
        assert!(out.bytes("poses").is_some() && out.bytes("status").is_some());
    }
}

#[test]
fn a_frame_that_comes_again_gets_what_it_got() {
    let mut node = TrackerNode::create(config(), &context(true)).unwrap();
    let first: Vec<InMemory> = (0..2).map(|i| sent(&mut node, &frame(i, &[]))).collect();
    let again = sent(&mut node, &frame(0, &[]));
    for (port, bytes) in &first[0].messages {
        assert_eq!(again.bytes(port).unwrap(), &**bytes, "{port}");
    }
}

#[test]
fn settings_that_cannot_be_are_named() {
    let error = |config: TrackerNodeConfig| TrackerNode::check(&config).unwrap_err().to_string();
    assert!(error(TrackerNodeConfig { look_score: 2.0, ..config() }).contains("look_score"));
    assert!(error(TrackerNodeConfig { expected: Some(Vec::new()), ..config() }).contains("expected"));
    assert!(error(TrackerNodeConfig::new(PathBuf::from("/nowhere"))).contains("models_info.json"));
    let unknown = TrackerNode::create(TrackerNodeConfig { expected: Some(vec![99]), ..config() }, &context(true));
    assert!(unknown.err().is_some_and(|e| e.to_string().contains("99")));
}
