//! The interface to ROS 2 as a list: what is published and heard, where, of which type. `pseudoflow interface` makes the page of
//! `docs/` of it, and tests hold launch files and rviz's configuration against it.

use pseudoflow_msgs::ros::{
    CameraInfo, CompressedImage, Detection2DArray, Detection3DArray, DiagnosticArray, Image, LabelInfo, PoseStamped,
    PoseWithCovarianceStamped, RosMessage, StringMessage, TFMessage, VisionInfo,
};
use std::fmt::Write;

/// Which way messages go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Published.
    Out,
    /// Subscribed.
    In,
}

/// A topic of the bridge.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Relative names lie in the node's namespace; of what is heard, the configuration's key.
    pub name: &'static str,
    /// `package/Name`.
    pub message: String,
    /// Which way.
    pub direction: Direction,
    /// Quality of service.
    pub qos: &'static str,
    /// What it says, and when.
    pub content: &'static str,
}

const RELIABLE: &str = "reliable, volatile, keep last `queue_depth`";
const LATCHED: &str = "reliable, transient local, keep last 1";
const SENSOR: &str = "best effort, volatile, keep last `camera.queue_depth`";

fn out<M: RosMessage>(name: &'static str, qos: &'static str, content: &'static str) -> Topic {
    let message = format!("{}/{}", M::PACKAGE, M::NAME);
    Topic { name, message, direction: Direction::Out, qos, content }
}

fn heard<M: RosMessage>(name: &'static str, content: &'static str) -> Topic {
    Topic { direction: Direction::In, ..out::<M>(name, SENSOR, content) }
}

/// All topics of the bridge.
#[must_use]
pub fn topics() -> Vec<Topic> {
    vec![
        out::<PoseStamped>(
            "object_pose",
            RELIABLE,
            "one object's: `object`, or the first that was found, until it is lost for `switch_after_s`; no message while it is lost",
        ),
        out::<PoseWithCovarianceStamped>(
            "objects/NAME/pose",
            RELIABLE,
            "one instance's, in frames in which its pose stands; `NAME_1` is the second instance",
        ),
        out::<Detection3DArray>(
            "object_poses",
            RELIABLE,
            "every instance whose pose stands, once a frame: class, score, covariance, box around the mesh",
        ),
        out::<Detection3DArray>(
            "object_poses/refused",
            RELIABLE,
            "every instance whose pose does not stand, once a frame",
        ),
        out::<DiagnosticArray>(
            "object_status",
            RELIABLE,
            "what is searched for, tracked or lost, and why, once a frame",
        ),
        out::<TFMessage>(
            "/tf",
            RELIABLE,
            "optical frame to `tf.prefix` NAME of poses that stand; off with `tf.enabled: false`",
        ),
        out::<DiagnosticArray>(
            "diagnostics",
            RELIABLE,
            "what came in and was dropped, by topic and kind, and what nodes dropped, by node and input; when that changes",
        ),
        out::<VisionInfo>(
            "vision_info",
            LATCHED,
            "method, object set, and its version: it goes up with weights and objects",
        ),
        out::<LabelInfo>("label_info", LATCHED, "names of the objects by id"),
        out::<StringMessage>(
            "object_description",
            LATCHED,
            "URDF: one link a frame, the mesh as its visual; from the first frame on",
        ),
        Topic {
            name: "/rosout",
            message: "rcl_interfaces/Log".to_owned(),
            direction: Direction::Out,
            qos: "reliable, transient local, keep last 1000, lifespan 10 s",
            content: "what any node of the graph warns of; logger `NAMESPACE.NODE_NAME`, `.NODE` of the graph behind it (`left.pseudoflow.flow`)",
        },
        heard::<Image>("camera.image", "the camera's images, where they are published raw"),
        heard::<CompressedImage>("camera.image + /compressed", "else its JPEG or PNG files"),
        heard::<CameraInfo>("camera.camera_info", "its calibration; without the key, `camera_info` beside the images"),
        heard::<Detection3DArray>(
            "camera.detections",
            "a detector's poses, with the stamp of any image of the last `camera.memory_s`",
        ),
        heard::<Detection2DArray>("camera.rectangles", "a detector's rectangles, stamped in the same way"),
    ]
}

/// The list as a table of Markdown.
#[must_use]
pub fn topics_table() -> String {
    let mut text = String::from("| | topic | type | QoS | content |\n|---|---|---|---|---|\n");
    for Topic { name, message, direction, qos, content } in topics() {
        let way = if direction == Direction::Out { "out" } else { "in" };
        // Writing into a String cannot fail.
        let _ = writeln!(text, "| {way} | `{name}` | `{message}` | {qos} | {content} |");
    }
    text
}
