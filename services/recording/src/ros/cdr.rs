//! CDR (XCDR1), the encoding of ROS 2 messages: a 4-byte header naming the byte order, then the fields, each
//! number aligned to its size, counted from the end of that header.
//!
//! All messages of a channel have the same layout, so writing is copying a [`Template`] and overwriting its
//! numbers: no allocation, no walk over field names.

use super::definition::{Primitive, Scalar};

const CDR_LE: [u8; 4] = [0, 1, 0, 0];
const STAMP_AT: usize = 4;

/// Encodes one message field by field, little-endian.
#[derive(Debug)]
pub struct Builder {
    bytes: Vec<u8>,
    slots: Vec<usize>,
}

impl Builder {
    /// A message that begins with a `std_msgs/Header` with an empty frame; the stamp is filled in later.
    pub fn stamped() -> Self {
        let mut new = Self { bytes: CDR_LE.to_vec(), slots: Vec::new() };
        new.bytes.extend_from_slice(&[0; 8]);
        new.string("");
        new
    }

    fn align(&mut self, to: usize) {
        while !(self.bytes.len() - CDR_LE.len()).is_multiple_of(to) {
            self.bytes.push(0);
        }
    }

    fn u32(&mut self, v: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&v.to_le_bytes());
    }

    fn string(&mut self, s: &str) {
        self.u32(s.len() as u32 + 1);
        self.bytes.extend_from_slice(s.as_bytes());
        self.bytes.push(0);
    }

    /// `string`.
    #[must_use]
    pub fn text(mut self, text: &str) -> Self {
        self.string(text);
        self
    }

    /// `string[]`.
    #[must_use]
    pub fn strings(mut self, list: &[String]) -> Self {
        self.u32(list.len() as u32);
        for s in list {
            self.string(s);
        }
        self
    }

    /// `float64[]` of `n` numbers to be filled in.
    #[must_use]
    pub fn numbers(mut self, n: usize) -> Self {
        self.u32(n as u32);
        if n > 0 {
            self.align(8);
            self.slots.push(self.bytes.len());
            self.bytes.resize(self.bytes.len() + 8 * n, 0);
        }
        self
    }

    /// A number of `size` bytes to be filled in.
    #[must_use]
    pub fn scalar(mut self, size: usize) -> Self {
        self.align(size);
        self.slots.push(self.bytes.len());
        self.bytes.resize(self.bytes.len() + size, 0);
        self
    }

    /// `uint32[]` of `n` numbers to be filled in.
    #[must_use]
    pub fn words(mut self, n: usize) -> Self {
        self.u32(n as u32);
        self.slots.push(self.bytes.len());
        self.bytes.resize(self.bytes.len() + 4 * n, 0);
        self
    }

    /// `uint8[]` or `bool[]` of `n` values to be filled in.
    #[must_use]
    pub fn octets(mut self, n: usize) -> Self {
        self.u32(n as u32);
        self.slots.push(self.bytes.len());
        self.bytes.resize(self.bytes.len() + n, 0);
        self
    }

    /// The finished layout.
    pub fn template(self) -> Template {
        Template { bytes: self.bytes, slots: self.slots }
    }
}

/// A message layout with slots for its numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Template {
    bytes: Vec<u8>,
    slots: Vec<usize>,
}

impl Template {
    /// Appends the message with this stamp [ns] to `out`; the returned filler overwrites its numbers.
    pub fn append<'a>(&'a self, out: &'a mut Vec<u8>, stamp_ns: i64) -> Filler<'a> {
        let start = out.len();
        out.extend_from_slice(&self.bytes);
        let mut filler = Filler { message: out.get_mut(start..).unwrap_or(&mut []), slots: &self.slots };
        let (seconds, nanos) = split_stamp(stamp_ns);
        filler.put(STAMP_AT, &seconds.to_le_bytes());
        filler.put(STAMP_AT + 4, &nanos.to_le_bytes());
        filler
    }

    /// Bytes of one message.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }
}

/// Fills the slots of one message, in the order in which the [`Builder`] made them.
#[derive(Debug)]
pub struct Filler<'a> {
    message: &'a mut [u8],
    slots: &'a [usize],
}

impl Filler<'_> {
    fn put(&mut self, at: usize, bytes: &[u8]) {
        // Slots lie within the template by construction.
        if let Some(slot) = self.message.get_mut(at..at + bytes.len()) {
            slot.copy_from_slice(bytes);
        }
    }

    /// The next slot takes these bytes (little-endian numbers).
    #[must_use]
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        if let [at, rest @ ..] = self.slots {
            self.put(*at, bytes);
            self.slots = rest;
        }
        self
    }

    /// The next slot, a `float64[]`, takes these numbers.
    #[must_use]
    pub fn numbers(mut self, values: &[f64]) -> Self {
        if let [at, rest @ ..] = self.slots {
            let slot = self.message.get_mut(*at..at + 8 * values.len()).unwrap_or(&mut []);
            for (to, v) in slot.chunks_exact_mut(8).zip(values) {
                to.copy_from_slice(&v.to_le_bytes());
            }
            self.slots = rest;
        }
        self
    }

    /// Ends the filling; says that nothing more follows.
    pub fn done(self) {
        debug_assert!(self.slots.is_empty(), "a slot was left empty");
    }
}

/// Seconds and nanoseconds of a stamp, as `builtin_interfaces/Time` holds them. Seconds beyond 32 bits
/// saturate; the readers refuse such stamps before they get here.
pub fn split_stamp(ns: i64) -> (i32, u32) {
    let seconds = ns.div_euclid(1_000_000_000).clamp(i64::from(i32::MIN), i64::from(i32::MAX));
    (seconds as i32, ns.rem_euclid(1_000_000_000) as u32)
}

/// Reads a CDR message of either byte order. Every read is `None` past the end or for a length that does not
/// fit the message.
#[derive(Debug, Clone)]
pub struct Cursor<'a> {
    /// The message after its 4-byte header.
    body: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Cursor<'a> {
    /// Starts at the message's first field; `None` if it is not plain CDR.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        let (header, body) = message.split_first_chunk::<4>()?;
        let little = match header {
            [0, 0, _, _] => false,
            [0, 1, _, _] => true,
            _ => return None,
        };
        Some(Self { body, at: 0, little })
    }

    fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let taken = self.body.get(self.at..self.at.checked_add(n)?)?;
        self.at += n;
        Some(taken)
    }

    fn align(&mut self, to: usize) {
        self.at = self.at.next_multiple_of(to);
    }

    /// `uint8` or `bool`.
    pub fn u8(&mut self) -> Option<u8> {
        self.take(1).map(|b| b[0])
    }

    /// `uint32`.
    pub fn u32(&mut self) -> Option<u32> {
        self.align(4);
        let bytes = self.take(4)?.try_into().ok()?;
        Some(if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    /// `float64`.
    pub fn f64(&mut self) -> Option<f64> {
        self.align(8);
        let bytes = self.take(8)?.try_into().ok()?;
        Some(if self.little { f64::from_le_bytes(bytes) } else { f64::from_be_bytes(bytes) })
    }

    /// `std_msgs/Header`: the stamp [ns].
    pub fn header(&mut self) -> Option<i64> {
        let seconds = self.u32()? as i32;
        let nanos = self.u32()?;
        self.string()?;
        Some(i64::from(seconds) * 1_000_000_000 + i64::from(nanos))
    }

    /// `string`, without its final NUL.
    pub fn string(&mut self) -> Option<&'a [u8]> {
        let len = self.u32()? as usize;
        let bytes = self.take(len)?;
        Some(bytes.strip_suffix(&[0]).unwrap_or(bytes))
    }

    /// `string[]`: the bytes it occupies, to be compared or split later with [`Cursor::strings_of`].
    pub fn strings(&mut self) -> Option<&'a [u8]> {
        // The count is aligned to 4, so the bytes can be walked again from an aligned start.
        self.align(4);
        let start = self.at;
        let count = self.u32()?;
        for _ in 0..count {
            self.string()?;
        }
        self.body.get(start..self.at)
    }

    /// The strings in what [`Cursor::strings`] returned; text that is not UTF-8 is shown with replacements.
    pub fn strings_of(&self, bytes: &[u8]) -> Vec<String> {
        let mut inner = Cursor { body: bytes, at: 0, little: self.little };
        let count = inner.u32().unwrap_or(0);
        // Not Vec::with_capacity(count): the count is the sender's word. The walk ends with the bytes.
        (0..count).map_while(|_| inner.string()).map(|s| String::from_utf8_lossy(s).into_owned()).collect()
    }

    /// A number or string of any type.
    pub fn scalar(&mut self, primitive: Primitive) -> Option<Scalar> {
        Some(match primitive {
            Primitive::Bool => Scalar::Bool(self.u8()? != 0),
            Primitive::U8 => Scalar::UInt(u64::from(self.u8()?)),
            Primitive::I8 => Scalar::Int(i64::from(self.u8()? as i8)),
            Primitive::U16 => Scalar::UInt(u64::from(u16::from_le_bytes(self.bytes()?))),
            Primitive::I16 => Scalar::Int(i64::from(i16::from_le_bytes(self.bytes()?))),
            Primitive::U32 => Scalar::UInt(u64::from(u32::from_le_bytes(self.bytes()?))),
            Primitive::I32 => Scalar::Int(i64::from(i32::from_le_bytes(self.bytes()?))),
            Primitive::U64 => Scalar::UInt(u64::from_le_bytes(self.bytes()?)),
            Primitive::I64 => Scalar::Int(i64::from_le_bytes(self.bytes()?)),
            Primitive::F32 => Scalar::Float(f64::from(f32::from_le_bytes(self.bytes()?))),
            Primitive::F64 => Scalar::Float(f64::from_le_bytes(self.bytes()?)),
            Primitive::Text => {
                let text = self.string()?;
                let end = self.at - usize::from(self.at > 0 && self.body.get(self.at - 1) == Some(&0));
                Scalar::Text { start: end.checked_sub(text.len())?, end }
            }
        })
    }

    /// The next `N` bytes, aligned to their number, in little-endian order.
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.align(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().ok()?;
        if !self.little {
            bytes.reverse();
        }
        Some(bytes)
    }

    /// `float64[]`.
    pub fn numbers(&mut self) -> Option<Numbers<'a>> {
        let count = self.u32()? as usize;
        if count > 0 {
            self.align(8);
        }
        let bytes = self.take(count.checked_mul(8)?)?;
        Some(Numbers { bytes, little: self.little })
    }
}

/// A `float64[]` inside a message.
#[derive(Debug, Clone, Copy)]
pub struct Numbers<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl Numbers<'_> {
    /// How many numbers.
    pub fn len(&self) -> usize {
        self.bytes.len() / 8
    }

    /// True if there is none.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Number `i`.
    pub fn get(&self, i: usize) -> Option<f64> {
        let at = i.checked_mul(8)?;
        let bytes = self.bytes.get(at..at.checked_add(8)?)?.try_into().ok()?;
        Some(if self.little { f64::from_le_bytes(bytes) } else { f64::from_be_bytes(bytes) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A JointState with names "a", "bc", positions 1, 2 and effort 3, written out by hand from the CDR rules.
    fn by_hand() -> Vec<u8> {
        let mut m = vec![0, 1, 0, 0];
        m.extend([5, 0, 0, 0, 7, 0, 0, 0]); // stamp 5 s 7 ns
        m.extend([1, 0, 0, 0, 0]); // frame_id: length 1, NUL
        m.extend([0, 0, 0]); // to 16
        m.extend([2, 0, 0, 0]); // two names
        m.extend([2, 0, 0, 0, b'a', 0]); // at 20
        m.extend([0, 0]); // to 28
        m.extend([3, 0, 0, 0, b'b', b'c', 0]);
        m.extend([0]); // to 36
        m.extend([2, 0, 0, 0]); // two positions, 40: aligned to 8 as it is
        m.extend(1.0_f64.to_le_bytes());
        m.extend(2.0_f64.to_le_bytes());
        m.extend([0, 0, 0, 0]); // no velocity, at 56: an empty list needs no alignment to 8
        m.extend([1, 0, 0, 0]); // one effort, at 60, its number at 64
        m.extend(3.0_f64.to_le_bytes());
        m
    }

    #[test]
    fn a_template_writes_what_the_rules_say() {
        let names = ["a".to_owned(), "bc".to_owned()];
        let template = Builder::stamped().strings(&names).numbers(2).numbers(0).numbers(1).template();
        let mut out = vec![9];
        template.append(&mut out, 5_000_000_007).numbers(&[1.0, 2.0]).numbers(&[3.0]).done();
        assert_eq!(out[1..], by_hand());
        assert_eq!(template.size(), by_hand().len());
    }

    #[test]
    fn a_cursor_reads_what_the_rules_say() {
        let message = by_hand();
        let mut c = Cursor::new(&message).unwrap();
        assert_eq!(c.header(), Some(5_000_000_007));
        let names = c.strings().unwrap();
        assert_eq!(c.strings_of(names), ["a", "bc"]);
        let position = c.numbers().unwrap();
        assert_eq!((position.len(), position.get(1), position.get(2)), (2, Some(2.0), None));
        assert!(c.numbers().unwrap().is_empty());
        assert_eq!(c.numbers().unwrap().get(0), Some(3.0));
        assert!(c.u8().is_none());
    }

    #[test]
    fn big_endian_is_read_too() {
        let mut m = vec![0, 0, 0, 0]; // encapsulation: big-endian
        m.extend([0, 0, 0, 5, 0, 0, 0, 7]);
        m.extend([0, 0, 0, 1, 0, 0, 0, 0]); // frame_id and padding to 16
        m.extend([0, 0, 0, 1, 0, 0, 0, 0]); // one number, padding to 24
        m.extend(2.5_f64.to_be_bytes());
        let mut c = Cursor::new(&m).unwrap();
        assert_eq!(c.header(), Some(5_000_000_007));
        assert_eq!(c.numbers().unwrap().get(0), Some(2.5));
    }

    #[test]
    fn stamps_before_zero_floor() {
        assert_eq!(split_stamp(-1), (-1, 999_999_999));
        assert_eq!(split_stamp(i64::MAX), (i32::MAX, 854_775_807));
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_cursor_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Some(mut c) = Cursor::new(&bytes) {
                let _ = c.header();
                if let Some(names) = c.strings() { let _ = c.strings_of(names); }
                let _ = c.numbers();
                let _ = c.numbers().map(|n| n.get(usize::MAX));
                let _ = c.u8();
            }
        }
    }
}
