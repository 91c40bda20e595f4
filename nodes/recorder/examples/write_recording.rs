//! Runs the recorder on made-up frames: `write_recording OUT FRAMES [OBJECTS]`. For the tests with `rosbags` and rerun.
//! Half-way the recorder is dropped as if killed, and a second one goes on: the recording has two files.

use pseudoflow_msgs::{
    AlignedBytes, CameraFrame, CameraFrameHeader, FRAME_ID_BYTES, FrameKey, ObjectPose, ObjectPoses, PoseSource,
    PoseStatus,
};
use pseudoflow_recorder::{OverlayConfig, RecorderConfig, RecorderNode};
use pseudoflow_runtime::{Context, InMemory, Node, NodeError};
use std::path::PathBuf;

const SIZE: (u32, u32) = (320, 240);

fn pose(object_id: u32, index: u64, source: PoseSource) -> ObjectPose {
    let half_turn = 0.05 * index as f64 + if source == PoseSource::Given { 0.1 } else { 0.0 };
    ObjectPose {
        object_id,
        instance: 0,
        status: PoseStatus::Ok as u32,
        source: source as u32,
        score: 0.9,
        rotation_xyzw: [half_turn.sin(), 0.0, 0.0, half_turn.cos()],
        translation_m: [0.02 * f64::from(object_id) - 0.1, 0.0, 0.8],
        covariance: [0.0; 36],
    }
}

fn frame(index: u64) -> InMemory {
    let stamp_ns = 1_700_000_000_000_000_000 + 33_333_333 * index as i64;
    let mut inputs = InMemory::new(FrameKey { index, stamp_ns });
    let header = CameraFrameHeader {
        width: SIZE.0,
        height: SIZE.1,
        scene_id: 1,
        image_id: index as u32,
        intrinsics: [300.0, 300.0, 159.5, 119.5],
        frame_id: CameraFrameHeader::frame_id_bytes("camera_optical_frame").unwrap_or([0; FRAME_ID_BYTES]),
    };
    let mut bytes = AlignedBytes::zeroed(CameraFrame::byte_len(SIZE.0, SIZE.1));
    for (i, value) in CameraFrame::write(&mut bytes, header).rgb.iter_mut().enumerate() {
        *value = (i as u64 / 960 + index * 8) as u8;
    }
    inputs.messages.push(("frame".into(), bytes));
    for (port, source) in [("initial_poses", PoseSource::Given), ("poses", PoseSource::Refined)] {
        let poses = [1, 5].map(|object_id| pose(object_id, index, source));
        let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(poses.len()));
        ObjectPoses::write(&mut bytes, 1, index as u32, &poses);
        inputs.messages.push((port.into(), bytes));
    }
    inputs
}

fn main() -> Result<(), NodeError> {
    let mut arguments = std::env::args().skip(1);
    let (Some(out), Some(frames)) = (arguments.next(), arguments.next()) else {
        return Err("usage: write_recording OUT FRAMES [OBJECTS]".into());
    };
    let frames: u64 = frames.parse()?;
    let overlay = arguments.next().map(|objects| OverlayConfig { objects: objects.into(), pictures: None });
    let config = RecorderConfig { overlay, ..RecorderConfig::new(PathBuf::from(&out)) };
    let context =
        |restarts| Context { name: "recorder".into(), seed: 1, out_dir: std::env::temp_dir(), restarts, replay: true };
    let mut sink = InMemory::default();
    let mut node = RecorderNode::create(config.clone(), &context(0))?;
    for index in 0..frames / 2 {
        node.process(&frame(index), &mut sink, &context(0))?;
    }
    std::mem::forget(node);
    let mut node = RecorderNode::create(config, &context(1))?;
    // The last frame before the kill comes again, as from a player that was not told.
    for index in (frames / 2).saturating_sub(1)..frames {
        node.process(&frame(index), &mut sink, &context(1))?;
    }
    node.finish(&context(1))
}
