//! What a bag says of itself.

use std::collections::BTreeMap;
use std::path::PathBuf;

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicInfo {
    /// Its name.
    pub name: String,
    /// Its message type, as in `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// How its messages are encoded.
    pub encoding: String,
    /// How many messages it has.
    pub count: usize,
}

/// A bag in numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagInfo {
    /// The bag.
    pub path: PathBuf,
    /// Its files and their bytes.
    pub files: Vec<(PathBuf, u64)>,
    /// Its topics.
    pub topics: Vec<TopicInfo>,
    /// Earliest and latest log time, ns; `None` without messages.
    pub span_ns: Option<(u64, u64)>,
    /// Whether every chunk has a checksum (all of them hold: the bag was opened).
    pub checksums: bool,
    /// What we, or rosbag2, kept beside the messages.
    pub custom: BTreeMap<String, String>,
}

impl std::fmt::Display for BagInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let messages: usize = self.topics.iter().map(|topic| topic.count).sum();
        let seconds = self.span_ns.map_or(0.0, |(first, last)| (last - first) as f64 * 1e-9);
        writeln!(f, "{}: {messages} messages in {seconds:.3} s", self.path.display())?;
        for (path, bytes) in &self.files {
            writeln!(f, "  {}  {bytes} bytes", path.display())?;
        }
        let checksums = if self.checksums { "all hold" } else { "some chunks have none: damage there stays unseen" };
        writeln!(f, "  checksums: {checksums}")?;
        for topic in &self.topics {
            writeln!(f, "  {:6}  {}  {}", topic.count, topic.name, topic.type_name)?;
        }
        self.custom.iter().try_for_each(|(key, value)| writeln!(f, "  {key}: {value}"))
    }
}
