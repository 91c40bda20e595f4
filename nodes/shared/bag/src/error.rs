use std::path::{Path, PathBuf};

/// Why a bag cannot be read or written. Each message names the file, what is wrong there and what to do.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The file system refused.
    #[error("{path}: {source}: check that the path exists and may be read or written")]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A file without content.
    #[error("{path}: the file is empty (0 bytes): was the recording killed before its first frame? record it again")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A folder without recordings.
    #[error("{path}: there is no .mcap file: name a rosbag2 directory or an .mcap file")]
    NoFiles {
        /// The folder.
        path: PathBuf,
    },
    /// Not MCAP at all.
    #[error("{path}: the first bytes are not MCAP's; this {looks_like}")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it seems to be, and what to do.
        looks_like: &'static str,
    },
    /// MCAP of another world than ROS 2.
    #[error("{path}: field `profile` is `{found}`, not `ros2`: only recordings of ROS 2 can be read")]
    Profile {
        /// The file.
        path: PathBuf,
        /// The profile.
        found: String,
    },
    /// The file ends too early.
    #[error(
        "{path}: the file ends at byte {at} in the middle of a record: it is cut off; keep what is whole with `pseudoflow bag recover {path}`"
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Where the last whole record ends.
        at: u64,
    },
    /// Bytes changed since they were written.
    #[error(
        "{path}: damaged near byte {at}: {cause}; copy the file again, or keep what is whole with `pseudoflow bag recover {path}`"
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        at: u64,
        /// What does not fit.
        cause: String,
    },
    /// `metadata.yaml` cannot be understood.
    #[error(
        "{path}: {cause}; rebuild it with `ros2 bag reindex`, or remove it: the .mcap files are read without it, too"
    )]
    Metadata {
        /// `metadata.yaml`.
        path: PathBuf,
        /// What does not fit.
        cause: String,
    },
    /// A topic that the bag lacks.
    #[error("{path}: there is no topic `{topic}`; the bag holds {known}")]
    UnknownTopic {
        /// The bag.
        path: PathBuf,
        /// The topic asked for.
        topic: String,
        /// Topics and their types.
        known: String,
    },
    /// A topic of another type than asked for.
    #[error("{path}: topic `{topic}` carries {found}, not {expected}: name another topic")]
    TopicType {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its type.
        found: String,
        /// The types that would do.
        expected: String,
    },
    /// A topic that is not serialised as CDR.
    #[error("{path}: topic `{topic}` is encoded as `{found}`, not `cdr`: convert the bag with `ros2 bag convert`")]
    Encoding {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The encoding.
        found: String,
    },
    /// The message does not exist.
    #[error("{path}: topic `{topic}` has {count} messages: there is no message {number}")]
    NoMessage {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The message asked for.
        number: usize,
        /// How many there are.
        count: usize,
    },
    /// What would be written exists.
    #[error("{path} exists already: choose another path or remove it first; nothing was overwritten")]
    Exists {
        /// The path.
        path: PathBuf,
    },
    /// A path that can name no bag.
    #[error("{path}: a bag's path must end in a name: give a folder such as out/my_bag")]
    Name {
        /// The path.
        path: PathBuf,
    },
    /// A stamp that bags cannot hold.
    #[error("{path}: topic `{topic}`: stamp {stamp_ns} ns is before the epoch, which bags cannot hold: set the clock")]
    Stamp {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The stamp.
        stamp_ns: i64,
    },
    /// The encoder refused.
    #[error("{path}: {cause}: no further message can be written")]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: String,
    },
    /// A reader of the messages refused one.
    #[error("{path}: topic `{topic}`, message {number}: {cause}")]
    Message {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its count in the topic, from 0.
        number: usize,
        /// What is wrong with it, and what to do.
        cause: pseudoflow_runtime::NodeError,
    },
}

impl BagError {
    /// What is wrong, without the advice to recover.
    pub(crate) fn short(&self) -> String {
        match self {
            Self::Truncated { path, at } => format!("{}: cut off at byte {at}", path.display()),
            Self::Damaged { path, at, cause } => format!("{}: damaged near byte {at}: {cause}", path.display()),
            other => other.to_string(),
        }
    }

    /// Whether the file is MCAP, but not whole.
    pub(crate) fn is_damage(&self) -> bool {
        matches!(self, Self::Truncated { .. } | Self::Damaged { .. } | Self::Empty { .. })
    }

    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    pub(crate) fn write(path: &Path) -> impl FnOnce(mcap::McapError) -> Self + '_ {
        move |error| match error {
            mcap::McapError::Io(source) => Self::Io { path: path.to_owned(), source },
            other => Self::Write { path: path.to_owned(), cause: other.to_string() },
        }
    }
}
