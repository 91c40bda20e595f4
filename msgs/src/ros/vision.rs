//! What is said once about the detector and its classes (`vision_msgs`), and rectangles of other detectors.

use super::Header;
use super::detection3d_array::ObjectHypothesisWithPose;
use serde::{Deserialize, Serialize};

/// `vision_msgs/VisionInfo`: where a detector's classes come from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VisionInfo {
    /// Of the message itself.
    pub header: Header,
    /// Name of the method.
    pub method: String,
    /// Where the classes are described.
    pub database_location: String,
    /// Goes up when they change.
    pub database_version: i32,
}

super::ros_message!(VisionInfo, "vision_msgs", "VisionInfo");

/// `vision_msgs/VisionClass`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VisionClass {
    /// Number of the class.
    pub class_id: u16,
    /// Its name.
    pub class_name: String,
}

/// `vision_msgs/LabelInfo`: names of the classes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LabelInfo {
    /// Of the message itself.
    pub header: Header,
    /// All classes.
    pub class_map: Vec<VisionClass>,
    /// Least score of what is published.
    pub threshold: f32,
}

super::ros_message!(LabelInfo, "vision_msgs", "LabelInfo");

/// `std_msgs/String`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StringMessage {
    /// The text.
    pub data: String,
}

super::ros_message!(StringMessage, "std_msgs", "String");

/// `vision_msgs/Point2D`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the fields are coordinates")]
pub struct Point2D {
    pub x: f64,
    pub y: f64,
}

/// `vision_msgs/Pose2D`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2D {
    /// Pixels.
    pub position: Point2D,
    /// Radians.
    pub theta: f64,
}

/// `vision_msgs/BoundingBox2D`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct BoundingBox2D {
    /// Middle and angle.
    pub center: Pose2D,
    /// Width, pixels.
    pub size_x: f64,
    /// Height, pixels.
    pub size_y: f64,
}

/// `vision_msgs/Detection2D` (vision_msgs 4).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection2D {
    /// Of the image.
    pub header: Header,
    /// What it may be; their poses mean nothing here.
    pub results: Vec<ObjectHypothesisWithPose>,
    /// Where.
    pub bbox: BoundingBox2D,
    /// Tells detections apart.
    pub id: String,
}

/// `vision_msgs/Detection2DArray`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection2DArray {
    /// Of the image.
    pub header: Header,
    /// One for each rectangle.
    pub detections: Vec<Detection2D>,
}

super::ros_message!(Detection2DArray, "vision_msgs", "Detection2DArray");
