//! The messages of an MCAP recording, topic by topic, as they stand in it: nothing is repaired, nothing left out.
//!
//! For what looks at recordings (export, play, echo, hz). What computes with them reads samples ([`crate::open`]),
//! which are judged and matched to a robot.

use crate::container::{ChannelRecord, Item, Scan, SchemaRecord, metadata_of};
use crate::ros::definition::{Decoded, Layout};
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A topic, once its first channel was declared.
#[derive(Debug, Clone, PartialEq)]
pub struct MessageTopic {
    /// Name.
    pub name: String,
    /// Schema name, `package/msg/Type`.
    pub schema: String,
    /// Message encoding; `cdr` is what can be decoded.
    pub encoding: String,
    /// How its messages are decoded; `None` if they cannot be, field by field.
    pub layout: Option<Layout>,
    /// Whether its header stamps are 0 and log times stand for them; known after its first message.
    by_log_time: Option<bool>,
}

/// A message; its bytes are in [`Messages::data`] until the next one is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message {
    /// Index of its topic in [`Messages::topics`].
    pub topic: usize,
    /// Time of measurement [ns]: the header stamp; the log time where there is none, or where the topic's first one is 0.
    pub stamp_ns: i64,
    /// Time at which it was recorded [ns].
    pub log_time_ns: u64,
}

/// Reads the messages of a file in the order in which they stand in it, in constant memory.
pub struct Messages {
    scan: Scan,
    path: PathBuf,
    topics: Vec<MessageTopic>,
    schemas: BTreeMap<u16, SchemaRecord>,
    by_channel: BTreeMap<u16, usize>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    data: Vec<u8>,
    bytes: u64,
}

impl std::fmt::Debug for Messages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Messages").field("path", &self.path).field("topics", &self.topics).finish_non_exhaustive()
    }
}

impl Messages {
    /// Opens an MCAP file, or the only one of a bag folder.
    ///
    /// # Errors
    /// [`BadInput`] if it is absent or no MCAP file.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BadInput> {
        let path = crate::reader::file_of(path.as_ref())?;
        let scan = Scan::open(&path, false)?;
        let bytes = std::fs::metadata(&path).map_or(0, |m| m.len());
        Ok(Self {
            scan,
            path,
            topics: Vec::new(),
            schemas: BTreeMap::new(),
            by_channel: BTreeMap::new(),
            metadata: BTreeMap::new(),
            data: Vec::new(),
            bytes,
        })
    }

    /// The file that is read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics declared so far, in the order in which they were.
    pub fn topics(&self) -> &[MessageTopic] {
        &self.topics
    }

    /// A topic by its index.
    pub fn topic(&self, index: usize) -> Option<&MessageTopic> {
        self.topics.get(index)
    }

    /// Metadata records read so far, by name.
    pub fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.metadata
    }

    /// The bytes of the message that was read last, in its topic's encoding.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// Share of the file that has been read, 0 to 1.
    pub fn fraction(&self) -> f64 {
        if self.bytes == 0 { 1.0 } else { (self.scan.position() as f64 / self.bytes as f64).min(1.0) }
    }

    /// True if the file stops before its proper end; known at the end.
    pub fn was_cut(&self) -> bool {
        self.scan.was_cut()
    }

    /// The next message; `None` at the end, or where the file is cut.
    ///
    /// # Errors
    /// [`BadInput`] where the file is damaged.
    pub fn next_message(&mut self) -> Result<Option<Message>, BadInput> {
        while let Some(item) = self.scan.next_item().map_err(|e| e.in_file(&self.path))? {
            match item {
                Item::Schema(content) => self.schemas.extend(SchemaRecord::parse(content).map(|s| (s.id, s))),
                Item::Channel(content) => {
                    if let Some(channel) = ChannelRecord::parse(content) {
                        declare(channel, &self.schemas, &mut self.topics, &mut self.by_channel);
                    }
                }
                Item::Metadata(content) => self.metadata.extend(metadata_of(content)),
                Item::Message(at, data) => {
                    // A message of a channel that was never declared cannot be understood by anyone.
                    let Some(&index) = self.by_channel.get(&at.channel) else { continue };
                    let Some(topic) = self.topics.get_mut(index) else { continue };
                    let stamp_ns = topic.stamp(data, at.log_time);
                    self.data.clear();
                    self.data.extend_from_slice(data);
                    return Ok(Some(Message { topic: index, stamp_ns, log_time_ns: at.log_time }));
                }
                Item::Header(_) | Item::Attachment(_) => {}
            }
        }
        Ok(None)
    }
}

/// A name as it can stand in a message of one line.
pub fn one_line(name: &str) -> String {
    name.replace(char::is_control, "\u{fffd}")
}

/// Takes note of a channel; several of one topic (publishers of their own) are one.
fn declare(
    channel: ChannelRecord,
    schemas: &BTreeMap<u16, SchemaRecord>,
    topics: &mut Vec<MessageTopic>,
    by_channel: &mut BTreeMap<u16, usize>,
) {
    if by_channel.contains_key(&channel.id) {
        return;
    }
    let schema = schemas.get(&channel.schema_id);
    let name = schema.map_or("", |s| s.name.as_str());
    let same = |t: &MessageTopic| t.name == channel.topic && t.schema == name && t.encoding == channel.encoding;
    let index = topics.iter().position(same).unwrap_or_else(|| {
        let text = schema.filter(|s| s.encoding == "ros2msg" && channel.encoding == "cdr");
        topics.push(MessageTopic {
            name: channel.topic.clone(),
            schema: name.to_owned(),
            encoding: channel.encoding.clone(),
            layout: text.and_then(|s| Layout::parse(&String::from_utf8_lossy(&s.text))),
            by_log_time: None,
        });
        topics.len() - 1
    });
    by_channel.insert(channel.id, index);
}

impl MessageTopic {
    /// Decodes a message into `out`.
    ///
    /// # Errors
    /// [`BadInput`] if there is no layout, or the message does not fit it.
    pub fn decode(&self, data: &[u8], out: &mut Decoded) -> Result<(), BadInput> {
        let bad = |found: &str| {
            BadInput::new(format!("topic {}: found {found}; expected {}", one_line(&self.name), one_line(&self.schema)))
        };
        let layout = self.layout.as_ref().ok_or_else(|| bad("a message that cannot be decoded field by field"))?;
        layout.decode(data, out).ok_or_else(|| bad("a message that does not fit its definition"))
    }

    fn stamp(&mut self, data: &[u8], log_time: u64) -> i64 {
        let logged = log_time.min(i64::MAX as u64) as i64;
        let stamped = self.layout.as_ref().is_some_and(Layout::is_stamped);
        let header = if stamped { crate::ros::cdr::Cursor::new(data).and_then(|mut c| c.header()) } else { None };
        let by_log_time = *self.by_log_time.get_or_insert(header.is_none_or(|ns| ns == 0 && log_time != 0));
        if by_log_time { logged } else { header.unwrap_or(logged) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::{Writer, WriterOptions};
    use crate::ros::definition::Scalar;
    use crate::topics::{Has, Topic};
    use lacuna_interfaces::Header;

    #[test]
    fn messages_come_in_file_order_with_their_stamps() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut writer = Writer::create(&path, "ros2", &WriterOptions::default()).unwrap();
        writer.metadata("lacuna", &[("torque_unit".to_owned(), "A".to_owned())].into()).unwrap();
        let joints = ["a".to_owned()];
        let has = Has { position: true, velocity: false, effort: true };
        let measured = Topic::joint_state(&mut writer, "/measured", &joints, has).unwrap();
        let mass = Topic::payload(&mut writer, "/payload").unwrap();
        for k in 0..100_i64 {
            let header =
                Header { seq: k as u64 + 1, stamp_ns: -3_000_000_000 + k * 1_000_000_000, ..Header::default() };
            let mut batch = writer.batch();
            measured.write(&mut batch, &header, |s| s.numbers(&[k as f64]).numbers(&[-0.5]).done());
            if k % 10 == 0 {
                mass.write(&mut batch, &header, |s| {
                    s.bytes(&1.5_f64.to_le_bytes()).bytes(&[0; 8]).bytes(&[1]).bytes(&[0]).done()
                });
            }
            assert!(batch.end());
        }
        writer.finish().unwrap();
        let mut messages = Messages::open(&path).unwrap();
        let (mut stamps, mut masses, mut decoded) = (Vec::new(), 0, Decoded::default());
        while let Some(message) = messages.next_message().unwrap() {
            let topic = messages.topic(message.topic).unwrap();
            topic.decode(messages.data(), &mut decoded).unwrap();
            if topic.name == "/measured" {
                let position = topic.layout.as_ref().unwrap().find("position").unwrap();
                assert_eq!(decoded.of(position), [Scalar::Float(stamps.len() as f64)]);
                stamps.push(message.stamp_ns);
            } else {
                masses += 1;
            }
        }
        assert_eq!(messages.topics().len(), 2);
        assert_eq!(stamps, (0..100).map(|k| -3_000_000_000 + k * 1_000_000_000).collect::<Vec<i64>>());
        assert_eq!((masses, messages.was_cut()), (10, false));
        assert_eq!(messages.metadata()["lacuna"]["torque_unit"], "A");
    }
}
