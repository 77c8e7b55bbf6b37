//! The end of an MCAP file: what readers use to find things without reading it through.
//!
//! Chunk indexes are not kept while recording, since they would grow with time; they are read back from the
//! file itself when it is finished.

use super::chunk::{Chunk, ChunkHeader};
use super::format::{AttachmentFields, Fields, PREFIX, put_record, put_str, put_u16, put_u32, put_u64};
use mcap::records::op;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};

/// What a writer keeps for the summary; its size does not depend on the length of the recording.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    /// Whole records.
    pub(crate) schemas: Vec<Vec<u8>>,
    /// Whole records.
    pub(crate) channels: Vec<Vec<u8>>,
    /// Attachment index records.
    pub(crate) attachments: Vec<Vec<u8>>,
    /// Metadata index records.
    pub(crate) metadata: Vec<Vec<u8>>,
    /// Messages per channel.
    pub(crate) messages: BTreeMap<u16, u64>,
    /// First and last log time.
    pub(crate) times: Option<(u64, u64)>,
    chunks: u32,
    /// Where the first chunk lies; before it there is none to be found.
    first_chunk: u64,
}

impl Totals {
    /// Counts a chunk that begins at byte `at`.
    pub(crate) fn count(&mut self, chunk: &Chunk, at: u64) {
        if self.chunks == 0 {
            self.first_chunk = at;
        }
        self.chunks += 1;
        for (channel, entries) in chunk.index.iter().enumerate().filter(|(_, e)| !e.is_empty()) {
            *self.messages.entry(channel as u16).or_default() += entries.len() as u64 / 16;
        }
        self.times = match (self.times, chunk.times) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (a, b) => a.or(b),
        };
    }
}

/// Index record of an attachment with this content, whose record begins at `at` and is `len` bytes long.
pub(crate) fn attachment_index(at: u64, len: usize, a: &AttachmentFields<'_>) -> Vec<u8> {
    let mut record = Vec::new();
    put_record(&mut record, op::ATTACHMENT_INDEX, |o| {
        put_u64(o, at);
        put_u64(o, len as u64);
        put_u64(o, a.log_time);
        put_u64(o, a.create_time);
        put_u64(o, a.data.len() as u64);
        put_str(o, &a.name);
        put_str(o, &a.media_type);
    });
    record
}

/// Index record of a metadata record.
pub(crate) fn metadata_index(at: u64, len: usize, name: &str) -> Vec<u8> {
    let mut record = Vec::new();
    put_record(&mut record, op::METADATA_INDEX, |o| {
        put_u64(o, at);
        put_u64(o, len as u64);
        put_str(o, name);
    });
    record
}

/// Appends data end, summary, footer and magic to a file whose data section ends at `at` with checksum `crc`.
/// `readable` is a second handle on the same file. Returns the file's final size.
pub(crate) fn write(file: &File, readable: &File, at: u64, crc: u32, totals: &Totals) -> io::Result<u64> {
    let mut data_end = Vec::new();
    put_record(&mut data_end, op::DATA_END, |o| put_u32(o, crc));
    let start = at + data_end.len() as u64;
    let mut out = Out { to: BufWriter::new(file), at: start, crc: crc32fast::Hasher::new(), groups: Vec::new() };
    out.to.write_all(&data_end)?;
    out.group(op::SCHEMA, &totals.schemas)?;
    out.group(op::CHANNEL, &totals.channels)?;
    out.group(op::STATISTICS, &[statistics(totals)])?;
    let chunks_at = out.at;
    if totals.chunks > 0 {
        each_chunk(readable, totals.first_chunk, at, |index| out.put(index))?;
        out.groups.push((op::CHUNK_INDEX, chunks_at, out.at - chunks_at));
    }
    out.group(op::ATTACHMENT_INDEX, &totals.attachments)?;
    out.group(op::METADATA_INDEX, &totals.metadata)?;
    out.end(start)
}

struct Out<'a> {
    to: BufWriter<&'a File>,
    at: u64,
    crc: crc32fast::Hasher,
    /// Opcode, start and length of each group.
    groups: Vec<(u8, u64, u64)>,
}

impl Out<'_> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.crc.update(bytes);
        self.at += bytes.len() as u64;
        self.to.write_all(bytes)
    }

    fn group(&mut self, opcode: u8, records: &[Vec<u8>]) -> io::Result<()> {
        let start = self.at;
        for record in records {
            self.put(record)?;
        }
        if self.at > start {
            self.groups.push((opcode, start, self.at - start));
        }
        Ok(())
    }

    fn end(mut self, start: u64) -> io::Result<u64> {
        let offsets = self.at;
        let mut record = Vec::new();
        for (opcode, start, len) in std::mem::take(&mut self.groups) {
            put_record(&mut record, op::SUMMARY_OFFSET, |o| {
                o.push(opcode);
                put_u64(o, start);
                put_u64(o, len);
            });
        }
        self.put(&record)?;
        // The checksum covers the footer up to itself.
        let mut footer = Vec::new();
        put_record(&mut footer, op::FOOTER, |o| {
            put_u64(o, start);
            put_u64(o, offsets);
            put_u32(o, 0);
        });
        footer.truncate(footer.len() - 4);
        self.put(&footer)?;
        let crc = self.crc.clone().finalize();
        self.put(&crc.to_le_bytes())?;
        self.put(mcap::MAGIC)?;
        self.to.flush()?;
        Ok(self.at)
    }
}

fn statistics(totals: &Totals) -> Vec<u8> {
    let (start, end) = totals.times.unwrap_or((0, 0));
    let mut record = Vec::new();
    put_record(&mut record, op::STATISTICS, |o| {
        put_u64(o, totals.messages.values().sum());
        put_u16(o, totals.schemas.len() as u16);
        put_u32(o, totals.channels.len() as u32);
        put_u32(o, totals.attachments.len() as u32);
        put_u32(o, totals.metadata.len() as u32);
        put_u32(o, totals.chunks);
        put_u64(o, start);
        put_u64(o, end);
        put_u32(o, totals.messages.len() as u32 * 10);
        for (&channel, &count) in &totals.messages {
            put_u16(o, channel);
            put_u64(o, count);
        }
    });
    record
}

/// Walks the data section and hands over the index record of each chunk.
fn each_chunk(file: &File, from: u64, to: u64, mut emit: impl FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
    let mut reader = BufReader::with_capacity(4096, file);
    reader.seek(SeekFrom::Start(from))?;
    let mut at = from;
    let mut pending: Option<Pending> = None;
    while at < to {
        let mut prefix = [0; PREFIX];
        reader.read_exact(&mut prefix)?;
        let (opcode, len) = Fields::new(&prefix).opcode_and_len().ok_or_else(damaged)?;
        let mut head = [0; ChunkHeader::MOST];
        let head_len = head.len().min(len as usize);
        let head = head.get_mut(..head_len).unwrap_or_default();
        if matches!(opcode, op::CHUNK | op::MESSAGE_INDEX) {
            reader.read_exact(head)?;
            reader.seek_relative(len as i64 - head.len() as i64)?;
        } else {
            reader.seek_relative(len as i64)?;
        }
        match (opcode, &mut pending) {
            (op::MESSAGE_INDEX, Some(pending)) => {
                let channel = Fields::new(head).u16().ok_or_else(damaged)?;
                pending.offsets.push((channel, at));
                pending.indexes_len += PREFIX as u64 + len;
            }
            _ => {
                if let Some(done) = pending.take() {
                    emit(&done.record())?;
                }
                if opcode == op::CHUNK {
                    let (header, _) = ChunkHeader::split(head).ok_or_else(damaged)?;
                    pending =
                        Some(Pending { header, at, len: PREFIX as u64 + len, offsets: Vec::new(), indexes_len: 0 });
                }
            }
        }
        at += PREFIX as u64 + len;
    }
    pending.map_or(Ok(()), |last| emit(&last.record()))
}

fn damaged() -> io::Error {
    io::Error::other("the file is not what was written")
}

struct Pending {
    header: ChunkHeader,
    at: u64,
    len: u64,
    offsets: Vec<(u16, u64)>,
    indexes_len: u64,
}

impl Pending {
    fn record(&self) -> Vec<u8> {
        let mut record = Vec::new();
        put_record(&mut record, op::CHUNK_INDEX, |o| {
            put_u64(o, self.header.start);
            put_u64(o, self.header.end);
            put_u64(o, self.at);
            put_u64(o, self.len);
            put_u32(o, self.offsets.len() as u32 * 10);
            for &(channel, offset) in &self.offsets {
                put_u16(o, channel);
                put_u64(o, offset);
            }
            put_u64(o, self.indexes_len);
            put_str(o, &self.header.compression);
            put_u64(o, self.header.compressed);
            put_u64(o, self.header.uncompressed);
        });
        record
    }
}
