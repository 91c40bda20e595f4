//! Recordings: rosbag2 directories with the mcap storage, as `ros2 bag`, `rosbags`, Foxglove and rerun read them.
//!
//! Begin with [`BagWriter`] or [`BagReader`].
//!
//! - [`BagWriter`] writes one chunk for each frame, so that a frame is in the file whole or not at all, and takes up
//!   a bag whose writer died.
//! - [`BagReader`] checks the whole bag when it is opened (every checksum, holding one chunk at a time) and then
//!   gives any message of any topic.
//! - [`recover`] keeps what is whole of a cut-off or damaged bag.
//!
//! ```
//! use pseudoflow_msgs::ros::{PoseStamped, RosMessage};
//! use pseudoflow_bag::{BagReader, BagWriter, Packing, Qos};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("my_bag");
//! let mut writer = BagWriter::create(&path, Packing::default())?;
//! let topic = writer.add_topic::<PoseStamped>("/object_pose", Qos::RELIABLE)?;
//! let (stamp_ns, sequence) = (1_000_000_000, 0);
//! writer.write(topic, stamp_ns, sequence, &PoseStamped::default())?;
//! writer.end_frame()?; // now it is safe, whatever happens to this process
//! writer.finish()?;
//!
//! let mut reader = BagReader::open(&path)?;
//! let topic = reader.topic("/object_pose", &[PoseStamped::type_name()])?;
//! assert_eq!(reader.read::<PoseStamped>(topic, 0)?, PoseStamped::default());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod file;
mod info;
mod lengths;
mod listing;
mod metadata;
mod partial;
mod reader;
mod recover;
mod scan;
mod writer;

#[cfg(test)]
mod tests;

pub use error::BagError;
pub use file::Packing;
pub use info::{BagInfo, TopicInfo};
pub use metadata::Qos;
pub use partial::Partial;
pub use reader::{BagReader, RawMessage, TopicNumber, Visited};
pub use recover::{RecoverOptions, Recovered, recover};
pub use writer::{BagWriter, Resumed, TopicId};

use std::path::Path;

/// The name that a bag's directory gives its files.
fn bag_name(directory: &Path) -> Result<String, BagError> {
    let name = directory.file_name().and_then(|name| name.to_str());
    name.map(str::to_owned).ok_or_else(|| BagError::Name { path: directory.to_owned() })
}
