//! Text in lines, lines in fields; both within bounds.

use lacuna_interfaces::BadInput;
use std::io::Read;

/// Longest line that is read [bytes]: an unbroken line must not fill the memory.
const MAX_LINE: usize = 1 << 20;

/// A field without padding and quotes.
pub(crate) fn bare(field: &[u8]) -> &[u8] {
    let trimmed = field.trim_ascii();
    match trimmed {
        [b'"', inner @ .., b'"'] => inner.trim_ascii(),
        _ => trimmed,
    }
}

pub(crate) fn parse_number(field: &[u8]) -> Option<f64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

/// A row's bytes, cut into fields.
#[derive(Debug, Default)]
pub(crate) struct Row {
    bytes: Vec<u8>,
    /// Where each field ends.
    ends: Vec<usize>,
    /// Chosen at the header.
    delimiter: Option<u8>,
}

impl Row {
    /// Reads the next row that is not blank; `false` at the end.
    pub(crate) fn read<R: Read>(&mut self, lines: &mut Lines<R>) -> Result<bool, BadInput> {
        let line = lines.line + 1;
        let read = lines.next_line().map_err(|e| BadInput::new(format!("cannot be read: {e}")).at_line(line))?;
        let Some(line) = read else { return Ok(false) };
        self.bytes.clear();
        self.bytes.extend_from_slice(line);
        // Below a header without commas a comma is a decimal one; with a point beside it, it is neither.
        if self.delimiter.is_some_and(|d| d != b',') && memchr::memchr(b'.', line).is_none() {
            self.bytes.iter_mut().filter(|b| **b == b',').for_each(|b| *b = b'.');
        }
        let delimiter = *self.delimiter.get_or_insert_with(|| {
            let choices = [b',', b';', b'\t'];
            choices.into_iter().find(|b| line.contains(b)).unwrap_or(b',')
        });
        self.ends.clear();
        self.ends.extend(memchr::memchr_iter(delimiter, line));
        self.ends.push(line.len());
        Ok(true)
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    pub(crate) fn get(&self, i: usize) -> Option<&[u8]> {
        let end = *self.ends.get(i)?;
        let start = if i == 0 { 0 } else { self.ends.get(i - 1)? + 1 };
        self.bytes.get(start..end)
    }

    /// Whether a row without a newline, which only the last one can be, stops in mid-write: short, or ending in
    /// what is not a number.
    pub(crate) fn looks_cut(&self, width: usize) -> bool {
        let last = self.get(self.len().saturating_sub(1)).map_or(&[][..], bare);
        self.len() < width || parse_number(last).is_none()
    }

    pub(crate) fn fields(&self) -> impl Iterator<Item = &[u8]> {
        (0..self.len()).map_while(|i| self.get(i))
    }
}

/// Splits bytes into lines, within a bound.
#[derive(Debug)]
pub(crate) struct Lines<R> {
    source: R,
    buffer: Vec<u8>,
    /// What of the buffer is read and not yet handed out.
    rest: std::ops::Range<usize>,
    /// Bytes taken from the source.
    taken: u64,
    /// Number of the line handed out last.
    pub(crate) line: u64,
    /// Whether it ended with a newline.
    pub(crate) terminated: bool,
}

const BLOCK: usize = 64 << 10;

impl<R: Read> Lines<R> {
    pub(crate) fn new(source: R) -> Self {
        Self { source, buffer: vec![0; BLOCK], rest: 0..0, taken: 0, line: 0, terminated: true }
    }

    /// Bytes of the source that were handed out.
    pub(crate) fn used(&self) -> u64 {
        self.taken - self.rest.len() as u64
    }

    /// The next line that holds more than white space, without its end.
    fn next_line(&mut self) -> std::io::Result<Option<&[u8]>> {
        let found = loop {
            let Some(found) = self.any_line()? else { return Ok(None) };
            self.line += 1;
            let line = self.buffer.get(found.clone()).unwrap_or(&[]);
            let line = if self.line == 1 { line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line) } else { line };
            if !line.trim_ascii().is_empty() {
                let skipped = found.len() - line.len();
                break found.start + skipped..found.end;
            }
        };
        let line = self.buffer.get(found).unwrap_or(&[]);
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    fn any_line(&mut self) -> std::io::Result<Option<std::ops::Range<usize>>> {
        let mut searched = 0;
        loop {
            let unread = self.buffer.get(self.rest.clone()).unwrap_or(&[]);
            if let Some(at) = memchr::memchr(b'\n', unread.get(searched..).unwrap_or(&[])) {
                let start = self.rest.start;
                let end = start + searched + at;
                self.rest.start = end + 1;
                self.terminated = true;
                return Ok(Some(start..end));
            }
            searched = unread.len();
            if searched > MAX_LINE {
                return Err(std::io::Error::other(format!(
                    "found a line longer than {MAX_LINE} bytes; expected rows of numbers"
                )));
            }
            if self.refill()? == 0 {
                let last = std::mem::replace(&mut self.rest, 0..0);
                self.terminated = false;
                return Ok((!last.is_empty()).then_some(last));
            }
        }
    }

    /// Reads another block behind what is left; 0 at the end.
    fn refill(&mut self) -> std::io::Result<usize> {
        self.buffer.copy_within(self.rest.clone(), 0);
        self.rest = 0..self.rest.len();
        let room = self.rest.end + BLOCK;
        if self.buffer.len() < room {
            self.buffer.resize(room, 0);
        }
        let target = self.buffer.get_mut(self.rest.end..).unwrap_or(&mut []);
        let n = loop {
            match self.source.read(target) {
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                other => break other?,
            }
        };
        self.rest.end += n;
        self.taken += n as u64;
        Ok(n)
    }
}
