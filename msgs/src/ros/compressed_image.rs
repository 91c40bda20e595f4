use super::Header;
use serde::{Deserialize, Serialize};

/// `sensor_msgs/CompressedImage`: the bytes of an image file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// When and where it was taken.
    pub header: Header,
    /// `jpeg`, `png`, or as image_transport writes it: `bgr8; jpeg compressed bgr8`.
    pub format: String,
    /// The file's bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

super::ros_message!(CompressedImage, "sensor_msgs", "CompressedImage");
