//! The edge to ROS 2: poses out as DDS messages, a live camera in. Nothing else in the house sees DDS.
//!
//! Each of the two nodes owns the one [`Participant`] of its process:
//! [`BridgeSink`] (`bridge`) publishes the poses of a replay or of a live run; [`CameraSource`] (`camera`) is the source of a
//! live graph, and also publishes when the graph feeds the refined poses back to it, so that a live run too has
//! one participant.
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
//! use: filter its log (`warn,rustdds=error`).

mod camera;
mod decode;
mod environment;
mod error;
mod participant;
mod publish;
mod qos;
mod sink;
mod source;
mod sync;

pub use environment::{DdsEnvironment, DiscoveryRange, EnvironmentError};
pub use error::BridgeError;
pub use participant::Participant;
pub use publish::{PosePublisher, PublishConfig, Published};
pub use qos::{publisher_qos, sensor_qos};
pub use sink::BridgeSink;
pub use source::{CameraConfig, CameraSource, Transport};
