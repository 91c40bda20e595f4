//! The player node: recordings to camera frames and initial poses; and recordings from BOP scenes ([`from_bop`]).
//!
//! Two kinds of recordings: rosbag2 mcap ([`BagSource`]) and BOP scene folders ([`BopSource`]). Both give any frame by
//! its number, as often as asked, so that a frame can be repeated after a consumer's death.

mod bag_pass;
mod bag_source;
mod bop_source;
mod config;
mod error;
mod from_bop;
mod given;
mod node;
mod open;
mod sampling;
mod several;
mod source;
mod targets;

pub use bag_source::{BagOptions, BagSource};
pub use bop_source::BopSource;
pub use config::{InitialPoses, PlayerConfig};
pub use error::PlayerError;
pub use from_bop::{FromBop, from_bop};
pub use node::PlayerNode;
pub use open::open_recording;
pub use sampling::{Sample, Sampler, Sampling};
pub use source::{FrameFacts, FrameSource, LoadedFrame};
