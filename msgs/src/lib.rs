//! The edges of the dataflow: one file per message.
//!
//! Inside the house a message is one block of shared memory: a `#[repr(C)]` header and arrays behind it, each
//! aligned to 64 bytes, written once by its producer and read in place by its consumers ([`layout`]). Every node
//! sends exactly one message per frame and output port, also when the message is empty, so that joining inputs
//! and acknowledging frames need no more than the frame's index ([`FrameKey`]).
//!
//! | message | producer | consumers |
//! |---|---|---|
//! | [`CameraFrame`] | player, bridge | renderer, recorder, initializer |
//! | [`ObjectPoses`] | player, initializer (initial), pnp | renderer, bridge, recorder, evaluator, initializer |
//! | [`ObjectStatuses`] | initializer | bridge, recorder |
//! | [`ReferenceViews`] | renderer | flow, pnp, consistency, trainer |
//! | [`FlowFields`] | flow | pnp, consistency, trainer |
//! | [`PartnerFrames`] | player (training) | renderer |
//! | [`PseudoLabels`] | consistency | trainer |
//! | [`NetworkWeights`] | trainer | flow |
//! | [`Rectangles`] | player (a detector's) | rectangle_finder |
//! | [`DetectedFrame`] | bridge (a detector's) | rectangle_finder |
//! | [`GateDecisions`] | pnp | results |
//! | [`Pictures`] | consistency | recorder |
//!
//! At the edges ([`ros`]) the same content is ROS 2 messages: in bags and over DDS.
//!
//! Begin with [`ObjectPoses`]; the other messages are written and read alike. A node reads and sends them by its ports
//! (`pseudoflow_runtime::Port`).

pub mod layout;
pub mod ros;

mod camera_frame;
mod detected_frame;
mod flow_fields;
mod gate_decisions;
mod network_weights;
mod object_poses;
mod object_statuses;
mod partner_frames;
mod pictures;
mod pseudo_labels;
mod rectangles;
mod reference_views;
mod wanted;

pub use camera_frame::{CameraFrame, CameraFrameHeader, CameraFrameMut, FRAME_ID_BYTES};
pub use detected_frame::DetectedFrame;
pub use flow_fields::{FlowFields, FlowFieldsHeader, FlowFieldsMut};
pub use gate_decisions::{GateDecision, GateDecisions};
pub use layout::{AlignedBytes, MalformedMessage};
pub use network_weights::{NetworkWeights, NetworkWeightsHeader};
pub use object_poses::{ObjectPose, ObjectPoses, ObjectPosesHeader, PoseSource, PoseStatus};
pub use object_statuses::{ObjectStatus, ObjectStatuses, ObjectStatusesHeader, TrackPhase, TrackReason};
pub use partner_frames::{PartnerFrame, PartnerFrames, PartnerFramesHeader};
pub use pictures::Pictures;
pub use pseudo_labels::{InstanceLabels, PseudoLabels, PseudoLabelsHeader, PseudoLabelsMut};
pub use rectangles::{Rectangle, Rectangles, RectanglesHeader};
pub use reference_views::{Partner, ReferenceView, ReferenceViews, ReferenceViewsHeader, ReferenceViewsMut};
pub use wanted::{Wanted, WantedHeader};

use bytemuck::{Pod, Zeroable};

/// What names a frame from the camera to the last consumer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct FrameKey {
    /// Count of the frame in its run, from 0 without gaps in replay.
    pub index: u64,
    /// The image's stamp, nanoseconds since the epoch of its clock.
    pub stamp_ns: i64,
}

/// A message type that ports can carry.
pub trait Message: 'static {
    /// The name that graphs, `pseudoflow check` and iceoryx2 services use, with the layout's version.
    const TYPE_NAME: &'static str;
    /// The message read in place.
    type View<'a>;
    /// Reads a message in place.
    ///
    /// # Errors
    /// When the bytes are too short for what their header announces, or a field is out of range.
    fn view(bytes: &[u8]) -> Result<Self::View<'_>, MalformedMessage>;
}
