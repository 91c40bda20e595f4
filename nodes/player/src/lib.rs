//! The player node: recordings to camera frames and initial poses; and recordings from BOP scenes ([`from_bop`]).
//!
//! Two kinds of recordings: rosbag2 mcap ([`BagSource`]) and BOP scene folders ([`BopSource`]). Both give any frame by
//! its number, as often as asked, so that a frame can be repeated after a consumer's death.
//!
//! Begin with [`open_recording`], which looks into recordings of both kinds without playing them:
//!
//! ```
//! use pseudoflow_player::{InitialPoses, PlayerConfig, open_recording};
//!
//! let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bags/tabletop_demo");
//! let initial_poses = InitialPoses { topic: Some("/initial_poses".into()), file: None };
//! let mut recording = open_recording(&PlayerConfig { initial_poses, ..PlayerConfig::new(bag.into()) })?;
//! let frame = recording.load(14)?;
//! assert_eq!((recording.count(), frame.header.width, frame.initial_poses.len()), (15, 640, 5));
//! # Ok::<(), pseudoflow_player::PlayerError>(())
//! ```

mod bag_pass;
mod bag_source;
mod bop_source;
mod concatenated;
mod config;
mod error;
mod from_bop;
mod node;
mod open;
mod poses_file;
mod sampling;
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
