//! One pass over an MCAP file: checks every checksum and says where each message is, holding one chunk at a time.

use super::file::TopicRecord;
use super::lengths::{self, Budget};
use super::{BagError, metadata};
use mcap::McapError;
use mcap::records::{Channel, MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Chunks and records over this size are taken for damage: it bounds what a wrong length can make us allocate.
pub(super) const MAX_RECORD_BYTES: usize = 512 << 20;

/// Length of what stands before a record's content: opcode and length.
const RECORD_HEAD: u64 = 9;

/// A schema as a file holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SchemaRecord {
    pub(super) name: String,
    pub(super) encoding: String,
    pub(super) data: Vec<u8>,
}

/// Where a message is: the record in the file and the message's count in it (0 for one outside chunks).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) record_at: u64,
    pub(super) ordinal: u32,
}

/// What a pass does about damage inside a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Damage {
    /// Ends with the error.
    Refuse,
    /// Leaves the chunk out, says so in [`FileContent::lost`] and goes on.
    LeaveOut,
}

/// A message as the pass meets it.
pub(super) struct Met<'a> {
    pub(super) channel: &'a Channel,
    pub(super) schema: Option<&'a SchemaRecord>,
    pub(super) header: MessageHeader,
    pub(super) place: Place,
    pub(super) data: &'a [u8],
}

/// What a file holds besides its messages.
#[derive(Debug, Clone, Default)]
pub(super) struct FileContent {
    pub(super) schemas: BTreeMap<u16, SchemaRecord>,
    pub(super) channels: BTreeMap<u16, Channel>,
    /// Metadata records by name.
    pub(super) metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Where the last whole record ends.
    pub(super) whole_until: u64,
    /// Whether all chunks had a checksum.
    pub(super) checksums: bool,
    /// Chunks that were left out, and why.
    pub(super) lost: Vec<String>,
}

/// The name of the metadata record that holds our custom data.
pub(super) const CUSTOM_RECORD: &str = "pseudoflow";

impl FileContent {
    /// The topics by channel.
    pub(super) fn topics(&self) -> Vec<TopicRecord> {
        self.channels.values().map(|c| TopicRecord::of_channel(c, self.schemas.get(&c.schema_id))).collect()
    }

    /// What we, or rosbag2, kept beside the messages.
    pub(super) fn custom_data(&self) -> BTreeMap<String, String> {
        let serialized = self.metadata.get("rosbag2").and_then(|record| record.get("serialized_metadata"));
        let mut custom = serialized.map(|yaml| metadata::custom_data(yaml)).unwrap_or_default();
        custom.extend(self.metadata.get(CUSTOM_RECORD).cloned().unwrap_or_default());
        custom
    }
}

/// Reads a file from start to end and shows each message to `visit`. On damage, `content` and `visit` have got what
/// stands before it: whole chunks only.
pub(super) fn scan(
    path: &Path,
    damage: Damage,
    content: &mut FileContent,
    visit: &mut dyn FnMut(Met<'_>) -> Result<(), BagError>,
) -> Result<(), BagError> {
    let file = File::open(path).map_err(BagError::io(path))?;
    let length = file.metadata().map_err(BagError::io(path))?.len();
    let mut file = BufReader::with_capacity((length as usize).clamp(1 << 12, 1 << 20), file);
    check_magic(path, &mut file, length)?;
    content.checksums = true;
    let mut pass = Pass {
        path,
        damage,
        content,
        visit,
        at: mcap::MAGIC.len() as u64,
        header: false,
        data_end: false,
        budget: Budget::of_file(length),
    };
    let limit = usize::try_from(length).unwrap_or(usize::MAX).min(MAX_RECORD_BYTES);
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_check_finishes_after_end_magic(true)
        .with_validate_data_section_crc(damage == Damage::Refuse)
        .with_validate_summary_section_crc(damage == Damage::Refuse)
        .with_record_length_limit(limit);
    let mut reader = LinearReader::new_with_options(options);
    // The reader computes the data section's checksum from the first byte on, so it is given the magic, too.
    reader.insert(mcap::MAGIC.len()).copy_from_slice(mcap::MAGIC);
    reader.notify_read(mcap::MAGIC.len());
    loop {
        match reader.next_event() {
            None => break,
            Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                let read = file.read(reader.insert(need)).map_err(BagError::io(path))?;
                reader.notify_read(read);
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => pass.record(opcode, data)?,
            Some(Err(error)) => return Err(pass.failure(&error)),
        }
    }
    match pass.header && pass.data_end {
        true => Ok(()),
        false => Err(pass.damaged("the header or the end of the data is missing".into())),
    }
}

fn check_magic(path: &Path, file: &mut impl Read, length: u64) -> Result<(), BagError> {
    let mut magic = Vec::new();
    file.by_ref().take(mcap::MAGIC.len() as u64).read_to_end(&mut magic).map_err(BagError::io(path))?;
    let path = || path.to_owned();
    if length == 0 {
        return Err(BagError::Empty { path: path() });
    }
    if magic == mcap::MAGIC {
        return Ok(());
    }
    if mcap::MAGIC.starts_with(&magic) {
        return Err(BagError::Truncated { path: path(), at: 0 });
    }
    let looks_like = match magic.as_slice() {
        b"SQLite f" => {
            "is a rosbag2 file of the sqlite3 storage: convert it with `ros2 bag convert` to storage_id mcap"
        }
        b"#ROSBAG " => "is a ROS 1 bag: convert it with `rosbags-convert` to rosbag2 with storage mcap",
        [0x28, 0xb5, 0x2f, 0xfd, ..] => "is compressed as a whole (zstd): unpack it with `zstd -d` first",
        _ => "seems to be no recording: name a rosbag2 directory or an .mcap file",
    };
    Err(BagError::Foreign { path: path(), looks_like })
}

struct Pass<'a> {
    path: &'a Path,
    damage: Damage,
    content: &'a mut FileContent,
    visit: &'a mut dyn FnMut(Met<'_>) -> Result<(), BagError>,
    at: u64,
    header: bool,
    data_end: bool,
    budget: Budget,
}

impl Pass<'_> {
    fn damaged(&self, cause: String) -> BagError {
        BagError::Damaged { path: self.path.to_owned(), at: self.at, cause }
    }

    fn failure(&self, error: &McapError) -> BagError {
        match error {
            McapError::UnexpectedEof => BagError::Truncated { path: self.path.to_owned(), at: self.at },
            // A record that would fit into a file, but not into this one.
            McapError::RecordTooLarge { len, .. } if *len <= MAX_RECORD_BYTES as u64 => {
                BagError::Truncated { path: self.path.to_owned(), at: self.at }
            }
            other => self.damaged(describe(other)),
        }
    }

    fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), BagError> {
        if !self.header && opcode != op::HEADER {
            return Err(self.damaged("the file does not begin with a header".into()));
        }
        if !self.data_end {
            self.data_record(opcode, data)?;
        }
        self.at += RECORD_HEAD + data.len() as u64;
        self.content.whole_until = self.at;
        Ok(())
    }

    fn data_record(&mut self, opcode: u8, data: &[u8]) -> Result<(), BagError> {
        if !lengths::fit(opcode, data) {
            return Err(self.damaged("a record states a length beyond its end".into()));
        }
        match opcode {
            op::CHUNK => match self.chunk_records(data) {
                Ok(records) => self.chunk(&records),
                Err(error) if self.damage == Damage::LeaveOut => {
                    self.content.lost.push(error.short());
                    Ok(())
                }
                Err(error) => Err(error),
            },
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::FOOTER | op::DATA_END => {
                let record = mcap::parse_record(opcode, data).map_err(|error| self.damaged(describe(&error)))?;
                self.parsed(record, Place { record_at: self.at, ordinal: 0 })
            }
            _ => Ok(()),
        }
    }

    /// The whole chunk is unpacked before any of it counts: recovery must not keep half a frame.
    fn chunk_records(&mut self, data: &[u8]) -> Result<ChunkRecords, BagError> {
        let Ok(Record::Chunk { header, .. }) = mcap::parse_record(op::CHUNK, data) else {
            return Err(self.damaged("a chunk's header is not valid".into()));
        };
        self.content.checksums &= header.uncompressed_crc != 0 || header.uncompressed_size == 0;
        self.budget.take(data).map_err(|cause| self.damaged(cause))?;
        decode_chunk(data).map_err(|error| self.damaged(describe(&error)))
    }

    fn chunk(&mut self, records: &ChunkRecords) -> Result<(), BagError> {
        let mut ordinal = 0;
        for (opcode, range) in &records.records {
            let body = &records.bytes[range.clone()];
            if !lengths::fit(*opcode, body) {
                return Err(self.damaged("a record in a chunk states a length beyond its end".into()));
            }
            let record = mcap::parse_record(*opcode, body).map_err(|error| self.damaged(describe(&error)))?;
            self.parsed(record, Place { record_at: self.at, ordinal })?;
            ordinal += u32::from(*opcode == op::MESSAGE);
        }
        Ok(())
    }

    fn parsed(&mut self, record: Record<'_>, place: Place) -> Result<(), BagError> {
        match record {
            Record::Header(header) => {
                self.header = true;
                if header.profile != "ros2" {
                    return Err(BagError::Profile { path: self.path.to_owned(), found: header.profile });
                }
            }
            Record::DataEnd(_) => self.data_end = true,
            Record::Footer(_) => return Err(self.damaged("the end of the data is missing".into())),
            Record::Schema { header, data } => {
                let schema = SchemaRecord { name: header.name, encoding: header.encoding, data: data.into_owned() };
                self.content.schemas.insert(header.id, schema);
            }
            Record::Channel(channel) => drop(self.content.channels.insert(channel.id, channel)),
            Record::Metadata(metadata) => drop(self.content.metadata.insert(metadata.name, metadata.metadata)),
            Record::Message { header, data } => {
                let Some(channel) = self.content.channels.get(&header.channel_id) else {
                    return Err(self.damaged(format!("a message of unknown channel {}", header.channel_id)));
                };
                let schema = self.content.schemas.get(&channel.schema_id);
                (self.visit)(Met { channel, schema, header, place, data: &data })?;
            }
            _ => {}
        }
        Ok(())
    }
}

/// What is inside a chunk: records as ranges of `bytes`.
#[derive(Debug, Default)]
pub(super) struct ChunkRecords {
    pub(super) bytes: Vec<u8>,
    pub(super) records: Vec<(u8, std::ops::Range<usize>)>,
}

/// Unpacks a chunk record's content, its checksum verified before anything is used. Its lengths must [fit](lengths::fit).
pub(super) fn decode_chunk(content: &[u8]) -> Result<ChunkRecords, McapError> {
    let unpacked = lengths::uncompressed_size(content).and_then(|bytes| usize::try_from(bytes).ok());
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        // Nothing within is longer: what claims to be reserves nothing.
        .with_record_length_limit(unpacked.unwrap_or_default().max(content.len()).min(MAX_RECORD_BYTES));
    let mut reader = LinearReader::new_with_options(options);
    let mut head = [op::CHUNK, 0, 0, 0, 0, 0, 0, 0, 0];
    head[1..].copy_from_slice(&(content.len() as u64).to_le_bytes());
    let mut rest = std::io::Read::chain(head.as_slice(), content);
    let mut chunk = ChunkRecords::default();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(need) => {
                let read = rest.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode, data } => {
                let start = chunk.bytes.len();
                chunk.bytes.extend_from_slice(data);
                chunk.records.push((opcode, start..chunk.bytes.len()));
            }
        }
    }
    Ok(chunk)
}

pub(super) fn describe(error: &McapError) -> String {
    match error {
        McapError::BadChunkCrc { saved, calculated } => {
            format!("the checksum of a chunk is {calculated:08x}, the file says {saved:08x}")
        }
        McapError::BadDataCrc { saved, calculated } => {
            format!("the checksum of the data section is {calculated:08x}, the file says {saved:08x}")
        }
        McapError::BadSummaryCrc { saved, calculated } => {
            format!("the checksum of the summary is {calculated:08x}, the file says {saved:08x}")
        }
        McapError::BadMagic => "the closing magic bytes are not MCAP's".into(),
        McapError::RecordTooLarge { len, .. } => format!("a record claims {len} bytes, more than the file has"),
        McapError::UnexpectedEof | McapError::UnexpectedEoc => "a chunk ends in the middle of a record".into(),
        other => other.to_string(),
    }
}
