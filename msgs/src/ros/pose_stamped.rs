use super::{Header, Pose, PoseWithCovariance};
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

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovarianceStamped {
    /// Stamp of the image and name of its optical frame.
    pub header: Header,
    /// `camera_from_object`.
    pub pose: PoseWithCovariance,
}

super::ros_message!(PoseWithCovarianceStamped, "geometry_msgs", "PoseWithCovarianceStamped");
