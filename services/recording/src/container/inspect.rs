//! What is in an MCAP file, without knowing its messages.

use super::directory::channels_of;
use super::format::{AttachmentFields, ChannelRecord, Fields, SchemaRecord, metadata_of};
use super::scan::{Item, Scan};
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::path::Path;

/// A topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TopicInfo {
    /// Schema name.
    pub schema: String,
    /// Message encoding.
    pub encoding: String,
    /// Number of messages.
    pub messages: u64,
    /// First and last log time [ns].
    pub times: Option<(u64, u64)>,
}

/// What is in a file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FileInfo {
    /// Profile (`ros2`).
    pub profile: String,
    /// What wrote it.
    pub library: String,
    /// Topics by name.
    pub topics: BTreeMap<String, TopicInfo>,
    /// Metadata records by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Attached files by name.
    pub attachments: BTreeMap<String, Vec<u8>>,
    /// True if the file stops before its proper end.
    pub was_cut: bool,
}

impl FileInfo {
    /// True for a recording of ours that was properly finished.
    pub fn is_complete(&self) -> bool {
        let end = self.metadata.get("lacuna.end").and_then(|m| m.get("complete"));
        !self.was_cut && end.is_some_and(|complete| complete == "true")
    }
}

/// Names of a file's topics, sorted; from its summary if it has one.
///
/// # Errors
/// [`BadInput`] if it is absent or no MCAP file.
pub fn topics(path: impl AsRef<Path>) -> Result<Vec<String>, BadInput> {
    let mut names: Vec<String> = channels_of(path.as_ref())?.into_iter().map(|(channel, _)| channel.topic).collect();
    names.sort_unstable();
    names.dedup();
    Ok(names)
}

/// Files attached before the first message, by name: where a recorder puts what explains the recording.
///
/// # Errors
/// [`BadInput`] if the file is absent, no MCAP file, or damaged there.
pub fn leading_attachments(path: impl AsRef<Path>) -> Result<BTreeMap<String, Vec<u8>>, BadInput> {
    let path = path.as_ref();
    let mut scan = Scan::open(path, true)?;
    let mut found = BTreeMap::new();
    while let Some(item) = scan.next_item().map_err(|e| e.in_file(path))? {
        match item {
            Item::Attachment(content) => {
                found.extend(AttachmentFields::parse(content).map(|a| (a.name, a.data.to_vec())));
            }
            Item::Message(..) => break,
            _ => {}
        }
    }
    Ok(found)
}

/// Reads a file through and says what is in it. Attachments are held in memory.
///
/// # Errors
/// [`BadInput`] if it is absent, no MCAP file, or damaged before its end.
pub fn inspect(path: impl AsRef<Path>) -> Result<FileInfo, BadInput> {
    let path = path.as_ref();
    let mut scan = Scan::open(path, true)?;
    let mut info = FileInfo::default();
    let mut schemas = BTreeMap::new();
    let mut topics: BTreeMap<u16, (String, TopicInfo)> = BTreeMap::new();
    while let Some(item) = scan.next_item().map_err(|e| e.in_file(path))? {
        match item {
            Item::Header(content) => {
                let mut f = Fields::new(content);
                info.profile = f.text().unwrap_or_default();
                info.library = f.text().unwrap_or_default();
            }
            Item::Schema(content) => schemas.extend(SchemaRecord::parse(content).map(|s| (s.id, s.name))),
            Item::Channel(content) => {
                if let Some(c) = ChannelRecord::parse(content) {
                    let schema = schemas.get(&c.schema_id).cloned().unwrap_or_default();
                    let new = TopicInfo { schema, encoding: c.encoding, ..TopicInfo::default() };
                    topics.entry(c.id).or_insert((c.topic, new));
                }
            }
            Item::Message(at, _) => {
                if let Some((_, topic)) = topics.get_mut(&at.channel) {
                    topic.messages += 1;
                    let (first, last) = topic.times.unwrap_or((at.log_time, at.log_time));
                    topic.times = Some((first.min(at.log_time), last.max(at.log_time)));
                }
            }
            Item::Attachment(content) => {
                info.attachments.extend(AttachmentFields::parse(content).map(|a| (a.name, a.data.to_vec())));
            }
            Item::Metadata(content) => info.metadata.extend(metadata_of(content)),
        }
    }
    info.was_cut = scan.was_cut();
    for (name, topic) in topics.into_values() {
        // Several publishers of one topic have a channel each.
        let entry = info.topics.entry(name).or_default();
        entry.messages += topic.messages;
        entry.times = match (entry.times, topic.times) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (a, b) => a.or(b),
        };
        entry.schema = topic.schema;
        entry.encoding = topic.encoding;
    }
    Ok(info)
}
