//! Reading an MCAP file front to back, chunk by chunk, within a memory budget and without an index, so that a
//! file whose end is missing reads as far as it goes.

use super::chunk::{ChunkHeader, MAX_CHUNK, MessageAt, Unpacked, Unpacker};
use super::format::{Fields, MESSAGE_HEADER, PREFIX};
use crate::files::open_error;
use lacuna_interfaces::BadInput;
use mcap::records::op;
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// Largest record outside chunks that is loaded [bytes].
pub(crate) const MAX_RECORD: u64 = MAX_CHUNK;
/// Most that a file's schemas and channels may hold together [bytes]: readers keep them, and compressed they cost a hostile
/// file nothing.
const MAX_DECLARED: usize = 64 << 20;

/// One record of the data section. The slices are the records' contents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Item<'a> {
    Header(&'a [u8]),
    Schema(&'a [u8]),
    Channel(&'a [u8]),
    Message(MessageAt, &'a [u8]),
    Attachment(&'a [u8]),
    Metadata(&'a [u8]),
}

/// Position in the file and buffers; memory is bounded by the largest chunk, and what is declared by [`MAX_DECLARED`].
pub(crate) struct Scan {
    file: BufReader<File>,
    len: u64,
    at: u64,
    attachments: bool,
    record: Vec<u8>,
    chunk: Vec<u8>,
    unpacker: Unpacker,
    /// Next record in `chunk`; `None` between chunks.
    chunk_at: Option<usize>,
    chunk_offset: u64,
    chunk_cut: bool,
    declared: Declared,
    has_end: bool,
    ended: bool,
    cut: bool,
}

/// Where the next item lies.
enum Step {
    Top(u8),
    InChunk(u8, Range<usize>),
}

impl Scan {
    /// Opens a file. With `attachments` they are loaded and handed out, otherwise skipped.
    pub(crate) fn open(path: &Path, attachments: bool) -> Result<Self, BadInput> {
        let file = File::open(path).map_err(|e| open_error(path, &e))?;
        Self::new(file, attachments).map_err(|e| e.in_file(path))
    }

    fn new(mut file: File, attachments: bool) -> Result<Self, BadInput> {
        let fail = |e: std::io::Error| BadInput::new(format!("cannot be read: {e}"));
        let len = file.metadata().map_err(fail)?.len();
        let magic = mcap::MAGIC.len() as u64;
        let mut tail = [0; 8];
        if len >= 2 * magic {
            file.seek(SeekFrom::End(-(magic as i64))).map_err(fail)?;
            file.read_exact(&mut tail).map_err(fail)?;
            file.rewind().map_err(fail)?;
        }
        let mut file = BufReader::with_capacity(64 << 10, file);
        let mut head = [0; 8];
        let whole = file.read_exact(&mut head).is_ok() && head == *mcap::MAGIC;
        if !whole {
            return Err(BadInput::new("found no MCAP signature in the first bytes; expected an MCAP file"));
        }
        Ok(Self {
            file,
            len,
            at: magic,
            attachments,
            record: Vec::new(),
            chunk: Vec::new(),
            unpacker: Unpacker::default(),
            chunk_at: None,
            chunk_offset: 0,
            chunk_cut: false,
            declared: Declared::default(),
            has_end: tail == *mcap::MAGIC,
            ended: false,
            cut: false,
        })
    }

    /// Bytes read so far; the whole file once the data section is through.
    pub(crate) fn position(&self) -> u64 {
        if self.ended { self.len } else { self.at }
    }

    /// Where the chunk of the last item begins.
    pub(crate) fn chunk_offset(&self) -> u64 {
        self.chunk_offset
    }

    /// Goes on at the `count`th chunk before the end, passing over the others by their lengths; `false` if there is no
    /// chunk beyond the present one.
    pub(crate) fn seek_last_chunks(&mut self, count: usize) -> Result<bool, BadInput> {
        self.chunk_at = None;
        let mut starts = VecDeque::new();
        while !self.ended {
            let start = self.at;
            let Some((opcode, len)) = self.prefix()? else { continue };
            match opcode {
                op::DATA_END | op::FOOTER => break,
                op::CHUNK => starts.push_back(start),
                _ => {}
            }
            if starts.len() > count {
                starts.pop_front();
            }
            self.skip(len)?;
        }
        let Some(&start) = starts.front() else { return Ok(false) };
        self.file.seek(SeekFrom::Start(start)).map_err(|e| self.unreadable(&e))?;
        (self.at, self.ended, self.cut) = (start, false, false);
        Ok(true)
    }

    /// True if the file turned out to stop before its proper end. Known once the end is reached.
    pub(crate) fn was_cut(&self) -> bool {
        self.cut
    }

    /// The next record of the data section; `None` at its end or where the file is cut.
    pub(crate) fn next_item(&mut self) -> Result<Option<Item<'_>>, BadInput> {
        loop {
            let Some(step) = self.step()? else { return Ok(None) };
            let (opcode, content) = match step {
                // Polonius would let one match do; today the check for items of no interest comes first.
                Step::Top(opcode) if !interesting(opcode) => continue,
                Step::InChunk(opcode, _) if !belongs_in_chunk(opcode) => continue,
                Step::Top(opcode) => (opcode, self.record.as_slice()),
                Step::InChunk(opcode, range) => (opcode, self.chunk.get(range).unwrap_or(&[])),
            };
            let place = (self.chunk_at.map(|_| self.chunk_offset), self.at);
            let place = || match place {
                (Some(chunk), _) => format!("in the chunk at byte {chunk}"),
                (None, at) => format!("before byte {at}"),
            };
            if !self.declared.add(opcode, content) {
                return Err(BadInput::new(format!(
                    "{}: found more than {} MiB of schemas and channels; expected a recording",
                    place(),
                    MAX_DECLARED >> 20
                )));
            }
            return item(opcode, content).map(Some).ok_or_else(|| {
                BadInput::new(format!(
                    "{}: found a record of type {opcode} that is too short for its fields; expected all of them",
                    place()
                ))
            });
        }
    }

    fn step(&mut self) -> Result<Option<Step>, BadInput> {
        loop {
            if let Some(at) = self.chunk_at {
                if let Some(found) = self.step_in_chunk(at)? {
                    return Ok(Some(found));
                }
                continue;
            }
            if self.ended {
                return Ok(None);
            }
            let Some((opcode, len)) = self.prefix()? else { continue };
            match opcode {
                op::DATA_END | op::FOOTER => {
                    self.ended = true;
                    self.cut = !self.has_end;
                }
                op::CHUNK => self.load_chunk(len)?,
                op::ATTACHMENT if !self.attachments => self.skip(len)?,
                _ if interesting(opcode) => {
                    if self.load(len)? {
                        return Ok(Some(Step::Top(opcode)));
                    }
                    self.stop_cut();
                }
                _ => self.skip(len)?,
            }
        }
    }

    fn stop_cut(&mut self) {
        self.ended = true;
        self.cut = true;
    }

    /// Opcode and length of the next record outside chunks; `None` if the file stops here.
    fn prefix(&mut self) -> Result<Option<(u8, u64)>, BadInput> {
        let offset = self.at;
        if self.len.saturating_sub(offset) < PREFIX as u64 {
            self.stop_cut();
            return Ok(None);
        }
        let mut prefix = [0; PREFIX];
        self.file.read_exact(&mut prefix).map_err(|e| self.unreadable(&e))?;
        self.at += PREFIX as u64;
        let mut f = Fields::new(&prefix);
        let Some((opcode, len)) = f.opcode_and_len() else { return Ok(None) };
        if opcode == 0 {
            // Not a record. A file system that lost power leaves zeros where data were to come.
            let mut rest = Vec::new();
            let read = (&mut self.file).take(1 << 20).read_to_end(&mut rest);
            read.map_err(|e| self.unreadable(&e))?;
            // Where the next record begins nobody can tell.
            self.stop_cut();
            if len == 0 && rest.iter().all(|&b| b == 0) {
                return Ok(None);
            }
            return Err(BadInput::new(format!("at byte {offset}: found record type 0; expected an MCAP record")));
        }
        Ok(Some((opcode, len)))
    }

    fn unreadable(&self, e: &std::io::Error) -> BadInput {
        BadInput::new(format!("at byte {}: cannot be read: {e}", self.at))
    }

    /// Loads a record's content into `record`; `false` if the file ends before it does.
    fn load(&mut self, len: u64) -> Result<bool, BadInput> {
        if len > MAX_RECORD && len <= self.len.saturating_sub(self.at) {
            let at = self.at;
            self.skip(len)?;
            return Err(BadInput::new(format!(
                "at byte {at}: found a record of {len} bytes; expected at most {MAX_RECORD}"
            )));
        }
        self.record.clear();
        // Memory grows with what the file holds, not with what it claims.
        let read = (&mut self.file).take(len.min(MAX_RECORD)).read_to_end(&mut self.record);
        let n = read.map_err(|e| self.unreadable(&e))? as u64;
        self.at += n;
        Ok(n == len)
    }

    fn skip(&mut self, len: u64) -> Result<(), BadInput> {
        if len > self.len.saturating_sub(self.at) {
            self.stop_cut();
            return Ok(());
        }
        self.at += len;
        let len = i64::try_from(len).map_err(|_| BadInput::new("found a record longer than any file"))?;
        self.file.seek_relative(len).map_err(|e| self.unreadable(&e))
    }

    fn load_chunk(&mut self, len: u64) -> Result<(), BadInput> {
        self.chunk_offset = self.at - PREFIX as u64;
        let whole = self.load(len)?;
        let Some((header, data)) = ChunkHeader::split(&self.record) else {
            if whole || self.record.len() > ChunkHeader::MOST {
                return Err(self.bad_chunk("has a damaged header"));
            }
            self.stop_cut();
            return Ok(());
        };
        match self.unpacker.unpack(&header, data, &mut self.chunk) {
            Err(reason) => return Err(self.bad_chunk(&reason)),
            Ok(Unpacked::Partly(reason)) if whole => return Err(self.bad_chunk(&reason)),
            // Of a chunk that is cut off, what decompresses is good.
            Ok(Unpacked::Partly(_) | Unpacked::Whole) => {}
        }
        self.chunk_cut = !whole;
        self.chunk_at = Some(0);
        Ok(())
    }

    fn bad_chunk(&self, reason: &str) -> BadInput {
        BadInput::new(format!("the chunk at byte {} {reason}; expected an undamaged chunk", self.chunk_offset))
    }

    fn step_in_chunk(&mut self, at: usize) -> Result<Option<Step>, BadInput> {
        let rest = self.chunk.get(at..).unwrap_or(&[]);
        let mut f = Fields::new(rest);
        if let Some((opcode, len)) = f.opcode_and_len()
            && len <= f.rest.len() as u64
        {
            let start = at + PREFIX;
            let end = start + len as usize;
            self.chunk_at = Some(end);
            return Ok(Some(Step::InChunk(opcode, start..end)));
        }
        self.chunk_at = None;
        if self.chunk_cut {
            self.stop_cut();
        } else if !rest.is_empty() {
            return Err(self.bad_chunk("ends in the middle of a record"));
        }
        Ok(None)
    }
}

fn interesting(opcode: u8) -> bool {
    matches!(opcode, op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::ATTACHMENT | op::METADATA)
}

/// Messages and what they need to be understood; a chunk holds nothing else.
fn belongs_in_chunk(opcode: u8) -> bool {
    matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE)
}

/// How much a file has declared so far; what it says again counts once.
#[derive(Debug, Default)]
struct Declared {
    sizes: BTreeMap<(u8, u16), usize>,
    total: usize,
}

impl Declared {
    /// Takes note of a schema or channel record; `false` if it is too much.
    fn add(&mut self, opcode: u8, content: &[u8]) -> bool {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL) {
            return true;
        }
        let Some(id) = Fields::new(content).u16() else { return true };
        let before = self.sizes.insert((opcode, id), content.len()).unwrap_or(0);
        self.total = (self.total - before).saturating_add(content.len());
        self.total <= MAX_DECLARED
    }
}

fn item(opcode: u8, content: &[u8]) -> Option<Item<'_>> {
    Some(match opcode {
        op::HEADER => Item::Header(content),
        op::SCHEMA => Item::Schema(content),
        op::CHANNEL => Item::Channel(content),
        op::ATTACHMENT => Item::Attachment(content),
        op::METADATA => Item::Metadata(content),
        _ => {
            let (head, data) = content.split_at_checked(MESSAGE_HEADER)?;
            let mut f = Fields::new(head);
            let at = MessageAt { channel: f.u16()?, sequence: f.u32()?, log_time: f.u64()?, publish_time: f.u64()? };
            Item::Message(at, data)
        }
    })
}
