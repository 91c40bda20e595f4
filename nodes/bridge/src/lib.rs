//! The edge to ROS 2: poses out as DDS messages, a live camera in. Nothing else in the house sees DDS.
//!
//! [`Bridge`] owns the one [`Participant`] of a graph. Beside a player it only takes `poses` and `frame` in and is the end
//! of the line. In a live graph it is the source as well (`frame` and `initial_poses` out, `camera` in its
//! configuration), and the refined poses come back to it.
//!
//! | topic | type | QoS | content |
//! |---|---|---|---|
//! | `object_pose` out | `geometry_msgs/PoseStamped` | reliable, volatile, keep last `queue_depth` | the configured or best object whose pose stands |
//! | `object_poses` out | `vision_msgs/Detection3DArray` | the same | every object, with covariance; score 0 where refinement failed |
//! | `/tf` out | `tf2_msgs/TFMessage` | the same | optical frame -> `object_N`, poses that stand |
//! | image in | `sensor_msgs/Image` or `CompressedImage` | best effort, volatile, keep last `queue_depth` | rgb8, bgr8, rgba8, bgra8, mono8; jpeg, png |
//! | camera info in | `sensor_msgs/CameraInfo` | the same | with each image, of the same stamp |
//! | detections in | `vision_msgs/Detection3DArray` | the same | optional: initial poses for each image, of the same stamp |
//!
//! Every message out carries the image's stamp and the name of its optical frame; no clock is read. A best-effort
//! subscription also takes what a reliable publisher sends. RustDDS speaks about each datagram that it cannot
//! use, also at an orderly end: filter its log (`info,rustdds=off,ros2_client=error`).

mod camera;
mod config;
mod decode;
mod environment;
mod error;
mod node;
mod participant;
mod publish;
mod qos;
mod sync;

pub use config::{BridgeConfig, CameraConfig, Transport};
pub use environment::{DdsEnvironment, DiscoveryRange, EnvironmentError};
pub use error::BridgeError;
pub use node::Bridge;
pub use participant::Participant;
pub use publish::{PosePublisher, Published};
pub use qos::{publisher_qos, sensor_qos};
