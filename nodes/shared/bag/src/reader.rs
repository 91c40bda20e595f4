use super::info::{BagInfo, TopicInfo};
use super::lengths;
use super::listing::files_of;
use super::scan::{ChunkRecords, Damage, FileContent, MAX_RECORD_BYTES, Met, Place, decode_chunk, describe, scan};
use super::{BagError, scan::SchemaRecord};
use mcap::records::{MessageHeader, Record, op};
use pseudoflow_msgs::ros::{RosMessage, from_cdr};
use pseudoflow_runtime::NodeError;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Unpacked chunks that are kept: an image and its camera info may lie in different ones.
const CACHED_CHUNKS: usize = 4;

/// A topic's place in [`BagReader::topics`].
pub type TopicNumber = usize;

/// A message as it stands in the bag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawMessage<'a> {
    /// When it was recorded, ns since the epoch.
    pub log_time_ns: u64,
    /// The recorder's count.
    pub sequence: u32,
    /// CDR with its encapsulation header.
    pub data: &'a [u8],
}

/// A message on the pass that opens the bag.
#[derive(Debug, Clone, Copy)]
pub struct Visited<'a> {
    /// Its topic.
    pub topic: &'a TopicInfo,
    /// Its count in the topic, in the order of the files.
    pub number: usize,
    /// The message.
    pub message: RawMessage<'a>,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    log_time_ns: u64,
    file: u32,
    place: Place,
}

#[derive(Debug)]
struct Cached {
    file: u32,
    record_at: u64,
    messages: Vec<(MessageHeader, std::ops::Range<usize>)>,
    bytes: Vec<u8>,
}

/// Reads a rosbag2 directory or a bare .mcap file.
///
/// Messages of a topic are numbered in the order of the files. Besides an index (40 bytes for each message), a few
/// unpacked chunks are all that is held, whatever the bag's size.
#[derive(Debug)]
pub struct BagReader {
    path: PathBuf,
    files: Vec<(PathBuf, File)>,
    topics: Vec<TopicInfo>,
    numbers: HashMap<String, TopicNumber>,
    entries: Vec<Vec<Entry>>,
    cache: VecDeque<Cached>,
    checksums: bool,
    custom: BTreeMap<String, String>,
}

impl BagReader {
    /// Opens a bag and checks all of it.
    ///
    /// # Errors
    /// When it is no bag of ROS 2, or not whole.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        Self::open_visiting(path, &mut |_| Ok(()))
    }

    /// Opens a bag and shows each message to `visit` on the pass that checks it.
    ///
    /// # Errors
    /// When it is no bag of ROS 2, or not whole, or `visit` refuses a message.
    pub fn open_visiting(
        path: &Path,
        visit: &mut dyn FnMut(Visited<'_>) -> Result<(), NodeError>,
    ) -> Result<Self, BagError> {
        let mut reader = Self {
            path: path.to_owned(),
            files: Vec::new(),
            topics: Vec::new(),
            numbers: HashMap::new(),
            entries: Vec::new(),
            cache: VecDeque::new(),
            checksums: true,
            custom: BTreeMap::new(),
        };
        for file in files_of(path)? {
            reader.add_file(file, visit)?;
        }
        Ok(reader)
    }

    fn add_file(
        &mut self,
        path: PathBuf,
        visit: &mut dyn FnMut(Visited<'_>) -> Result<(), NodeError>,
    ) -> Result<(), BagError> {
        let mut content = FileContent::default();
        let number = self.files.len() as u32;
        scan(&path, Damage::Refuse, &mut content, &mut |met| self.index(&path, number, &met, visit))?;
        for topic in content.topics() {
            self.topic_number(&topic.name, &topic.schema, &topic.encoding)?;
        }
        self.checksums &= content.checksums;
        self.custom.extend(content.custom_data());
        let file = File::open(&path).map_err(BagError::io(&path))?;
        self.files.push((path, file));
        Ok(())
    }

    fn index(
        &mut self,
        path: &Path,
        file: u32,
        met: &Met<'_>,
        visit: &mut dyn FnMut(Visited<'_>) -> Result<(), NodeError>,
    ) -> Result<(), BagError> {
        let none = SchemaRecord { name: String::new(), encoding: String::new(), data: Vec::new() };
        let schema = met.schema.unwrap_or(&none);
        let topic = self.topic_number(&met.channel.topic, schema, &met.channel.message_encoding)?;
        let log_time_ns = met.header.log_time;
        self.entries[topic].push(Entry { log_time_ns, file, place: met.place });
        let number = self.topics[topic].count;
        self.topics[topic].count += 1;
        let message = RawMessage { log_time_ns, sequence: met.header.sequence, data: met.data };
        visit(Visited { topic: &self.topics[topic], number, message }).map_err(|cause| BagError::Message {
            path: path.to_owned(),
            topic: met.channel.topic.clone(),
            number,
            cause,
        })
    }

    fn topic_number(&mut self, name: &str, schema: &SchemaRecord, encoding: &str) -> Result<TopicNumber, BagError> {
        if let Some(number) = self.numbers.get(name).copied() {
            let known = &self.topics[number].type_name;
            return match *known == schema.name {
                true => Ok(number),
                false => Err(BagError::TopicType {
                    path: self.path.clone(),
                    topic: name.to_owned(),
                    found: format!("{known} and {}", schema.name),
                    expected: "one type".into(),
                }),
            };
        }
        let (name, type_name, encoding) = (name.to_owned(), schema.name.clone(), encoding.to_owned());
        self.numbers.insert(name.clone(), self.topics.len());
        self.topics.push(TopicInfo { name, type_name, encoding, count: 0 });
        self.entries.push(Vec::new());
        Ok(self.topics.len() - 1)
    }

    /// The path that was opened.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All topics.
    #[must_use]
    pub fn topics(&self) -> &[TopicInfo] {
        &self.topics
    }

    /// What we, or rosbag2, kept beside the messages.
    #[must_use]
    pub fn custom_data(&self) -> &BTreeMap<String, String> {
        &self.custom
    }

    /// The bag in numbers.
    ///
    /// # Errors
    /// When a file's size cannot be read.
    pub fn info(&self) -> Result<BagInfo, BagError> {
        let size = |(path, file): &(PathBuf, File)| match file.metadata() {
            Ok(metadata) => Ok((path.clone(), metadata.len())),
            Err(source) => Err(BagError::Io { path: path.clone(), source }),
        };
        let times = || self.entries.iter().flatten().map(|entry| entry.log_time_ns);
        Ok(BagInfo {
            path: self.path.clone(),
            files: self.files.iter().map(size).collect::<Result<_, _>>()?,
            topics: self.topics.clone(),
            span_ns: times().min().zip(times().max()),
            checksums: self.checksums,
            custom: self.custom.clone(),
        })
    }

    /// The number of a topic.
    ///
    /// # Errors
    /// When the bag lacks it, or it carries none of `types`, or is not CDR.
    pub fn topic(&self, name: &str, types: &[String]) -> Result<TopicNumber, BagError> {
        let number = self.topics.iter().position(|topic| topic.name == name).ok_or_else(|| BagError::UnknownTopic {
            path: self.path.clone(),
            topic: name.to_owned(),
            known: self.described(),
        })?;
        let topic = &self.topics[number];
        if !types.contains(&topic.type_name) {
            return Err(BagError::TopicType {
                path: self.path.clone(),
                topic: name.to_owned(),
                found: topic.type_name.clone(),
                expected: types.join(" or "),
            });
        }
        if topic.encoding != "cdr" {
            let (path, found) = (self.path.clone(), topic.encoding.clone());
            return Err(BagError::Encoding { path, topic: name.to_owned(), found });
        }
        Ok(number)
    }

    /// The topics and their types, to name them in an error.
    #[must_use]
    pub fn described(&self) -> String {
        const TOLD: usize = 100;
        let told = self.topics.iter().take(TOLD).map(|topic| format!("{} ({})", topic.name, topic.type_name));
        let more = self.topics.len().saturating_sub(TOLD);
        let more = (more > 0).then(|| format!("{more} more"));
        let topics: Vec<String> = told.chain(more).collect();
        if topics.is_empty() { "no topics".into() } else { topics.join(", ") }
    }

    /// A message of a topic, numbered from 0 in the order of the files.
    ///
    /// # Errors
    /// When there is none, or the file has changed since the bag was opened.
    pub fn message(&mut self, topic: TopicNumber, number: usize) -> Result<RawMessage<'_>, BagError> {
        let entry = self.entries.get(topic).and_then(|entries| entries.get(number)).copied();
        let Some(entry) = entry else {
            return Err(BagError::NoMessage {
                path: self.path.clone(),
                topic: self.topics.get(topic).map(|topic| topic.name.clone()).unwrap_or_default(),
                number,
                count: self.entries.get(topic).map_or(0, Vec::len),
            });
        };
        let changed = self.changed(entry);
        let cached = self.cached(entry)?;
        let (header, range) = cached.messages.get(entry.place.ordinal as usize).ok_or(changed)?;
        let data = &cached.bytes[range.clone()];
        Ok(RawMessage { log_time_ns: header.log_time, sequence: header.sequence, data })
    }

    /// A message of a topic, decoded.
    ///
    /// # Errors
    /// As [`Self::message`], or when it is not of type `M`.
    pub fn read<M: RosMessage>(&mut self, topic: TopicNumber, number: usize) -> Result<M, BagError> {
        let decoded = from_cdr(self.message(topic, number)?.data);
        decoded.map_err(|error| BagError::Message {
            path: self.path.clone(),
            topic: self.topics[topic].name.clone(),
            number,
            cause: error.into(),
        })
    }

    fn changed(&self, entry: Entry) -> BagError {
        let path = self.files[entry.file as usize].0.clone();
        BagError::Damaged { path, at: entry.place.record_at, cause: "the file changed while it was read".into() }
    }

    fn cached(&mut self, entry: Entry) -> Result<&Cached, BagError> {
        let (file, record_at) = (entry.file, entry.place.record_at);
        if let Some(at) = self.cache.iter().position(|c| (c.file, c.record_at) == (file, record_at)) {
            return Ok(&self.cache[at]);
        }
        let cached = self.load(entry)?;
        self.cache.truncate(CACHED_CHUNKS - 1);
        self.cache.push_front(cached);
        Ok(&self.cache[0])
    }

    fn load(&mut self, entry: Entry) -> Result<Cached, BagError> {
        let changed = self.changed(entry);
        let (path, file) = &mut self.files[entry.file as usize];
        let mut head = [0; 9];
        file.seek(SeekFrom::Start(entry.place.record_at)).map_err(BagError::io(path))?;
        file.read_exact(&mut head).map_err(BagError::io(path))?;
        let [opcode, length @ ..] = head;
        let length = usize::try_from(u64::from_le_bytes(length)).unwrap_or(usize::MAX);
        if length > MAX_RECORD_BYTES {
            return Err(changed);
        }
        let mut content = vec![0; length];
        file.read_exact(&mut content).map_err(BagError::io(path))?;
        let damaged = |error: mcap::McapError| BagError::Damaged {
            path: path.clone(),
            at: entry.place.record_at,
            cause: describe(&error),
        };
        let chunk = match opcode {
            op::CHUNK if lengths::fit(opcode, &content) => decode_chunk(&content).map_err(damaged)?,
            op::MESSAGE => ChunkRecords { records: vec![(op::MESSAGE, 0..content.len())], bytes: content },
            _ => return Err(changed),
        };
        let mut messages = Vec::new();
        for (_, range) in chunk.records.iter().filter(|(opcode, _)| *opcode == op::MESSAGE) {
            let record = mcap::parse_record(op::MESSAGE, &chunk.bytes[range.clone()]).map_err(damaged)?;
            if let Record::Message { header, data } = record {
                messages.push((header, range.end - data.len()..range.end));
            }
        }
        Ok(Cached { file: entry.file, record_at: entry.place.record_at, messages, bytes: chunk.bytes })
    }
}
