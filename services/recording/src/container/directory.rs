//! Which channels a file has: from its summary where it has one, which is quick however long the file is.

use super::format::{ChannelRecord, Fields, PREFIX, SchemaRecord};
use super::scan::{Item, MAX_RECORD, Scan};
use lacuna_interfaces::BadInput;
use mcap::records::op;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// A file's channels with the names of their schemas: from the summary if there is one, else by reading the
/// file through.
pub(crate) fn channels_of(path: &Path) -> Result<Vec<(ChannelRecord, String)>, BadInput> {
    if let Some(found) = from_summary(path) {
        return Ok(found);
    }
    let mut scan = Scan::open(path, false)?;
    let mut found = Directory::default();
    // Damage further on is reported when reading gets there; what was declared before it still counts.
    while let Ok(Some(item)) = scan.next_item() {
        match item {
            Item::Schema(content) => found.add_schema(content),
            Item::Channel(content) => found.add_channel(content),
            _ => {}
        }
    }
    Ok(found.list())
}

#[derive(Default)]
struct Directory {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, ChannelRecord>,
}

impl Directory {
    fn add_schema(&mut self, content: &[u8]) {
        self.schemas.extend(SchemaRecord::parse(content).map(|s| (s.id, s.name)));
    }

    fn add_channel(&mut self, content: &[u8]) {
        self.channels.extend(ChannelRecord::parse(content).map(|c| (c.id, c)));
    }

    fn list(self) -> Vec<(ChannelRecord, String)> {
        let schemas = self.schemas;
        self.channels
            .into_values()
            .map(|c| {
                let schema = schemas.get(&c.schema_id).cloned().unwrap_or_default();
                (c, schema)
            })
            .collect()
    }
}

/// Channels as the summary section lists them; `None` if there is none, or if it cannot be trusted.
fn from_summary(path: &Path) -> Option<Vec<(ChannelRecord, String)>> {
    const FOOTER: u64 = PREFIX as u64 + 20;
    let magic = mcap::MAGIC.len() as u64;
    let mut file = File::open(path).ok()?;
    let len = file.metadata().ok()?.len();
    let footer_at = len.checked_sub(FOOTER + magic)?;
    file.seek(SeekFrom::Start(footer_at)).ok()?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail).ok()?;
    let mut f = Fields::new(&tail);
    if f.opcode_and_len()? != (op::FOOTER, 20) || !tail.ends_with(mcap::MAGIC) {
        return None;
    }
    let mut at = f.u64()?;
    if at == 0 || at >= footer_at {
        return None;
    }
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut file = BufReader::new(file);
    let mut found = Directory::default();
    while at < footer_at {
        let mut prefix = [0; PREFIX];
        file.read_exact(&mut prefix).ok()?;
        let mut f = Fields::new(&prefix);
        let (opcode, len) = f.opcode_and_len()?;
        at = at.checked_add(PREFIX as u64)?.checked_add(len)?;
        if at > footer_at {
            return None;
        }
        if matches!(opcode, op::SCHEMA | op::CHANNEL) {
            let mut content = Vec::new();
            (&mut file).take(len.min(MAX_RECORD)).read_to_end(&mut content).ok()?;
            if opcode == op::SCHEMA { found.add_schema(&content) } else { found.add_channel(&content) }
        } else {
            file.seek_relative(i64::try_from(len).ok()?).ok()?;
        }
    }
    (!found.channels.is_empty()).then(|| found.list())
}
