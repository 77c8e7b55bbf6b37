//! Messages of any type, decoded by the definition that stands in the recording itself (`ros2msg`).
//!
//! A definition becomes a flat list of [`Leaf`]s, nested messages resolved (`header.stamp.sec`); a message becomes one
//! list of [`Scalar`]s per leaf. Lists of nested messages and wide strings are not decoded: a topic of such a type is
//! shown by its size alone.

use super::cdr::Cursor;
use std::collections::BTreeMap;
use std::ops::Range;

/// Deepest nesting of message types.
const MAX_DEPTH: usize = 16;
/// Most leaves of one message.
const MAX_LEAVES: usize = 4096;
/// Most fields of message types, which may be nested without ever coming to a leaf.
const MAX_NESTED: usize = 4096;
/// Most definitions in one text.
const MAX_TYPES: usize = 512;
/// Most values of one message: joint signals, not pictures.
const MAX_VALUES: usize = 1 << 20;

/// Type of a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Primitive {
    /// `bool`.
    Bool,
    /// `byte`, `char`, `uint8`.
    U8,
    /// `int8`.
    I8,
    /// `uint16`.
    U16,
    /// `int16`.
    I16,
    /// `uint32`.
    U32,
    /// `int32`.
    I32,
    /// `uint64`.
    U64,
    /// `int64`.
    I64,
    /// `float32`.
    F32,
    /// `float64`.
    F64,
    /// `string`.
    Text,
}

/// How many values a leaf has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arity {
    /// One.
    One,
    /// A fixed number.
    Fixed(usize),
    /// As many as the message says.
    List,
}

/// A field of numbers or text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Leaf {
    /// Path in the message: `position`, `header.stamp.sec`.
    pub path: String,
    /// Type.
    pub primitive: Primitive,
    /// How many values.
    pub arity: Arity,
}

/// The fields of a message type, in the order in which they are encoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    leaves: Vec<Leaf>,
    stamped: bool,
}

/// A decoded value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scalar {
    /// `bool`.
    Bool(bool),
    /// Any signed integer.
    Int(i64),
    /// Any unsigned integer.
    UInt(u64),
    /// Any floating-point number.
    Float(f64),
    /// Where a string lies in the message's body, without its final NUL.
    Text {
        /// First byte.
        start: usize,
        /// One past the last.
        end: usize,
    },
}

impl Scalar {
    /// As a number; booleans are 0 and 1, text has none. Integers beyond 2^53 are rounded.
    pub fn number(self) -> Option<f64> {
        match self {
            Self::Bool(b) => Some(f64::from(u8::from(b))),
            Self::Int(i) => Some(i as f64),
            Self::UInt(u) => Some(u as f64),
            Self::Float(v) => Some(v),
            Self::Text { .. } => None,
        }
    }
}

/// Buffers of decoded messages, kept from message to message.
#[derive(Debug, Clone, Default)]
pub struct Decoded {
    values: Vec<Scalar>,
    spans: Vec<Range<usize>>,
}

impl Decoded {
    /// The values of leaf `index`; empty for an empty list or no such leaf.
    pub fn of(&self, index: usize) -> &[Scalar] {
        self.spans.get(index).and_then(|span| self.values.get(span.clone())).unwrap_or(&[])
    }
}

/// The text that a [`Scalar::Text`] stands for; what is not UTF-8 is shown with replacements.
pub fn text_of(message: &[u8], scalar: Scalar) -> Option<String> {
    let Scalar::Text { start, end } = scalar else { return None };
    let body = message.get(4..)?;
    Some(String::from_utf8_lossy(body.get(start..end)?).into_owned())
}

impl Layout {
    /// Reads a definition with those of all types it is made of; `None` if it cannot be decoded field by field.
    pub fn parse(definition: &str) -> Option<Self> {
        let types = Types::split(definition)?;
        let mut leaves = Vec::new();
        types.flatten(Part { text: types.root, package: "", prefix: "", depth: 0 }, &mut leaves, &mut 0)?;
        let is = |at: usize, path: &str| leaves.get(at).is_some_and(|l: &Leaf| l.path == path);
        let stamped = is(0, "header.stamp.sec") && is(1, "header.stamp.nanosec");
        Some(Self { leaves, stamped })
    }

    /// The leaves in order.
    pub fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// Index of the leaf at `path`.
    pub fn find(&self, path: &str) -> Option<usize> {
        self.leaves.iter().position(|l| l.path == path)
    }

    /// True if the message begins with a `std_msgs/Header`.
    pub fn is_stamped(&self) -> bool {
        self.stamped
    }

    /// Decodes a message into `out`, which is overwritten; `None` if the message does not fit the definition, or has more
    /// than a million values.
    pub fn decode(&self, message: &[u8], out: &mut Decoded) -> Option<()> {
        out.values.clear();
        out.spans.clear();
        let mut cursor = Cursor::new(message)?;
        for leaf in &self.leaves {
            let start = out.values.len();
            let count = match leaf.arity {
                Arity::One => 1,
                Arity::Fixed(n) => n,
                Arity::List => cursor.u32()? as usize,
            };
            // Not reserved: the count is the sender's word. The walk ends with the bytes.
            for _ in 0..count {
                if out.values.len() >= MAX_VALUES {
                    return None;
                }
                out.values.push(cursor.scalar(leaf.primitive)?);
            }
            out.spans.push(start..out.values.len());
        }
        Some(())
    }
}

/// A definition on its place in the message.
struct Part<'a> {
    text: &'a str,
    package: &'a str,
    prefix: &'a str,
    depth: usize,
}

/// The definitions of one text by their name, `package/Type`.
struct Types<'a> {
    root: &'a str,
    named: BTreeMap<String, &'a str>,
}

impl<'a> Types<'a> {
    /// Parts are set apart by lines of `=`, each followed by `MSG: package/Type`.
    fn split(text: &'a str) -> Option<Self> {
        let mut found = Self { root: "", named: BTreeMap::new() };
        let mut name: Option<String> = None;
        let (mut start, mut at) = (0, 0);
        let close = |name: &mut Option<String>, part: &'a str, found: &mut Self| {
            match name.take() {
                Some(name) => {
                    found.named.insert(name, part);
                }
                None => found.root = part,
            }
            (found.named.len() <= MAX_TYPES).then_some(())
        };
        for line in text.split_inclusive('\n') {
            let bare = line.trim();
            if bare.len() >= 3 && bare.bytes().all(|b| b == b'=') {
                close(&mut name, text.get(start..at)?, &mut found)?;
                // Until its MSG line comes it is nobody's; a part without one is dropped.
                name = Some(String::new());
                start = at + line.len();
            } else if let Some(title) = bare.strip_prefix("MSG:")
                && name.as_deref() == Some("")
            {
                name = Some(normal(title.trim()));
                start = at + line.len();
            }
            at += line.len();
        }
        close(&mut name, text.get(start..)?, &mut found)?;
        Some(found)
    }

    /// The definition of `kind` as a type of `package` names it.
    fn resolve(&self, kind: &str, package: &str) -> Option<(String, &'a str)> {
        let kind = normal(kind);
        let full = if kind.contains('/') {
            kind
        } else {
            let own = format!("{package}/{kind}");
            let ending = format!("/{kind}");
            // The root's package is not in the text: a type without one is then the only one of its name.
            if self.named.contains_key(&own) { own } else { self.named.keys().find(|k| k.ends_with(&ending))?.clone() }
        };
        let text = self.named.get(&full)?;
        Some((full, text))
    }

    fn flatten(&self, part: Part<'_>, out: &mut Vec<Leaf>, nested: &mut usize) -> Option<()> {
        let Part { text, package, prefix, depth } = part;
        if depth > MAX_DEPTH || *nested > MAX_NESTED {
            return None;
        }
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or("").trim();
            let Some((kind, rest)) = line.split_once(char::is_whitespace) else {
                if line.is_empty() {
                    continue;
                }
                return None;
            };
            let rest = rest.trim_start();
            let name: &str = rest.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).next().unwrap_or("");
            if name.is_empty() {
                return None;
            }
            if rest.get(name.len()..).is_some_and(|after| after.trim_start().starts_with('=')) {
                continue; // a constant: not in the message
            }
            let path = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
            let (kind, arity) = arity_of(kind)?;
            if let Some(primitive) = primitive_of(kind) {
                if out.len() >= MAX_LEAVES {
                    return None;
                }
                out.push(Leaf { path, primitive, arity });
            } else if arity == Arity::One {
                let (full, text) = self.resolve(kind, package)?;
                let package = full.split_once('/').map_or("", |(p, _)| p);
                *nested += 1;
                self.flatten(Part { text, package, prefix: &path, depth: depth + 1 }, out, nested)?;
            } else {
                return None;
            }
        }
        Some(())
    }
}

/// `package/msg/Type` and `package/Type` are the same.
fn normal(name: &str) -> String {
    name.replace("/msg/", "/")
}

/// `float64[<=5]` is a list of `float64`; `string<=10` is a `string`.
fn arity_of(kind: &str) -> Option<(&str, Arity)> {
    let (kind, arity) = match kind.split_once('[') {
        None => (kind, Arity::One),
        Some((kind, rest)) => match rest.strip_suffix(']')? {
            "" => (kind, Arity::List),
            bound if bound.starts_with("<=") => (kind, Arity::List),
            n => (kind, Arity::Fixed(n.parse().ok()?)),
        },
    };
    Some((kind.split_once("<=").map_or(kind, |(kind, _)| kind), arity))
}

fn primitive_of(kind: &str) -> Option<Primitive> {
    Some(match kind {
        "bool" => Primitive::Bool,
        "byte" | "char" | "uint8" => Primitive::U8,
        "int8" => Primitive::I8,
        "uint16" => Primitive::U16,
        "int16" => Primitive::I16,
        "uint32" => Primitive::U32,
        "int32" => Primitive::I32,
        "uint64" => Primitive::U64,
        "int64" => Primitive::I64,
        "float32" => Primitive::F32,
        "float64" => Primitive::F64,
        "string" => Primitive::Text,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::cdr::Builder;
    use super::super::schema;
    use super::*;
    use proptest::prelude::*;

    fn paths(layout: &Layout) -> Vec<&str> {
        layout.leaves().iter().map(|l| l.path.as_str()).collect()
    }

    #[test]
    fn a_definition_becomes_leaves_in_the_order_of_the_message() {
        let layout = Layout::parse(&schema::JOINT_STATE.definition()).unwrap();
        assert!(layout.is_stamped());
        let expected =
            ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "name", "position", "velocity", "effort"];
        assert_eq!(paths(&layout), expected);
        let watch = Layout::parse(&schema::RESIDUAL_WATCH.definition()).unwrap();
        assert!(watch.find("TIME").is_none(), "a constant is not in the message");
        assert_eq!(watch.find("name"), Some(3));
    }

    #[test]
    fn forms_of_the_ros_interface_language_are_read() {
        let text = "# a comment\nint32 X=-123\nstring FOO = \"a#b\"\nfloat64[3] c 0.0 # fixed\nint8[<=4] few\n\
                    string<=10 label \"x = y\"\nPose pose\nbool[] on\n===\nMSG: geometry_msgs/msg/Pose\nPoint p\n\
                    ===\nMSG: geometry_msgs/Point\nfloat32 x\nfloat32 y\n";
        let layout = Layout::parse(text).unwrap();
        assert_eq!(paths(&layout), ["c", "few", "label", "pose.p.x", "pose.p.y", "on"]);
        let arities: Vec<Arity> = layout.leaves().iter().map(|l| l.arity).collect();
        assert_eq!(arities, [Arity::Fixed(3), Arity::List, Arity::One, Arity::One, Arity::One, Arity::List]);
        // By hand from the CDR rules: three f64, two i8, a string at 32, two f32 at 40, one bool.
        let mut m = vec![0, 1, 0, 0];
        [1.0_f64, -2.0, 3.5].iter().for_each(|v| m.extend(v.to_le_bytes()));
        m.extend([2, 0, 0, 0, 0xff, 5, 0, 0]);
        m.extend([3, 0, 0, 0, b'h', b'i', 0, 0]);
        [0.5_f32, -0.25].iter().for_each(|v| m.extend(v.to_le_bytes()));
        m.extend([1, 0, 0, 0, 1]);
        let mut decoded = Decoded::default();
        layout.decode(&m, &mut decoded).unwrap();
        assert_eq!(decoded.of(0), [Scalar::Float(1.0), Scalar::Float(-2.0), Scalar::Float(3.5)]);
        assert_eq!(decoded.of(1), [Scalar::Int(-1), Scalar::Int(5)]);
        assert_eq!(text_of(&m, decoded.of(2)[0]).as_deref(), Some("hi"));
        assert_eq!((decoded.of(3), decoded.of(4)), (&[Scalar::Float(0.5)][..], &[Scalar::Float(-0.25)][..]));
        assert_eq!(decoded.of(5), [Scalar::Bool(true)]);
        assert!(decoded.of(6).is_empty());
        assert!(layout.decode(&m[..m.len() - 1], &mut decoded).is_none(), "a cut message is none");
    }

    #[test]
    fn what_cannot_be_decoded_field_by_field_is_refused() {
        for text in ["Other o\n", "pkg/T[] list\n===\nMSG: pkg/T\nbool b\n", "wstring w\n", "float64\n", "int32[x] a\n"]
        {
            assert!(Layout::parse(text).is_none(), "{text}");
        }
        let endless = "pkg/A a\n===\nMSG: pkg/A\npkg/A a\n";
        assert!(Layout::parse(endless).is_none());
        // Ten of each type in the next, and nothing in the last: 10^15 fields without a leaf.
        let mut hollow = "p/T0 a\n".to_owned();
        for k in 0..15 {
            hollow += &format!("===\nMSG: p/T{k}\n");
            (0..10).for_each(|f| hollow += &format!("p/T{} f{f}\n", k + 1));
        }
        assert!(Layout::parse(&(hollow + "===\nMSG: p/T15\n")).is_none());
    }

    #[test]
    fn a_template_is_read_back() {
        let names = ["a".to_owned(), "bc".to_owned()];
        let template = Builder::stamped().strings(&names).numbers(2).numbers(0).numbers(2).template();
        let mut message = Vec::new();
        template.append(&mut message, 5_000_000_007).numbers(&[1.0, 2.0]).numbers(&[3.0, f64::NAN]).done();
        let layout = Layout::parse(&schema::JOINT_STATE.definition()).unwrap();
        let mut decoded = Decoded::default();
        layout.decode(&message, &mut decoded).unwrap();
        assert_eq!((decoded.of(0), decoded.of(1)), (&[Scalar::Int(5)][..], &[Scalar::UInt(7)][..]));
        let read: Vec<_> = decoded.of(3).iter().map(|s| text_of(&message, *s).unwrap()).collect();
        assert_eq!(read, names);
        assert_eq!(decoded.of(4), [Scalar::Float(1.0), Scalar::Float(2.0)]);
        assert!(decoded.of(5).is_empty());
    }

    proptest! {
        #[test]
        fn no_text_and_no_bytes_panic(text in "[ -~\n=]{0,200}", bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = Layout::parse(&text);
            let layout = Layout::parse(&schema::STATUS.definition()).unwrap();
            let _ = layout.decode(&bytes, &mut Decoded::default());
        }
    }
}
