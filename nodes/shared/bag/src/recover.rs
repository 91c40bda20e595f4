use super::file::{FileWriter, Packing, TopicRecord};
use super::listing::mcap_files;
use super::metadata::{self, FileSpan};
use super::scan::{Damage, FileContent, scan};
use super::writer::sync_directory;
use super::{BagError, Partial, bag_name};
use mcap::records::{Channel, MessageHeader};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What to recover, and where to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecoverOptions {
    /// A rosbag2 directory or an .mcap file.
    pub bag: PathBuf,
    /// The directory to write; must not exist. Without: the bag's path with `_recovered` behind its name.
    pub out: Option<PathBuf>,
}

/// What a recovery kept and lost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovered {
    /// The bag that was written.
    pub directory: PathBuf,
    /// Messages by topic.
    pub messages: BTreeMap<String, u64>,
    /// What was wrong, a line for each damage.
    pub damages: Vec<String>,
}

/// Writes what is whole of a cut-off or damaged bag into a new one. Nothing is left behind on an error; the input
/// stays as it is.
///
/// # Errors
/// When the input is no MCAP file, nothing in it is whole, or the output exists or cannot be written.
pub fn recover(options: &RecoverOptions) -> Result<Recovered, BagError> {
    let files = if options.bag.is_dir() { mcap_files(&options.bag)? } else { vec![options.bag.clone()] };
    let directory = options.out.clone().unwrap_or_else(|| default_output(&options.bag));
    let name = bag_name(&directory)?;
    let partial = Partial::directory(&directory)?;
    let mut recovered = Recovered { directory: directory.clone(), messages: BTreeMap::new(), damages: Vec::new() };
    let (mut spans, mut topics, mut custom, mut last_error) = (Vec::new(), BTreeMap::new(), BTreeMap::new(), None);
    for path in &files {
        let target = partial.path().join(format!("{name}_{}.mcap", spans.len()));
        let kept = match salvage(path, &target) {
            Ok(kept) => kept,
            Err(error) if error.is_damage() => {
                recovered.damages.push(error.short());
                last_error = Some(error);
                continue;
            }
            Err(error) => return Err(error),
        };
        recovered.damages.extend(kept.damages);
        kept.counts.iter().for_each(|(topic, n)| *recovered.messages.entry(topic.clone()).or_default() += n);
        topics.extend(kept.topics.into_iter().map(|topic| (topic.name.clone(), topic)));
        custom.extend(kept.custom);
        spans.push(kept.span);
    }
    if let (true, Some(error)) = (spans.is_empty(), last_error) {
        return Err(error);
    }
    let counted: Vec<_> =
        topics.values().map(|t| t.counted(recovered.messages.get(&t.name).copied().unwrap_or_default())).collect();
    let information = metadata::information_yaml(&spans, &counted, &custom)
        .map_err(|error| BagError::Metadata { path: directory.clone(), cause: error.to_string() })?;
    metadata::write(partial.path(), &information)?;
    sync_directory(partial.path())?;
    partial.keep()?;
    Ok(recovered)
}

fn default_output(bag: &Path) -> PathBuf {
    let stem = bag.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    bag.with_file_name(format!("{stem}_recovered"))
}

/// What was kept of one file.
#[derive(Debug, Clone)]
pub(super) struct Salvaged {
    pub(super) span: FileSpan,
    pub(super) counts: BTreeMap<String, u64>,
    pub(super) topics: Vec<TopicRecord>,
    pub(super) custom: BTreeMap<String, String>,
    pub(super) damages: Vec<String>,
}

impl Salvaged {
    pub(super) fn of(path: &Path) -> Self {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let span = FileSpan { name, ..FileSpan::default() };
        let (counts, custom) = (BTreeMap::new(), BTreeMap::new());
        Self { span, counts, topics: Vec::new(), custom, damages: Vec::new() }
    }

    pub(super) fn count(&mut self, channel: &Channel, log_time_ns: u64) {
        self.span.add(log_time_ns);
        *self.counts.entry(channel.topic.clone()).or_default() += 1;
    }
}

/// Copies what is whole of a file: whole chunks of a cut-off one, all chunks but the wrong ones of a damaged one.
pub(super) fn salvage(path: &Path, target: &Path) -> Result<Salvaged, BagError> {
    let (mut kept, mut content) = (Salvaged::of(path), FileContent::default());
    let mut writer = FileWriter::create(target, Packing::None, Some(1 << 20))?;
    let mut channels = BTreeMap::new();
    let mut chunk = None;
    let outcome = scan(path, Damage::LeaveOut, &mut content, &mut |met| {
        // One chunk stays one chunk: a frame's messages stay together.
        if chunk.replace(met.place.record_at).is_some_and(|before| before != met.place.record_at) {
            writer.end_chunk()?;
        }
        let id = match channels.get(&met.channel.id) {
            Some(id) => *id,
            None => {
                let topic = TopicRecord::of_channel(met.channel, met.schema);
                *channels.entry(met.channel.id).or_insert(writer.add_topic(&topic)?)
            }
        };
        kept.count(met.channel, met.header.log_time);
        writer.write(&MessageHeader { channel_id: id, ..met.header }, met.data)
    });
    kept.damages.append(&mut content.lost);
    match outcome {
        Err(error) if error.is_damage() && kept.span.messages > 0 => kept.damages.push(error.short()),
        Err(error) => {
            drop(writer);
            let _ = std::fs::remove_file(target);
            return Err(error);
        }
        Ok(()) => {}
    }
    kept.topics = content.topics();
    let counted: Vec<_> =
        kept.topics.iter().map(|t| t.counted(kept.counts.get(&t.name).copied().unwrap_or_default())).collect();
    let custom = content.custom_data();
    let information = metadata::information_yaml(std::slice::from_ref(&writer.span), &counted, &custom)
        .map_err(|error| BagError::Metadata { path: target.to_owned(), cause: error.to_string() })?;
    writer.write_custom(&custom)?;
    kept.custom = custom;
    kept.span = writer.finish(information)?;
    Ok(kept)
}
