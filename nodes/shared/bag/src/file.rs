//! One MCAP file being written.

use super::BagError;
use super::metadata::{FileSpan, TopicCount};
use super::scan::{CUSTOM_RECORD, SchemaRecord};
use mcap::records::{Channel, MessageHeader, Metadata};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// What a topic is in every file of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TopicRecord {
    pub(super) name: String,
    pub(super) schema: SchemaRecord,
    pub(super) encoding: String,
    pub(super) metadata: BTreeMap<String, String>,
}

impl TopicRecord {
    pub(super) fn of_channel(channel: &Channel, schema: Option<&SchemaRecord>) -> Self {
        let none = || SchemaRecord { name: String::new(), encoding: String::new(), data: Vec::new() };
        Self {
            name: channel.topic.clone(),
            schema: schema.cloned().unwrap_or_else(none),
            encoding: channel.message_encoding.clone(),
            metadata: channel.metadata.clone(),
        }
    }

    pub(super) fn counted(&self, count: u64) -> TopicCount {
        let metadata = |key| self.metadata.get(key).cloned().unwrap_or_default();
        TopicCount {
            name: self.name.clone(),
            type_name: self.schema.name.clone(),
            type_hash: metadata("topic_type_hash"),
            qos_yaml: metadata("offered_qos_profiles"),
            count,
        }
    }
}

/// How files are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Packing {
    /// As it is: right for recordings whose bytes are images that are compressed already.
    #[default]
    None,
    /// Chunks compressed with zstd.
    Zstd,
}

pub(super) struct FileWriter {
    writer: mcap::Writer<BufWriter<File>>,
    path: PathBuf,
    pub(super) span: FileSpan,
    /// Bytes of messages.
    pub(super) bytes: u64,
    /// Chunks that were ended.
    pub(super) chunks: u64,
}

impl std::fmt::Debug for FileWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileWriter").field("path", &self.path).field("span", &self.span).finish_non_exhaustive()
    }
}

impl FileWriter {
    /// Creates a file that must not exist. Chunks end at [`Self::end_chunk`] or beyond 1 MiB.
    pub(super) fn create(path: &Path, packing: Packing, chunk_bytes: Option<u64>) -> Result<Self, BagError> {
        let file = pseudoflow_files::create_private(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::AlreadyExists => BagError::Exists { path: path.to_owned() },
            _ => BagError::Io { path: path.to_owned(), source },
        })?;
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            // Fixed, so that a file does not depend on the version of a dependency.
            .library("pseudoflow")
            .chunk_size(chunk_bytes)
            .disable_seeking(true) // chunks are written whole: a killed writer leaves no half-filled chunk header
            .compression_threads(0)
            .compression(match packing {
                Packing::None => None,
                Packing::Zstd => Some(mcap::Compression::Zstd),
            });
        let writer = options.create(BufWriter::with_capacity(1 << 18, file)).map_err(BagError::write(path))?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { writer, path: path.to_owned(), span: FileSpan { name, ..FileSpan::default() }, bytes: 0, chunks: 0 })
    }

    /// Keeps words of ours; before the first message, so that a cut-off file has them, too.
    pub(super) fn write_custom(&mut self, custom: &BTreeMap<String, String>) -> Result<(), BagError> {
        if custom.is_empty() {
            return Ok(());
        }
        let record = Metadata { name: CUSTOM_RECORD.into(), metadata: custom.clone() };
        self.writer.write_metadata(&record).map_err(BagError::write(&self.path))
    }

    pub(super) fn add_topic(&mut self, topic: &TopicRecord) -> Result<u16, BagError> {
        let SchemaRecord { name, encoding, data } = &topic.schema;
        let schema = match name.is_empty() {
            true => Ok(0),
            false => self.writer.add_schema(name, encoding, data),
        };
        schema
            .and_then(|id| self.writer.add_channel(id, &topic.name, &topic.encoding, &topic.metadata))
            .map_err(BagError::write(&self.path))
    }

    pub(super) fn write(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), BagError> {
        self.writer.write_to_known_channel(header, data).map_err(BagError::write(&self.path))?;
        self.span.add(header.log_time);
        self.bytes += data.len() as u64;
        Ok(())
    }

    /// Ends the chunk and hands it to the operating system: it outlives this process from here on.
    pub(super) fn end_chunk(&mut self) -> Result<(), BagError> {
        self.chunks += 1;
        self.writer.flush().map_err(BagError::write(&self.path))
    }

    /// Writes index and closing records and waits until the disk has them.
    pub(super) fn finish(mut self, information: String) -> Result<FileSpan, BagError> {
        let metadata = [("serialized_metadata".to_owned(), information), ("ROS_DISTRO".to_owned(), "jazzy".to_owned())];
        let record = Metadata { name: "rosbag2".into(), metadata: metadata.into() };
        self.writer.write_metadata(&record).map_err(BagError::write(&self.path))?;
        self.writer.finish().map_err(BagError::write(&self.path))?;
        let buffer = self.writer.into_inner();
        let file = buffer.into_inner().map_err(|error| BagError::io(&self.path)(error.into_error()))?;
        file.sync_all().map_err(BagError::io(&self.path))?;
        Ok(self.span)
    }
}
