//! The edge to ROS 2: poses out as DDS messages, a live camera in. Nothing else in the house sees DDS.
//!
//! [`Bridge`] owns the one [`Participant`] of a graph. Beside a player it only takes `poses` and `frame` in and is the end
//! of the line. In a live graph it is the source as well (`frame` and `initial_poses` out, `camera` in its
//! configuration), and the refined poses come back to it.
//!
//! | topic | type | QoS | content |
//! |---|---|---|---|
//! | `object_pose` out | `geometry_msgs/PoseStamped` | reliable, volatile, keep last `queue_depth` | one object: `object`, or the first that was found, until it is lost for `switch_after_s` |
//! | `objects/NAME/pose` out | `geometry_msgs/PoseWithCovarianceStamped` | the same | one instance where its pose stands; `NAME_1` is the second |
//! | `object_poses` out | `vision_msgs/Detection3DArray` | the same | every instance whose pose stands, with covariance and the box around its mesh |
//! | `object_poses/refused` out | `vision_msgs/Detection3DArray` | the same | those whose pose does not stand |
//! | `object_status` out | `diagnostic_msgs/DiagnosticArray` | the same | what is searched, tracked or lost, and why |
//! | `/tf` out | `tf2_msgs/TFMessage` | the same | optical frame -> `tf.prefix` NAME, poses that stand; `tf.enabled` |
//! | `vision_info`, `label_info` out | `vision_msgs/VisionInfo`, `LabelInfo` | reliable, transient local | method, object set and its version; names by id |
//! | `object_description` out | `std_msgs/String` | the same | URDF: one link a frame, the mesh as its visual |
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
mod description;
mod environment;
mod error;
mod node;
mod participant;
mod publish;
mod qos;
mod sync;

pub use config::{BridgeConfig, CameraConfig, TfConfig, Transport};
pub use environment::{DdsEnvironment, DiscoveryRange, EnvironmentError};
pub use error::BridgeError;
pub use node::Bridge;
pub use participant::Participant;
pub use publish::{PosePublisher, Published};
pub use qos::{latched_qos, publisher_qos, sensor_qos};
