use super::file::{FileWriter, Packing, TopicRecord};
use super::listing::mcap_files;
use super::metadata::{self, FileSpan, Qos};
use super::recover::{Salvaged, salvage};
use super::scan::{Damage, FileContent, SchemaRecord, scan};
use super::{BagError, bag_name};
use mcap::records::MessageHeader;
use pseudoflow_msgs::ros::{BagMessage, to_cdr};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A topic of a [`BagWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TopicId(usize);

/// Writes a rosbag2 directory `NAME/NAME_0.mcap` (and `_1` after each interruption or split) with `metadata.yaml`, all of
/// it for its owner's eyes alone (files 0600, the folder 0700).
///
/// The bytes depend on the messages alone: log and publish times are the stamps given. A frame is safe from this
/// process's death when [`BagWriter::end_frame`] returns: its messages are one chunk, which is in the file whole or
/// not at all, and in the operating system's hands. (From a power failure it is safe after [`BagWriter::finish`];
/// waiting for the disk at each frame would cost some 10 ms.)
#[derive(Debug)]
pub struct BagWriter {
    directory: PathBuf,
    name: String,
    packing: Packing,
    current: FileWriter,
    /// Messages of the frame that has not ended: dropped with the writer, so that no half frame reaches the file.
    pending: Vec<Pending>,
    /// Channel of each topic in the current file.
    channels: Vec<u16>,
    topics: Vec<TopicRecord>,
    counts: BTreeMap<String, u64>,
    done: Vec<FileSpan>,
    custom: BTreeMap<String, String>,
    /// Topics of files from before an interruption.
    earlier: BTreeMap<String, TopicRecord>,
}

#[derive(Debug)]
struct Pending {
    topic: TopicId,
    time_ns: u64,
    sequence: u32,
    cdr: Vec<u8>,
}

/// What a bag held when it was taken up again.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Resumed {
    /// One above the highest sequence number of all messages: the frames below it are safe when they came in order.
    pub next_sequence: u32,
    /// Messages that are there.
    pub messages: u64,
    /// Files that had to be mended, and why.
    pub mended: Vec<String>,
}

impl BagWriter {
    /// Creates a bag's directory and its first file.
    ///
    /// # Errors
    /// When the directory exists or cannot be made.
    pub fn create(directory: &Path, packing: Packing) -> Result<Self, BagError> {
        let name = bag_name(directory)?;
        if directory.exists() {
            return Err(BagError::Exists { path: directory.to_owned() });
        }
        pseudoflow_files::private_folder(directory).map_err(BagError::io(directory))?;
        Self::open(directory, name, packing, 0)
    }

    fn open(directory: &Path, name: String, packing: Packing, split: usize) -> Result<Self, BagError> {
        let path = directory.join(format!("{name}_{split}.mcap"));
        Ok(Self {
            directory: directory.to_owned(),
            name,
            packing,
            current: FileWriter::create(&path, packing, None)?,
            pending: Vec::new(),
            channels: Vec::new(),
            topics: Vec::new(),
            counts: BTreeMap::new(),
            done: Vec::new(),
            custom: BTreeMap::new(),
            earlier: BTreeMap::new(),
        })
    }

    /// Takes up a bag whose writer died: mends its files (whole chunks stay) and goes on in a new one.
    ///
    /// # Errors
    /// When the directory or its files cannot be read or mended.
    pub fn resume(directory: &Path, packing: Packing) -> Result<(Self, Resumed), BagError> {
        let name = bag_name(directory)?;
        let (mut resumed, mut done, mut last) = (Resumed::default(), Vec::new(), None);
        let (mut counts, mut earlier) = (BTreeMap::<String, u64>::new(), BTreeMap::new());
        let mut custom = BTreeMap::new();
        let files = match mcap_files(directory) {
            Err(BagError::NoFiles { .. }) => Vec::new(), // killed between making the directory and its first file
            files => files?,
        };
        for path in files {
            let Some(kept) = take_up(&path, &mut resumed)? else { continue };
            kept.counts.iter().for_each(|(topic, count)| *counts.entry(topic.clone()).or_default() += count);
            earlier.extend(kept.topics.into_iter().map(|topic| (topic.name.clone(), topic)));
            last = last.max(split_number(&path));
            custom.extend(kept.custom);
            done.push(kept.span);
        }
        let mut writer = Self::open(directory, name, packing, last.map_or(0, |split| split + 1))?;
        resumed.messages = done.iter().map(|f| f.messages).sum();
        (writer.done, writer.counts, writer.earlier) = (done, counts, earlier);
        writer.set_custom_data(custom)?;
        Ok((writer, resumed))
    }

    /// The bag's directory.
    #[must_use]
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Adds a topic of messages `M`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn add_topic<M: BagMessage>(&mut self, name: &str, qos: Qos) -> Result<TopicId, BagError> {
        let metadata =
            [("offered_qos_profiles", metadata::qos_yaml(qos)), ("topic_type_hash", M::TYPE_HASH.to_owned())];
        self.add(TopicRecord {
            name: name.to_owned(),
            schema: SchemaRecord {
                name: M::type_name(),
                encoding: "ros2msg".into(),
                data: M::DEFINITION.as_bytes().to_vec(),
            },
            encoding: "cdr".into(),
            metadata: metadata.map(|(key, value)| (key.to_owned(), value)).into(),
        })
    }

    fn add(&mut self, topic: TopicRecord) -> Result<TopicId, BagError> {
        self.channels.push(self.current.add_topic(&topic)?);
        self.counts.entry(topic.name.clone()).or_default();
        self.topics.push(topic);
        Ok(TopicId(self.topics.len() - 1))
    }

    /// Keeps words of ours in the bag (`custom_data`). Call it before the first message.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn set_custom_data(&mut self, custom: BTreeMap<String, String>) -> Result<(), BagError> {
        self.current.write_custom(&custom)?;
        self.custom = custom;
        Ok(())
    }

    /// Takes a message of the frame; it is in the file after [`Self::end_frame`].
    ///
    /// # Errors
    /// When the stamp lies before the epoch or the message cannot be encoded.
    pub fn write<M: BagMessage>(
        &mut self,
        topic: TopicId,
        stamp_ns: i64,
        sequence: u32,
        message: &M,
    ) -> Result<(), BagError> {
        let path = || self.directory.clone();
        let time_ns = u64::try_from(stamp_ns).map_err(|_| BagError::Stamp {
            path: path(),
            topic: self.topics[topic.0].name.clone(),
            stamp_ns,
        })?;
        let cdr = to_cdr(message).map_err(|error| BagError::Write { path: path(), cause: error.to_string() })?;
        self.pending.push(Pending { topic, time_ns, sequence, cdr });
        Ok(())
    }

    /// Writes the frame's messages as one chunk and makes them safe from this process's death.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn end_frame(&mut self) -> Result<(), BagError> {
        for Pending { topic, time_ns, sequence, cdr } in std::mem::take(&mut self.pending) {
            let header = MessageHeader {
                channel_id: self.channels[topic.0],
                sequence,
                log_time: time_ns,
                publish_time: time_ns,
            };
            self.current.write(&header, &cdr)?;
            *self.counts.entry(self.topics[topic.0].name.clone()).or_default() += 1;
        }
        self.current.end_chunk()
    }

    /// Forgets what was written of a frame that has not ended.
    pub fn abandon_frame(&mut self) {
        self.pending.clear();
    }

    /// Bytes of messages in the current file, and frames: what is held of it in memory grows with its frames until
    /// [`Self::split`] or the end.
    #[must_use]
    pub fn current_file(&self) -> (u64, u64) {
        (self.current.bytes, self.current.chunks)
    }

    /// Goes on in a new file of the same bag.
    ///
    /// # Errors
    /// When the files cannot be written.
    pub fn split(&mut self) -> Result<(), BagError> {
        self.end_frame()?;
        let path = self.directory.join(format!("{}_{}.mcap", self.name, self.next_split()));
        let next = FileWriter::create(&path, self.packing, None)?;
        let finished = std::mem::replace(&mut self.current, next);
        self.current.write_custom(&self.custom)?;
        self.channels =
            self.topics.iter().map(|topic| self.current.add_topic(topic)).collect::<Result<_, BagError>>()?;
        let information = self.information(std::slice::from_ref(&finished.span))?;
        self.done.push(finished.finish(information)?);
        Ok(())
    }

    fn next_split(&self) -> usize {
        split_number(Path::new(&self.current.span.name)).map_or(0, |split| split + 1)
    }

    fn information(&self, files: &[FileSpan]) -> Result<String, BagError> {
        let mut topics = self.earlier.clone();
        topics.extend(self.topics.iter().map(|topic| (topic.name.clone(), topic.clone())));
        let count = |topic: &TopicRecord| self.counts.get(&topic.name).copied().unwrap_or_default();
        let counted: Vec<_> = topics.values().map(|topic| topic.counted(count(topic))).collect();
        metadata::information_yaml(files, &counted, &self.custom)
            .map_err(|error| BagError::Metadata { path: self.directory.clone(), cause: error.to_string() })
    }

    /// Ends the frame, closes the last file and writes `metadata.yaml`. Without it the bag can be taken up by
    /// [`Self::resume`].
    ///
    /// # Errors
    /// When the files cannot be written.
    pub fn finish(mut self) -> Result<(), BagError> {
        self.end_frame()?;
        let mut files = self.done.clone();
        files.push(self.current.span.clone());
        let information = self.information(&files)?;
        self.current.finish(information.clone())?;
        metadata::write(&self.directory, &information)?;
        sync_directory(&self.directory)
    }
}

/// Waits until the disk has a directory's entries.
pub(super) fn sync_directory(directory: &Path) -> Result<(), BagError> {
    let opened = std::fs::File::open(directory).map_err(BagError::io(directory))?;
    opened.sync_all().map_err(BagError::io(directory))
}

/// The number in `NAME_3.mcap`.
pub(super) fn split_number(path: &Path) -> Option<usize> {
    path.file_stem()?.to_str()?.rsplit_once('_')?.1.parse().ok()
}

/// Counts a file's messages, mending it first where it is not whole. `None` when nothing in it is worth keeping
/// (it is removed then).
fn take_up(path: &Path, resumed: &mut Resumed) -> Result<Option<Salvaged>, BagError> {
    let mut kept = Salvaged::of(path);
    let mut content = FileContent::default();
    let mut next_sequence = 0;
    let whole = scan(path, Damage::Refuse, &mut content, &mut |met| {
        next_sequence = next_sequence.max(met.header.sequence.saturating_add(1));
        kept.count(met.channel, met.header.log_time);
        Ok(())
    });
    if let Err(cause) = whole {
        if !cause.is_damage() {
            return Err(cause);
        }
        resumed.mended.push(cause.short());
        if kept.span.messages == 0 {
            std::fs::remove_file(path).map_err(BagError::io(path))?;
            return Ok(None);
        }
        let beside = path.with_extension("mcap.recovering");
        let _ = std::fs::remove_file(&beside); // of a mending that was itself cut short
        kept = salvage(path, &beside)?;
        kept.span.name = Salvaged::of(path).span.name;
        std::fs::rename(&beside, path).map_err(BagError::io(path))?;
    } else {
        (kept.topics, kept.custom) = (content.topics(), content.custom_data());
    }
    resumed.next_sequence = resumed.next_sequence.max(next_sequence);
    Ok(Some(kept))
}
