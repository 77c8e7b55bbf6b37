//! From where to where the topics of a file go, without reading what lies between.

use super::format::{ChannelRecord, metadata_of};
use super::scan::{Item, Scan};
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::path::Path;

/// Chunks at the end that are read. Every topic that is alive has messages in each.
const LAST_CHUNKS: usize = 4;

/// Begin and end of a file's topics.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Extent {
    /// First and last sequence number by topic, as messages carry them: 32 bits, which may have wrapped. A topic that was
    /// silent in the last chunks is given as far as it was seen.
    pub topics: BTreeMap<String, (u32, u32)>,
    /// Metadata records before the first message, by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
}

/// Reads the first chunk of a file and the last ones, by the way also of a file that is cut off. What is damaged at its
/// end is left out.
///
/// # Errors
/// [`BadInput`] if it is absent or no MCAP file.
pub fn extent(path: impl AsRef<Path>) -> Result<Extent, BadInput> {
    let path = path.as_ref();
    let mut scan = Scan::open(path, false)?;
    let mut found = Extent::default();
    let mut topics = BTreeMap::new();
    let first_chunk = look(&mut scan, &mut found, &mut topics, true);
    if first_chunk && scan.seek_last_chunks(LAST_CHUNKS).map_err(|e| e.in_file(path))? {
        look(&mut scan, &mut found, &mut topics, false);
    }
    Ok(found)
}

/// Reads on; `true` if it stopped behind the first chunk, as it was to.
fn look(scan: &mut Scan, found: &mut Extent, topics: &mut BTreeMap<u16, String>, first_chunk: bool) -> bool {
    let mut chunk = None;
    while let Ok(Some(item)) = scan.next_item() {
        match item {
            Item::Channel(content) => topics.extend(ChannelRecord::parse(content).map(|c| (c.id, c.topic))),
            Item::Metadata(content) if chunk.is_none() && first_chunk => found.metadata.extend(metadata_of(content)),
            Item::Message(at, _) => {
                if let Some(topic) = topics.get(&at.channel) {
                    let entry = found.topics.entry(topic.clone()).or_insert((at.sequence, at.sequence));
                    entry.1 = at.sequence;
                }
                let this = scan.chunk_offset();
                if first_chunk && *chunk.get_or_insert(this) != this {
                    return true;
                }
                chunk = Some(this);
            }
            _ => {}
        }
    }
    false
}
