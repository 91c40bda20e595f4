//! The poses of a recording: any rosbag2 folder or .mcap file with a topic of `vision_msgs/Detection3DArray`.
//!
//!     cargo run --release --example read_poses -- bags/tabletop_demo /initial_poses
//!
//! What a graph's recorder wrote has them as `/object_poses`; `pseudoflow bag info BAG` lists the topics.

#![allow(clippy::print_stdout, reason = "an example talks to people")]

use pseudoflow_bag::{BagError, BagReader};
use pseudoflow_msgs::ros::{Detection3DArray, RosMessage};
use std::path::Path;

/// An object in a frame.
#[derive(Debug, PartialEq)]
pub(crate) struct Seen {
    /// The image's stamp, nanoseconds since the epoch.
    pub(crate) stamp_ns: i64,
    /// Its name, or its id where the recording has no names.
    pub(crate) object: String,
    /// How sure the source was, 0..1.
    pub(crate) score: f64,
    /// In the camera's optical frame: x right, y down, z forward; metres.
    pub(crate) position_m: [f64; 3],
}

/// All poses on a topic. Opening a bag checks all of it: a damaged one is an error here, not in the middle of the work.
pub(crate) fn poses(bag: &Path, topic: &str) -> Result<Vec<Seen>, BagError> {
    let mut reader = BagReader::open(bag)?;
    let topic = reader.topic(topic, &[Detection3DArray::type_name()])?;
    let mut seen = Vec::new();
    for number in 0..reader.topics()[topic].count {
        let array: Detection3DArray = reader.read(topic, number)?;
        for detection in &array.detections {
            // Further results are further hypotheses of the same object.
            let Some(best) = detection.results.first() else { continue };
            let position = best.pose.pose.position;
            seen.push(Seen {
                stamp_ns: array.header.stamp.as_ns(),
                object: best.hypothesis.class_id.clone(),
                score: best.hypothesis.score,
                position_m: [position.x, position.y, position.z],
            });
        }
    }
    Ok(seen)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bag, topic] = arguments.as_slice() else { return Err("usage: read_poses BAG TOPIC".into()) };
    for Seen { stamp_ns, object, score, position_m: [x, y, z] } in poses(Path::new(bag), topic)? {
        println!("{stamp_ns} {object:20} score {score:.2}  x {x:+.3} y {y:+.3} z {z:.3} m");
    }
    Ok(())
}
