use super::{Header, Pose, PoseWithCovariance, Vector3};
use serde::{Deserialize, Serialize};

/// `vision_msgs/ObjectHypothesis`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesis {
    /// Which object.
    pub class_id: String,
    /// How sure, 0..1.
    pub score: f64,
}

/// `vision_msgs/ObjectHypothesisWithPose`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesisWithPose {
    /// Which object.
    pub hypothesis: ObjectHypothesis,
    /// Where.
    pub pose: PoseWithCovariance,
}

/// `vision_msgs/BoundingBox3D`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct BoundingBox3D {
    /// Centre and axes.
    pub center: Pose,
    /// Metres; zero where unknown.
    pub size: Vector3,
}

/// `vision_msgs/Detection3D` (vision_msgs 4, ROS 2 Humble and later).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection3D {
    /// Of the image.
    pub header: Header,
    /// What it may be, the likeliest first.
    pub results: Vec<ObjectHypothesisWithPose>,
    /// Its box.
    pub bbox: BoundingBox3D,
    /// Tells detections apart.
    pub id: String,
}

/// `vision_msgs/Detection3DArray`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection3DArray {
    /// Of the image.
    pub header: Header,
    /// One for each object.
    pub detections: Vec<Detection3D>,
}

super::ros_message!(Detection3DArray, "vision_msgs", "Detection3DArray");
