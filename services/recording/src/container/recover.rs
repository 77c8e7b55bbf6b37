//! Completing an MCAP file that was cut off: everything readable goes into a new file with index and end mark.

use super::format::{AttachmentFields, ChannelRecord, Fields, SchemaRecord};
use super::scan::{Item, Scan};
use super::writer::{Channel, ChannelId, Finished, WriteError, Writer, WriterOptions};
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::path::Path;

/// Most damaged places that are stepped over.
const MOST_DAMAGES: usize = 1000;

/// What was recovered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovered {
    /// What the new file holds.
    pub finished: Finished,
    /// True if the old file stopped before its proper end.
    pub was_cut: bool,
    /// Damaged places that were left out.
    pub damages: Vec<BadInput>,
}

/// Reads `from` as far as it goes and writes a complete file `to`. Attachments and metadata are kept; a record
/// `lacuna.recovered` says what was done. The new file is not marked complete: what was lost stays lost.
///
/// # Errors
/// [`WriteError`] if `from` is not an MCAP file or `to` cannot be written.
pub fn recover(from: impl AsRef<Path>, to: impl AsRef<Path>, options: &WriterOptions) -> Result<Recovered, WriteError> {
    let from = from.as_ref();
    let mut scan = Scan::open(from, true)?;
    let mut damages = Vec::new();
    let mut copy = Copy { to: to.as_ref(), options, writer: None, schemas: BTreeMap::new(), channels: BTreeMap::new() };
    let mut stuck_at = None;
    loop {
        match scan.next_item() {
            Ok(Some(item)) => copy.item(item)?,
            Ok(None) => break,
            Err(error) => {
                damages.push(error.in_file(from));
                let at = scan.position();
                // Past a damaged chunk the file goes on; where reading itself fails it does not.
                if stuck_at == Some(at) || damages.len() >= MOST_DAMAGES {
                    break;
                }
                stuck_at = Some(at);
            }
        }
    }
    let was_cut = scan.was_cut();
    let mut writer = copy.writer()?;
    let facts = [("was_cut", was_cut.to_string()), ("damaged_places", damages.len().to_string())];
    writer.metadata("lacuna.recovered", &facts.map(|(k, v)| (k.to_owned(), v)).into())?;
    Ok(Recovered { finished: writer.finish()?, was_cut, damages })
}

struct Copy<'a> {
    to: &'a Path,
    options: &'a WriterOptions,
    writer: Option<Writer>,
    schemas: BTreeMap<u16, SchemaRecord>,
    channels: BTreeMap<u16, (ChannelRecord, ChannelId)>,
}

impl Copy<'_> {
    fn writer(mut self) -> Result<Writer, WriteError> {
        self.started("")?;
        let Self { writer, to, .. } = self;
        writer.ok_or_else(|| WriteError::Lost(to.to_path_buf()))
    }

    fn started(&mut self, profile: &str) -> Result<&mut Writer, WriteError> {
        let new = match self.writer.take() {
            Some(writer) => writer,
            None => Writer::create(self.to, profile, self.options)?,
        };
        Ok(self.writer.insert(new))
    }

    fn item(&mut self, item: Item<'_>) -> Result<(), WriteError> {
        match item {
            Item::Header(content) => {
                let profile = Fields::new(content).text().unwrap_or_default();
                self.started(&profile)?;
            }
            Item::Schema(content) => self.schemas.extend(SchemaRecord::parse(content).map(|s| (s.id, s))),
            Item::Channel(content) => {
                if let Some(channel) = ChannelRecord::parse(content) {
                    self.channel(channel)?;
                }
            }
            Item::Message(mut at, data) => {
                // A message of a channel that was never declared cannot be understood by anyone.
                let Some((_, id)) = self.channels.get(&at.channel) else { return Ok(()) };
                at.channel = id.0;
                let writer = self.started("")?;
                let mut batch = writer.batch();
                batch.message_at(at, |out| out.extend_from_slice(data));
                if !batch.end() {
                    return Err(writer.failure());
                }
            }
            Item::Attachment(content) => {
                if AttachmentFields::parse(content).is_some() {
                    self.started("")?.attach_raw(content.to_vec())?;
                }
            }
            Item::Metadata(content) => self.started("")?.metadata_raw(content.to_vec())?,
        }
        Ok(())
    }

    fn channel(&mut self, record: ChannelRecord) -> Result<(), WriteError> {
        // Chunks repeat declarations; a second one that says the same is no second channel.
        if self.channels.get(&record.id).is_some_and(|(known, _)| *known == record) {
            return Ok(());
        }
        let schema = self.schemas.get(&record.schema_id);
        let channel = Channel {
            topic: record.topic.clone(),
            schema: schema.map_or(String::new(), |s| s.name.clone()),
            schema_encoding: schema.map_or(String::new(), |s| s.encoding.clone()),
            schema_text: schema.map_or(Vec::new(), |s| s.text.clone()),
            encoding: record.encoding.clone(),
            metadata: record.metadata.clone(),
        };
        let id = self.started("")?.channel(channel)?;
        self.channels.insert(record.id, (record, id));
        Ok(())
    }
}
