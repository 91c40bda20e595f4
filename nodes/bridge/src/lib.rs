//! The edge to ROS 2: poses out as DDS messages, a live camera in. Nothing else in the house sees DDS.
//!
//! [`Bridge`] owns the one [`Participant`] of a graph. Beside a player it only takes `poses` and `frame` in and is the end
//! of the line. In a live graph it is the source as well (`frame` and `initial_poses` out, `camera` in its
//! configuration), and the refined poses come back to it.
//!
//! What goes over which topic: [`topics`], `docs/interface.md`.
//!
//! Every message out carries the image's stamp and the name of its optical frame; no clock is read. A best-effort
//! subscription also takes what a reliable publisher sends. RustDDS speaks about each datagram that it cannot
//! use, also at an orderly end: filter its log (`info,rustdds=off,ros2_client=error`).

mod camera;
mod config;
mod description;
mod detections;
mod environment;
mod error;
mod interface;
mod interfaces;
mod ledger;
mod live;
mod names;
mod node;
mod participant;
mod publish;
mod qos;
mod rosout;
mod sync;

pub use camera::{CameraConfig, InfoMode, Transport};
pub use config::{BridgeConfig, TfConfig};
pub use environment::{DdsEnvironment, DiscoveryRange, EnvironmentError};
pub use error::BridgeError;
pub use interface::{Direction, Topic, topics, topics_table};
pub use names::{DurabilityPolicy, HistoryPolicy, QosOverride, QosSettings, ReliabilityPolicy};
pub use node::Bridge;
pub use participant::Participant;
pub use qos::{latched_qos, publisher_qos, sensor_qos};
