//! The recorder node: what went in and what came out, as a rosbag2 recording (mcap) that Foxglove, rerun, rviz and
//! `rosbags` open, and as pictures.
//!
//! | topic | type | content |
//! |---|---|---|
//! | `/camera/image/compressed` | `sensor_msgs/CompressedImage` | the frame, JPEG |
//! | `/camera/camera_info` | `sensor_msgs/CameraInfo` | its camera |
//! | `/initial_poses` | `vision_msgs/Detection3DArray` | poses before refinement; further hypotheses are further results |
//! | `/object_poses`, `/object_poses/refused` | `vision_msgs/Detection3DArray` | poses that stand after it, and those that do not |
//! | `/objects/NAME/pose` | `geometry_msgs/PoseWithCovarianceStamped` | one instance's; `NAME_1` is the second |
//! | `/object_pose` | `geometry_msgs/PoseStamped` | one object's: `object`, or the first that was found, until it is lost |
//! | `/tf` | `tf2_msgs/TFMessage` | optical frame to `NAME` |
//! | `/overlay/compressed` | `sensor_msgs/CompressedImage` | contours: red initial, green refined |

mod following;
mod node;
mod overlay;
mod topics;

pub use node::{RecorderConfig, RecorderNode};
pub use overlay::{OverlayConfig, Painter};
