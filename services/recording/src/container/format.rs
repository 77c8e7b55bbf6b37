//! MCAP records as bytes.

use mcap::records::op;
use std::collections::BTreeMap;

/// Bytes before a record's content: opcode and length.
pub(crate) const PREFIX: usize = 9;
/// Bytes of a message record before the message itself: channel, sequence, log time, publish time.
pub(crate) const MESSAGE_HEADER: usize = 22;

pub(crate) fn put_u16(out: &mut Vec<u8>, v: u16) {
    out.extend_from_slice(&v.to_le_bytes());
}

pub(crate) fn put_u32(out: &mut Vec<u8>, v: u32) {
    out.extend_from_slice(&v.to_le_bytes());
}

pub(crate) fn put_u64(out: &mut Vec<u8>, v: u64) {
    out.extend_from_slice(&v.to_le_bytes());
}

pub(crate) fn put_str(out: &mut Vec<u8>, s: &str) {
    put_u32(out, s.len() as u32);
    out.extend_from_slice(s.as_bytes());
}

pub(crate) fn put_map(out: &mut Vec<u8>, map: &BTreeMap<String, String>) {
    let bytes: usize = map.iter().map(|(k, v)| 8 + k.len() + v.len()).sum();
    put_u32(out, bytes as u32);
    for (k, v) in map {
        put_str(out, k);
        put_str(out, v);
    }
}

/// Appends a record whose content `fill` writes.
pub(crate) fn put_record(out: &mut Vec<u8>, opcode: u8, fill: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    put_u64(out, 0);
    let start = out.len();
    fill(out);
    let len = (out.len() - start) as u64;
    if let Some(slot) = out.get_mut(start - 8..start) {
        slot.copy_from_slice(&len.to_le_bytes());
    }
}

pub(crate) fn put_header(out: &mut Vec<u8>, profile: &str) {
    out.extend_from_slice(mcap::MAGIC);
    put_record(out, op::HEADER, |o| {
        put_str(o, profile);
        put_str(o, concat!("lacuna ", env!("CARGO_PKG_VERSION")));
    });
}

pub(crate) fn put_schema(out: &mut Vec<u8>, id: u16, name: &str, encoding: &str, text: &[u8]) {
    put_record(out, op::SCHEMA, |o| {
        put_u16(o, id);
        put_str(o, name);
        put_str(o, encoding);
        put_u32(o, text.len() as u32);
        o.extend_from_slice(text);
    });
}

pub(crate) fn put_channel(out: &mut Vec<u8>, channel: &ChannelRecord) {
    put_record(out, op::CHANNEL, |o| {
        put_u16(o, channel.id);
        put_u16(o, channel.schema_id);
        put_str(o, &channel.topic);
        put_str(o, &channel.encoding);
        put_map(o, &channel.metadata);
    });
}

/// The content of an attachment record.
pub(crate) fn attachment_content(name: &str, media_type: &str, data: &[u8]) -> Vec<u8> {
    let mut o = Vec::new();
    // Log and creation time 0: two recordings of the same input are to be the same bytes.
    put_u64(&mut o, 0);
    put_u64(&mut o, 0);
    put_str(&mut o, name);
    put_str(&mut o, media_type);
    put_u64(&mut o, data.len() as u64);
    o.extend_from_slice(data);
    let crc = crc32fast::hash(&o);
    put_u32(&mut o, crc);
    o
}

/// The fields of an attachment record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct AttachmentFields<'a> {
    pub(crate) log_time: u64,
    pub(crate) create_time: u64,
    pub(crate) name: String,
    pub(crate) media_type: String,
    pub(crate) data: &'a [u8],
}

impl<'a> AttachmentFields<'a> {
    pub(crate) fn parse(content: &'a [u8]) -> Option<Self> {
        let mut f = Fields::new(content);
        let (log_time, create_time) = (f.u64()?, f.u64()?);
        let (name, media_type) = (f.text()?, f.text()?);
        let len = usize::try_from(f.u64()?).ok()?;
        Some(Self { log_time, create_time, name, media_type, data: f.bytes(len)? })
    }
}

/// Reads little-endian numbers and length-prefixed strings; `None` past the end.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a> {
    pub(crate) rest: &'a [u8],
}

impl<'a> Fields<'a> {
    pub(crate) fn new(rest: &'a [u8]) -> Self {
        Self { rest }
    }

    pub(crate) fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(n)?;
        self.rest = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        Some(*taken)
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[b]| b)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// The prefix of a record.
    pub(crate) fn opcode_and_len(&mut self) -> Option<(u8, u64)> {
        Some((self.u8()?, self.u64()?))
    }

    pub(crate) fn text(&mut self) -> Option<String> {
        let len = self.u32()? as usize;
        Some(String::from_utf8_lossy(self.bytes(len)?).into_owned())
    }

    pub(crate) fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let len = self.u32()? as usize;
        let mut inner = Fields::new(self.bytes(len)?);
        let mut map = BTreeMap::new();
        while !inner.rest.is_empty() {
            map.insert(inner.text()?, inner.text()?);
        }
        Some(map)
    }
}

/// A channel record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChannelRecord {
    pub(crate) id: u16,
    pub(crate) schema_id: u16,
    pub(crate) topic: String,
    pub(crate) encoding: String,
    pub(crate) metadata: BTreeMap<String, String>,
}

impl ChannelRecord {
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut f = Fields::new(content);
        Some(Self { id: f.u16()?, schema_id: f.u16()?, topic: f.text()?, encoding: f.text()?, metadata: f.map()? })
    }
}

/// A schema record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SchemaRecord {
    pub(crate) id: u16,
    pub(crate) name: String,
    pub(crate) encoding: String,
    pub(crate) text: Vec<u8>,
}

impl SchemaRecord {
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut f = Fields::new(content);
        let (id, name, encoding) = (f.u16()?, f.text()?, f.text()?);
        let len = f.u32()? as usize;
        Some(Self { id, name, encoding, text: f.bytes(len)?.to_vec() })
    }
}

/// Name and content of a metadata record.
pub(crate) fn metadata_of(content: &[u8]) -> Option<(String, BTreeMap<String, String>)> {
    let mut f = Fields::new(content);
    Some((f.text()?, f.map()?))
}
