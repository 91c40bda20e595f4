use super::{Header, Pose};
use serde::{Deserialize, Serialize};

/// `geometry_msgs/PoseStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Stamp of the image and name of its optical frame.
    pub header: Header,
    /// `camera_from_object`.
    pub pose: Pose,
}

super::ros_message!(PoseStamped, "geometry_msgs", "PoseStamped");
