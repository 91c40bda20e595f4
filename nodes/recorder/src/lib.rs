//! The recorder node: what went in and what came out, as a rosbag2 recording (mcap) that Foxglove, rerun, rviz and
//! `rosbags` open, and as pictures.
//!
//! | topic | type | content |
//! |---|---|---|
//! | `/camera/image/compressed` | `sensor_msgs/CompressedImage` | the frame, JPEG |
//! | `/camera/camera_info` | `sensor_msgs/CameraInfo` | its camera |
//! | `/initial_poses`, `/object_poses` | `vision_msgs/Detection3DArray` | poses before and after refinement |
//! | `/object_pose` | `geometry_msgs/PoseStamped` | the best pose that stands |
//! | `/tf` | `tf2_msgs/TFMessage` | optical frame to `object_N` |
//! | `/overlay/compressed` | `sensor_msgs/CompressedImage` | contours: red initial, green refined |

mod node;
mod overlay;
mod topics;

pub use node::{RecorderConfig, RecorderNode};
pub use overlay::{OverlayConfig, Painter};
