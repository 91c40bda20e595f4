//! `metadata.yaml` of rosbag2, version 9 (qualities of service as words).

use super::BagError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The file's name in a bag's directory.
pub(super) const METADATA_FILE: &str = "metadata.yaml";
/// Version that is written, and the newest that is read.
const VERSION: u32 = 9;

/// How a topic was offered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Samples kept for slow readers.
    pub depth: u32,
    /// Whether lost samples are sent again.
    pub reliable: bool,
    /// Whether late joiners get the last samples.
    pub transient_local: bool,
}

impl Qos {
    /// Nothing lost, nothing kept for late joiners.
    pub const RELIABLE: Self = Self { depth: 10, reliable: true, transient_local: false };
    /// What cameras offer.
    pub const SENSOR_DATA: Self = Self { depth: 5, reliable: false, transient_local: false };
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct QosTime {
    sec: u64,
    nsec: u64,
}

/// What rosbag2 writes for "no limit".
const INFINITE: QosTime = QosTime { sec: 9_223_372_036, nsec: 854_775_807 };

#[derive(Debug, Clone, PartialEq, Serialize)]
struct QosProfile {
    history: &'static str,
    depth: u32,
    reliability: &'static str,
    durability: &'static str,
    deadline: QosTime,
    lifespan: QosTime,
    liveliness: &'static str,
    liveliness_lease_duration: QosTime,
    avoid_ros_namespace_conventions: bool,
}

impl From<Qos> for QosProfile {
    fn from(qos: Qos) -> Self {
        Self {
            history: "keep_last",
            depth: qos.depth,
            reliability: if qos.reliable { "reliable" } else { "best_effort" },
            durability: if qos.transient_local { "transient_local" } else { "volatile" },
            deadline: INFINITE,
            lifespan: INFINITE,
            liveliness: "automatic",
            liveliness_lease_duration: INFINITE,
            avoid_ros_namespace_conventions: false,
        }
    }
}

/// The text that a channel's `offered_qos_profiles` holds.
pub(super) fn qos_yaml(qos: Qos) -> String {
    serde_yaml::to_string(&[QosProfile::from(qos)]).unwrap_or_default()
}

/// What one topic counts for in the metadata.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TopicCount {
    pub(super) name: String,
    pub(super) type_name: String,
    pub(super) type_hash: String,
    /// As the channel holds it: YAML.
    pub(super) qos_yaml: String,
    pub(super) count: u64,
}

/// One file of a bag.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct FileSpan {
    pub(super) name: String,
    /// Earliest and latest log time, ns; `None` without messages.
    pub(super) span_ns: Option<(u64, u64)>,
    pub(super) messages: u64,
}

impl FileSpan {
    pub(super) fn add(&mut self, log_time_ns: u64) {
        self.messages += 1;
        self.span_ns = Some(match self.span_ns {
            None => (log_time_ns, log_time_ns),
            Some((first, last)) => (first.min(log_time_ns), last.max(log_time_ns)),
        });
    }
}

#[derive(Serialize)]
struct Nanoseconds {
    nanoseconds: u64,
}

#[derive(Serialize)]
struct Epoch {
    nanoseconds_since_epoch: u64,
}

#[derive(Serialize)]
struct TopicMetadata<'a> {
    name: &'a str,
    r#type: &'a str,
    serialization_format: &'static str,
    offered_qos_profiles: serde_yaml::Value,
    type_description_hash: &'a str,
}

#[derive(Serialize)]
struct TopicWithCount<'a> {
    topic_metadata: TopicMetadata<'a>,
    message_count: u64,
}

#[derive(Serialize)]
struct FileInformation<'a> {
    path: &'a str,
    starting_time: Epoch,
    duration: Nanoseconds,
    message_count: u64,
}

/// All that stands under `rosbag2_bagfile_information`.
#[derive(Serialize)]
struct Information<'a> {
    version: u32,
    storage_identifier: &'static str,
    duration: Nanoseconds,
    starting_time: Epoch,
    message_count: u64,
    topics_with_message_count: Vec<TopicWithCount<'a>>,
    compression_format: &'static str,
    compression_mode: &'static str,
    relative_file_paths: Vec<&'a str>,
    files: Vec<FileInformation<'a>>,
    custom_data: Option<&'a BTreeMap<String, String>>,
    ros_distro: &'static str,
}

fn span(span_ns: Option<(u64, u64)>) -> (Epoch, Nanoseconds) {
    // Without messages rosbag2 writes the largest time as the start.
    let (first, last) = span_ns.unwrap_or((i64::MAX as u64, i64::MAX as u64));
    (Epoch { nanoseconds_since_epoch: first }, Nanoseconds { nanoseconds: last - first })
}

/// The YAML of a bag's information (without the outer key, as an mcap file's own record holds it).
pub(super) fn information_yaml(
    files: &[FileSpan],
    topics: &[TopicCount],
    custom: &BTreeMap<String, String>,
) -> Result<String, serde_yaml::Error> {
    let first = files.iter().filter_map(|f| f.span_ns).map(|s| s.0).min();
    let last = files.iter().filter_map(|f| f.span_ns).map(|s| s.1).max();
    let (starting_time, duration) = span(first.zip(last));
    let topics = topics.iter().map(|topic| {
        Ok(TopicWithCount {
            topic_metadata: TopicMetadata {
                name: &topic.name,
                r#type: &topic.type_name,
                serialization_format: "cdr",
                offered_qos_profiles: match pseudoflow_runtime::yaml::from_str(&topic.qos_yaml)? {
                    serde_yaml::Value::Null => serde_yaml::Value::Sequence(Vec::new()),
                    profiles => profiles,
                },
                type_description_hash: &topic.type_hash,
            },
            message_count: topic.count,
        })
    });
    let file = |f: &FileSpan| {
        let (starting_time, duration) = span(f.span_ns);
        (starting_time, duration, f.messages)
    };
    serde_yaml::to_string(&Information {
        version: VERSION,
        storage_identifier: "mcap",
        duration,
        starting_time,
        message_count: files.iter().map(|f| f.messages).sum(),
        topics_with_message_count: topics.collect::<Result<_, serde_yaml::Error>>()?,
        compression_format: "",
        compression_mode: "",
        relative_file_paths: files.iter().map(|f| f.name.as_str()).collect(),
        files: files
            .iter()
            .map(|f| {
                let (starting_time, duration, message_count) = file(f);
                FileInformation { path: &f.name, starting_time, duration, message_count }
            })
            .collect(),
        custom_data: Some(custom).filter(|c| !c.is_empty()),
        ros_distro: "jazzy",
    })
}

/// Writes `metadata.yaml` beside and renames it: it is there whole or not at all.
pub(super) fn write(directory: &Path, information: &str) -> Result<(), BagError> {
    let indented: String = information.lines().map(|line| format!("  {line}\n")).collect();
    let path = directory.join(METADATA_FILE);
    let text = format!("rosbag2_bagfile_information:\n{indented}");
    pseudoflow_files::write_private(&path, text.as_bytes()).map_err(BagError::io(&path))
}

#[derive(Deserialize)]
struct ReadFile {
    rosbag2_bagfile_information: ReadInformation,
}

/// What a reader needs of `metadata.yaml`, versions 4 to 9.
#[derive(Debug, Deserialize)]
pub(super) struct ReadInformation {
    version: u32,
    storage_identifier: String,
    pub(super) relative_file_paths: Vec<String>,
    #[serde(default)]
    compression_mode: String,
    #[serde(default)]
    custom_data: Option<BTreeMap<String, String>>,
}

/// Reads and checks `metadata.yaml`.
pub(super) fn read(path: &Path) -> Result<ReadInformation, BagError> {
    let metadata = |cause: String| BagError::Metadata { path: path.to_owned(), cause };
    let text = std::fs::read_to_string(path).map_err(BagError::io(path))?;
    let read: ReadFile = pseudoflow_runtime::yaml::from_str(&text).map_err(|error| metadata(error.to_string()))?;
    let information = read.rosbag2_bagfile_information;
    if information.version > VERSION {
        let version = information.version;
        return Err(metadata(format!("field `version` is {version}; versions to {VERSION} are known")));
    }
    if information.storage_identifier != "mcap" {
        let found = &information.storage_identifier;
        return Err(metadata(format!(
            "field `storage_identifier` is `{found}`, not `mcap`: convert the bag with `ros2 bag convert`"
        )));
    }
    if !matches!(information.compression_mode.to_lowercase().as_str(), "" | "none") {
        let found = &information.compression_mode;
        return Err(metadata(format!(
            "field `compression_mode` is `{found}`: only compression inside mcap is read; convert with `ros2 bag convert`"
        )));
    }
    Ok(information)
}

/// The custom data in the record that rosbag2 keeps inside an mcap file.
pub(super) fn custom_data(serialized_metadata: &str) -> BTreeMap<String, String> {
    let read: Option<ReadInformation> = pseudoflow_runtime::yaml::from_str(serialized_metadata).ok();
    read.and_then(|information| information.custom_data).unwrap_or_default()
}
