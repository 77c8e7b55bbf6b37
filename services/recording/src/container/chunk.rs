//! Chunks: the compressed blocks that hold an MCAP file's messages.

use super::format::{Fields, PREFIX, put_record, put_str, put_u16, put_u32, put_u64};
use mcap::records::op;
use std::io::{self, Read, Write};

/// Largest chunk that is decompressed [bytes].
pub(crate) const MAX_CHUNK: u64 = 512 << 20;

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compression {
    /// Not at all.
    None,
    /// LZ4: faster, larger.
    Lz4,
    /// Zstandard.
    #[default]
    Zstd,
}

impl Compression {
    /// Name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }
}

/// The fields of a message record before its data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MessageAt {
    pub(crate) channel: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
}

/// A chunk being filled.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    /// Message records.
    pub(crate) records: Vec<u8>,
    /// Per channel: (log time, offset) of its messages, encoded as the message index has them.
    pub(crate) index: Vec<Vec<u8>>,
    /// Earliest and latest log time.
    pub(crate) times: Option<(u64, u64)>,
    pub(crate) messages: u64,
}

impl Chunk {
    pub(crate) fn with_capacity(bytes: usize, channels: usize) -> Self {
        // Written once, so that its pages are there before the first sample and memory does not grow with the load.
        let mut records = vec![u8::MAX; bytes];
        records.clear();
        Self { records, index: vec![Vec::new(); channels], ..Self::default() }
    }

    /// Appends a message whose data `fill` writes.
    #[inline]
    pub(crate) fn push(&mut self, at: MessageAt, fill: impl FnOnce(&mut Vec<u8>)) {
        let MessageAt { channel, sequence, log_time: time, publish_time } = at;
        let offset = self.records.len() as u64;
        let mut head = [0; PREFIX + super::format::MESSAGE_HEADER];
        head[0] = op::MESSAGE;
        head[9..11].copy_from_slice(&channel.to_le_bytes());
        head[11..15].copy_from_slice(&sequence.to_le_bytes());
        head[15..23].copy_from_slice(&time.to_le_bytes());
        head[23..31].copy_from_slice(&publish_time.to_le_bytes());
        let start = self.records.len();
        self.records.extend_from_slice(&head);
        fill(&mut self.records);
        let len = (self.records.len() - start - PREFIX) as u64;
        if let Some(slot) = self.records.get_mut(start + 1..start + PREFIX) {
            slot.copy_from_slice(&len.to_le_bytes());
        }
        let channel = usize::from(channel);
        if channel >= self.index.len() {
            self.index.resize_with(channel + 1, Vec::new);
        }
        let mut entry = [0; 16];
        entry[..8].copy_from_slice(&time.to_le_bytes());
        entry[8..].copy_from_slice(&offset.to_le_bytes());
        self.index[channel].extend_from_slice(&entry);
        self.times = Some(self.times.map_or((time, time), |(a, b)| (a.min(time), b.max(time))));
        self.messages += 1;
    }

    pub(crate) fn clear(&mut self) {
        self.records.clear();
        for entries in &mut self.index {
            entries.clear();
        }
        self.times = None;
        self.messages = 0;
    }
}

/// Turns chunks into records, keeping its buffers.
pub(crate) struct Packer {
    compression: Compression,
    level: i32,
    zstd: Option<zstd::bulk::Compressor<'static>>,
    packed: Vec<u8>,
}

impl Packer {
    pub(crate) fn new(compression: Compression, level: i32) -> io::Result<Self> {
        let zstd = match compression {
            Compression::Zstd => Some(zstd::bulk::Compressor::new(level)?),
            _ => None,
        };
        Ok(Self { compression, level, zstd, packed: Vec::new() })
    }

    /// Appends to `out` the chunk record and its message indexes.
    pub(crate) fn append(&mut self, chunk: &Chunk, out: &mut Vec<u8>) -> io::Result<()> {
        self.pack(&chunk.records)?;
        let records: &[u8] = if self.compression == Compression::None { &chunk.records } else { &self.packed };
        let (start, end) = chunk.times.unwrap_or((0, 0));
        put_record(out, op::CHUNK, |o| {
            put_u64(o, start);
            put_u64(o, end);
            put_u64(o, chunk.records.len() as u64);
            put_u32(o, crc32fast::hash(&chunk.records));
            put_str(o, self.compression.name());
            put_u64(o, records.len() as u64);
            o.extend_from_slice(records);
        });
        for (channel, entries) in chunk.index.iter().enumerate().filter(|(_, e)| !e.is_empty()) {
            put_record(out, op::MESSAGE_INDEX, |o| {
                put_u16(o, channel as u16);
                put_u32(o, entries.len() as u32);
                o.extend_from_slice(entries);
            });
        }
        Ok(())
    }

    fn pack(&mut self, records: &[u8]) -> io::Result<()> {
        self.packed.clear();
        match (self.compression, &mut self.zstd) {
            (Compression::Zstd, Some(zstd)) => {
                self.packed.reserve(zstd::zstd_safe::compress_bound(records.len()));
                zstd.compress_to_buffer(records, &mut self.packed)?;
            }
            (Compression::Lz4, _) => {
                let level = self.level.clamp(0, 16) as u32;
                let mut encoder = lz4::EncoderBuilder::new()
                    .level(level)
                    .block_size(lz4::BlockSize::Max256KB)
                    .block_checksum(lz4::liblz4::BlockChecksum::NoBlockChecksum)
                    .build(std::mem::take(&mut self.packed))?;
                let written = encoder.write_all(records);
                let (packed, finished) = encoder.finish();
                self.packed = packed;
                written.and(finished)?;
            }
            _ => {}
        }
        Ok(())
    }
}

/// The fields of a chunk record before its data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChunkHeader {
    pub(crate) start: u64,
    pub(crate) end: u64,
    pub(crate) uncompressed: u64,
    pub(crate) crc: u32,
    pub(crate) compression: String,
    pub(crate) compressed: u64,
}

impl ChunkHeader {
    /// Longest header with the compressions there are [bytes].
    pub(crate) const MOST: usize = 8 + 8 + 8 + 4 + (4 + 32) + 8;

    /// Splits a chunk record (or its beginning) into header and data.
    pub(crate) fn split(content: &[u8]) -> Option<(Self, &[u8])> {
        let mut f = Fields::new(content);
        let header = Self {
            start: f.u64()?,
            end: f.u64()?,
            uncompressed: f.u64()?,
            crc: f.u32()?,
            compression: f.text()?,
            compressed: f.u64()?,
        };
        Some((header, f.rest))
    }
}

/// How unpacking went.
#[derive(Debug)]
pub(crate) enum Unpacked {
    Whole,
    /// The data end early or are damaged, for this reason; what came before is in the buffer.
    Partly(String),
}

/// Decompresses chunks, keeping what that takes.
#[derive(Default)]
pub(crate) struct Unpacker {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
}

/// Up to this size a chunk is decompressed in one go, into memory reserved on the header's word [bytes].
const TRUSTED_SIZE: u64 = 16 << 20;

impl Unpacker {
    /// Decompresses chunk data into `into`, at most as much as the header claims.
    pub(crate) fn unpack(&mut self, header: &ChunkHeader, data: &[u8], into: &mut Vec<u8>) -> Result<Unpacked, String> {
        if header.uncompressed > MAX_CHUNK {
            return Err(format!("claims {} bytes, more than {MAX_CHUNK}", header.uncompressed));
        }
        let data = data.get(..header.compressed as usize).unwrap_or(data);
        into.clear();
        let result = match header.compression.as_str() {
            "" => data.take(header.uncompressed).read_to_end(into),
            "zstd" if self.zstd_at_once(header.uncompressed, data, into) => Ok(into.len()),
            "zstd" => {
                into.clear();
                let decoder = zstd::stream::read::Decoder::with_buffer(data);
                decoder.and_then(|decoder| fill(decoder, header.uncompressed, into))
            }
            "lz4" => lz4::Decoder::new(data).and_then(|decoder| fill(decoder, header.uncompressed, into)),
            other => {
                let other: String = other.chars().take(32).collect();
                return Err(format!("is compressed with \"{other}\", not with zstd, lz4 or nothing"));
            }
        };
        match result {
            Err(e) => Ok(Unpacked::Partly(format!("does not decompress: {e}"))),
            Ok(_) => Ok(checked(header, into)),
        }
    }

    /// The usual case, without an allocation; `false` sends a cut, damaged or huge chunk the long way.
    fn zstd_at_once(&mut self, size: u64, data: &[u8], into: &mut Vec<u8>) -> bool {
        if self.zstd.is_none() {
            self.zstd = zstd::bulk::Decompressor::new().ok();
        }
        let Some(zstd) = &mut self.zstd else { return false };
        if size > TRUSTED_SIZE {
            return false;
        }
        into.reserve(size as usize);
        zstd.decompress_to_buffer(data, into).is_ok_and(|n| n as u64 == size)
    }
}

fn checked(header: &ChunkHeader, into: &[u8]) -> Unpacked {
    if into.len() as u64 != header.uncompressed {
        return Unpacked::Partly(format!("holds {} bytes, not {}", into.len(), header.uncompressed));
    }
    if header.crc != 0 && crc32fast::hash(into) != header.crc {
        return Unpacked::Partly("does not match its checksum".to_owned());
    }
    Unpacked::Whole
}

/// Reads up to `most` bytes in blocks, so that memory follows what is there and not what is claimed.
fn fill(mut source: impl Read, most: u64, into: &mut Vec<u8>) -> io::Result<usize> {
    const BLOCK: usize = 128 << 10;
    let most = most as usize;
    while into.len() < most {
        let at = into.len();
        into.resize(most.min(at + BLOCK), 0);
        let read = source.read(into.get_mut(at..).unwrap_or(&mut []));
        into.truncate(at + *read.as_ref().unwrap_or(&0));
        if read? == 0 {
            break;
        }
    }
    Ok(into.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_compression_comes_back_and_a_cut_one_gives_its_beginning() {
        let mut chunk = Chunk::with_capacity(1 << 16, 2);
        for k in 0..20_000_u64 {
            let at = MessageAt { channel: (k % 2) as u16, sequence: k as u32, log_time: k, publish_time: k };
            chunk.push(at, |o| o.extend_from_slice(&(k as f64).sin().to_le_bytes()));
        }
        for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
            let mut out = Vec::new();
            Packer::new(compression, 1).unwrap().append(&chunk, &mut out).unwrap();
            let len = u64::from_le_bytes(out[1..9].try_into().unwrap()) as usize;
            let (header, data) = ChunkHeader::split(&out[9..9 + len]).unwrap();
            let mut back = Vec::new();
            let mut unpacker = Unpacker::default();
            let mut unpack =
                |header: &ChunkHeader, data: &[u8], into: &mut Vec<u8>| unpacker.unpack(header, data, into);
            assert!(matches!(unpack(&header, data, &mut back), Ok(Unpacked::Whole)), "{compression:?}");
            assert_eq!(back, chunk.records);
            assert!(matches!(unpack(&header, &data[..data.len() / 2], &mut back), Ok(Unpacked::Partly(_))));
            assert!(back.len() > chunk.records.len() / 4 && chunk.records.starts_with(&back), "{compression:?}");
            let mut damaged = data.to_vec();
            let at = damaged.len() / 2;
            damaged[at] ^= 0x55;
            assert!(matches!(unpack(&header, &damaged, &mut back), Ok(Unpacked::Partly(_))), "{compression:?}");
        }
    }
}
