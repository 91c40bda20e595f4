use super::{Arrival, ArrivedPose};
use pseudoflow_msgs::{CameraFrame, ObjectPose, ObjectPoses, ObjectStatuses, TrackPhase, TrackReason};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, Port, PortSpec, Role};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;

const FRAME: Port<CameraFrame<'static>> = Port::required("frame");
const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
const STATUS: Port<ObjectStatuses<'static>> = Port::optional("status");

/// Settings of the stopwatch node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StopwatchConfig {
    /// File that gets a line of JSON for each frame whose poses have come; its folder is made.
    pub out: PathBuf,
}

/// Writes down when each frame's poses came, counted from when the frame was due, and what they were.
pub struct StopwatchNode {
    log: File,
}

impl Node for StopwatchNode {
    const KIND: &'static str = "stopwatch";
    const ROLE: Role = Role::Sink;
    type Config = StopwatchConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), POSES.spec(), STATUS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &StopwatchConfig) -> Result<(), NodeError> {
        match config.out.file_name() {
            Some(_) => Ok(()),
            None => Err("`out`: give the name of a file, such as `out/arrivals.jsonl`".into()),
        }
    }

    fn create(config: StopwatchConfig, context: &Context) -> Result<Self, NodeError> {
        if let Some(folder) = config.out.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut options = OpenOptions::new();
        options.create(true);
        let log = match context.restarts {
            0 => options.write(true).truncate(true).open(&config.out),
            _ => options.append(true).open(&config.out),
        };
        Ok(Self { log: log.map_err(|error| format!("{}: {error}", config.out.display()))? })
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let age_ms = inputs.age_ns() as f64 * 1e-6;
        let key = inputs.key();
        let header = FRAME.read(inputs)?.header;
        let poses = POSES.read(inputs)?.poses;
        let tracks = STATUS.given(inputs)?.map_or_else(BTreeMap::new, |message| tracks(&message));
        let arrival = Arrival {
            index: key.index,
            stamp_ns: key.stamp_ns,
            age_ms,
            scene_id: header.scene_id,
            image_id: header.image_id,
            poses: ObjectPose::likeliest(poses).map(ArrivedPose::from).collect(),
            tracks,
        };
        Ok(self.log.write_all(format!("{}\n", serde_json::to_string(&arrival)?).as_bytes())?)
    }
}

/// Phase and reason of each object, in words.
fn tracks(statuses: &ObjectStatuses<'_>) -> BTreeMap<u32, String> {
    let words = |phase, reason| {
        let phase = TrackPhase::from_u32(phase).map_or("?", TrackPhase::name);
        format!("{phase}: {}", TrackReason::from_u32(reason).map_or("?", TrackReason::text))
    };
    statuses.statuses.iter().map(|s| (s.object_id, words(s.phase, s.reason))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::read_arrivals;
    use pseudoflow_msgs::{AlignedBytes, CameraFrameHeader, FrameKey, PoseStatus};
    use pseudoflow_runtime::InMemory;

    #[test]
    fn every_frame_becomes_a_line_with_its_likeliest_poses() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("new/arrivals.jsonl");
        let context = Context { name: "w".into(), seed: 0, out_dir: "/".into(), restarts: 0, replay: false };
        let mut node = StopwatchNode::create(StopwatchConfig { out: out.clone() }, &context).unwrap();
        let zeroed: ObjectPose = bytemuck::Zeroable::zeroed();
        let refused = ObjectPose { object_id: 3, status: PoseStatus::Rejected as u32, ..zeroed };
        let poses = [ObjectPose { object_id: 2, score: 0.9, ..zeroed }, ObjectPose { object_id: 2, ..zeroed }, refused];
        let mut inputs = InMemory::new(FrameKey { index: 7, stamp_ns: 70 });
        let header: CameraFrameHeader =
            CameraFrameHeader { width: 2, height: 1, scene_id: 4, image_id: 5, ..bytemuck::Zeroable::zeroed() };
        let mut frame = AlignedBytes::zeroed(CameraFrame::byte_len(2, 1));
        CameraFrame::write(&mut frame, header);
        let mut bytes = AlignedBytes::zeroed(ObjectPoses::byte_len(3));
        ObjectPoses::write(&mut bytes, 4, 5, &poses);
        inputs.messages = vec![("frame".into(), frame), ("poses".into(), bytes)];
        node.process(&inputs, &mut InMemory::default(), &context).unwrap();
        let arrival = &read_arrivals(&out).unwrap()[0];
        assert_eq!((arrival.index, arrival.scene_id, arrival.image_id, arrival.poses.len()), (7, 4, 5, 2));
        assert!(arrival.poses[0].published && !arrival.poses[1].published && arrival.poses[0].score > 0.8);
    }
}
