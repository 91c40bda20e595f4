use super::{Header, Quaternion, Vector3};
use serde::{Deserialize, Serialize};

/// `geometry_msgs/Transform`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Metres.
    pub translation: Vector3,
    /// Unit quaternion.
    pub rotation: Quaternion,
}

/// `geometry_msgs/TransformStamped`: `frame_from_child`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Stamp and parent frame.
    pub header: Header,
    /// The frame that is placed.
    pub child_frame_id: String,
    /// Maps points of the child into the parent.
    pub transform: Transform,
}

/// `tf2_msgs/TFMessage`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// The transforms.
    pub transforms: Vec<TransformStamped>,
}

super::ros_message!(TFMessage, "tf2_msgs", "TFMessage");
