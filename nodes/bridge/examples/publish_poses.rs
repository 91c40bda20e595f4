//! Runs the node `bridge` on made-up poses, for the interop tests: `publish_poses FRAMES HZ SUBSCRIBERS`.
//!
//! Waits until SUBSCRIBERS of `/object_pose` have been found, then publishes. Frame i, stamped 1700000000 s + i / 30:
//! object 5, `mustard` (ok, score 0.9) at (0.001 i, -0.002 i, 1 + 0.003 i) m, turned about z by 0.01 i rad; object 7,
//! `soup can`, the same one metre to the right with score 0.5; object 9, which has no name, rejected.

use pseudoflow_bridge::{Bridge, BridgeConfig};
use pseudoflow_msgs::{
    AlignedBytes, CameraFrame, CameraFrameHeader, FrameKey, ObjectPose, ObjectPoses, PoseSource, PoseStatus,
};
use pseudoflow_runtime::{Context, InMemory, Node, NodeError, Outputs};
use std::time::{Duration, Instant};

const FIRST_STAMP_NS: i64 = 1_700_000_000_000_000_000;
const FRAME_NS: i64 = 33_333_333;

fn main() -> Result<(), NodeError> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("info,rustdds=off,ros2_client=error"))
        .init();
    let mut arguments = std::env::args().skip(1).map(|text| text.parse::<u64>());
    let mut next = || arguments.next().ok_or("usage: publish_poses FRAMES HZ SUBSCRIBERS")?.map_err(NodeError::from);
    let (frames, hz, subscribers) = (next()?, next()?, next()?);

    let context = Context { name: "bridge".into(), seed: 0, out_dir: ".".into(), restarts: 0, replay: true };
    let object_names = [(5, "mustard".to_owned()), (7, "soup can".to_owned())].into();
    let mut bridge = Bridge::create(BridgeConfig { object_names, ..BridgeConfig::default() }, &context)?;
    wait(&bridge, subscribers as usize)?;
    for index in 0..frames {
        let stamp_ns = FIRST_STAMP_NS + index as i64 * FRAME_NS;
        let inputs = frame(FrameKey { index, stamp_ns })?;
        bridge.process(&inputs, &mut InMemory::default(), &context)?;
        std::thread::sleep(Duration::from_micros(1_000_000 / hz.max(1)));
    }
    bridge.finish(&context)
}

fn wait(bridge: &Bridge, subscribers: usize) -> Result<(), NodeError> {
    let start = Instant::now();
    while bridge.participant().subscribers("/object_pose") < subscribers {
        if start.elapsed() > Duration::from_secs(60) {
            return Err(format!("no {subscribers} subscribers of /object_pose within 60 s").into());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    log::info!("{subscribers} subscribers found after {:?}", start.elapsed());
    // The peer learns of us no later than we of it, but its reader may still be at work on the match.
    std::thread::sleep(Duration::from_millis(500));
    Ok(())
}

fn frame(key: FrameKey) -> Result<InMemory, NodeError> {
    let mut inputs = InMemory::new(key);
    let header = CameraFrameHeader {
        width: 2,
        height: 1,
        scene_id: 1,
        image_id: key.index as u32,
        intrinsics: [1.0, 1.0, 0.0, 0.0],
        frame_id: CameraFrameHeader::frame_id_bytes("camera_optical").ok_or("frame name too long")?,
    };
    let mut image = AlignedBytes::zeroed(CameraFrame::byte_len(2, 1));
    CameraFrame::write(&mut image, header);
    let poses = [pose(key.index, 5, 0.9, PoseStatus::Ok), pose(key.index, 7, 0.5, PoseStatus::Ok), {
        pose(key.index, 9, 0.95, PoseStatus::Rejected)
    }];
    inputs.send("poses", key, ObjectPoses::byte_len(3), &mut |bytes| ObjectPoses::write(bytes, 1, 0, &poses))?;
    inputs.messages.push(("frame".into(), image));
    Ok(inputs)
}

fn pose(index: u64, object_id: u32, score: f64, status: PoseStatus) -> ObjectPose {
    let i = index as f64;
    let half_angle = 0.005 * i;
    let to_the_right = if object_id == 5 { 0.0 } else { 1.0 };
    ObjectPose {
        object_id,
        instance: 0,
        status: status as u32,
        source: PoseSource::Refined as u32,
        score,
        rotation_xyzw: [0.0, 0.0, half_angle.sin(), half_angle.cos()],
        translation_m: [0.001 * i + to_the_right, -0.002 * i, 1.0 + 0.003 * i],
        covariance: std::array::from_fn(|entry| entry as f64 + i),
    }
}
