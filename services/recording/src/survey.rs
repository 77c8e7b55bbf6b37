//! What a recording holds, without knowing whose it is: the columns of a CSV, the datagrams of a capture, the joints of a
//! bag.

use crate::ethercat::{Command, Frame};
use crate::files::open_error;
use crate::formats::packets::Packets;
use crate::formats::rows::{Lines, Row, bare, parse_number};
use crate::formats::{SNIFF_BYTES, detect};
use crate::messages::Messages;
use crate::reader::file_of;
use crate::ros::joint_state::JointState;
use crate::ros::schema;
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Datagrams that are told apart; further ones are only counted with their frames.
const MOST_DATAGRAMS: usize = 256;

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub enum Survey {
    /// A table.
    Table(Table),
    /// Fieldbus traffic.
    Bus(Bus),
    /// An MCAP file: its JointState topics.
    Bag(Vec<JointTopic>),
}

/// A JointState topic, by its first message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JointTopic {
    /// Name.
    pub name: String,
    /// Message encoding; `cdr` is what is read.
    pub encoding: String,
    /// Joint names; empty if the message cannot be decoded.
    pub joints: Vec<String>,
    /// Whether there is a position and an effort of every joint.
    pub position: bool,
    /// See `position`.
    pub effort: bool,
}

/// A CSV's columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// Columns in their order.
    pub columns: Vec<Column>,
    /// Rows below the header.
    pub rows: u64,
    /// Index of the column that looks like the time: one named so, else the first if it never falls and is not named as a
    /// position or torque.
    pub time: Option<usize>,
}

/// What one column of a table holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// As in the header.
    pub name: String,
    /// Rows with a finite number.
    pub numbers: u64,
    /// Smallest and largest of these, in the column's unit.
    pub range: Option<(f64, f64)>,
    /// Steps from number to number, in the column's unit.
    pub steps: Steps,
}

/// How a column goes on from row to row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Steps {
    last: Option<f64>,
    /// The first ones that are not zero, for their median.
    first: Vec<f64>,
    /// Longest.
    pub longest: f64,
    /// Steps back, or none.
    pub not_increasing: u64,
    /// Steps back.
    pub falling: u64,
}

/// Steps that the median is taken of.
const MOST_STEPS: usize = 10_000;
/// Columns that are looked into; further ones are only named.
const MOST_COLUMNS: usize = 256;
/// Messages among which a topic's first one is looked for.
const MOST_MESSAGES: usize = 200_000;

impl Steps {
    fn saw(&mut self, value: f64) {
        if let Some(last) = self.last.replace(value) {
            let step = value - last;
            self.longest = self.longest.max(step);
            self.falling += u64::from(step < 0.0);
            self.not_increasing += u64::from(step <= 0.0);
            if step != 0.0 && self.first.len() < MOST_STEPS {
                self.first.push(step);
            }
        }
    }

    /// Median of the first ten thousand steps that are not zero; `None` without any.
    pub fn median(&self) -> Option<f64> {
        let mut steps = self.first.clone();
        let middle = steps.len() / 2;
        (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

/// A capture's traffic.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bus {
    /// Frames of any protocol.
    pub frames: u64,
    /// EtherCAT frames.
    pub ethercat: u64,
    /// First and last stamp [ns since 1970].
    pub stamps_ns: Option<(i64, i64)>,
    /// Process data commands, by address.
    pub datagrams: Vec<BusDatagram>,
}

/// A recurring datagram.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BusDatagram {
    /// What it asks.
    pub command: Command,
    /// Logical address, or station (low half) and memory offset (high half).
    pub address: u32,
    /// Process data [bytes].
    pub bytes: usize,
    /// Copies seen, out and back.
    pub copies: u64,
    /// Copies that came back with the largest working counter.
    pub returned: u64,
    /// The largest working counter.
    pub working_counter: u16,
}

/// Surveys a file, or the MCAP file of a bag folder; `None` for a format that is not known here.
///
/// # Errors
/// [`BadInput`] with the file: absent, of no known format, or damaged.
pub fn survey(path: &Path) -> Result<Option<Survey>, BadInput> {
    let path = &file_of(path)?;
    let mut first = Vec::new();
    let file = File::open(path).map_err(|e| open_error(path, &e))?;
    file.take(SNIFF_BYTES as u64).read_to_end(&mut first).map_err(|e| open_error(path, &e))?;
    let found = match detect(path, &first)?.name {
        "csv" => Survey::Table(table(path).map_err(|e| e.in_file(path))?),
        "capture" => Survey::Bus(bus(path).map_err(|e| e.in_file(path))?),
        "mcap" => Survey::Bag(bag(path).map_err(|e| e.in_file(path))?),
        _ => return Ok(None),
    };
    Ok(Some(found))
}

fn table(path: &Path) -> Result<Table, BadInput> {
    let mut lines = Lines::new(File::open(path).map_err(|e| open_error(path, &e))?);
    let mut row = Row::default();
    if !row.read(&mut lines)? {
        return Err(BadInput::new("found an empty file; expected a header line").at_line(1));
    }
    let named = |f: &[u8]| Column {
        name: String::from_utf8_lossy(bare(f)).into_owned(),
        numbers: 0,
        range: None,
        steps: Steps::default(),
    };
    let mut columns: Vec<Column> = row.fields().map(named).collect();
    while columns.last().is_some_and(|c| c.name.is_empty()) {
        columns.pop();
    }
    let mut rows = 0;
    while row.read(&mut lines)? {
        rows += 1;
        for (column, field) in columns.iter_mut().take(MOST_COLUMNS).zip(row.fields()) {
            let Some(value) = parse_number(bare(field)).filter(|v| v.is_finite()) else { continue };
            let (low, high) = column.range.unwrap_or((value, value));
            column.numbers += 1;
            column.range = Some((low.min(value), high.max(value)));
            column.steps.saw(value);
        }
    }
    let time = columns.iter().position(|c| is_time(&c.name));
    let time = time.or_else(|| columns.first().filter(|c| never_falls(c)).map(|_| 0));
    Ok(Table { columns, rows, time })
}

fn never_falls(c: &Column) -> bool {
    c.numbers > 2 && c.steps.falling == 0 && !c.name.starts_with('q') && !c.name.starts_with("tau")
}

fn is_time(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    name == "t" || ["time", "stamp", "t_", "t ", "t["].iter().any(|start| name.starts_with(start))
}

fn bag(path: &Path) -> Result<Vec<JointTopic>, BadInput> {
    let mut messages = Messages::open(path)?;
    let mut found: BTreeMap<usize, JointTopic> = BTreeMap::new();
    let mut count = 0;
    while count < MOST_MESSAGES
        // Beyond damage nothing is looked at; the container's own summary says that there is some.
        && let Ok(Some(message)) = messages.next_message()
    {
        count += 1;
        let Some(topic) = messages.topic(message.topic).filter(|t| t.schema == schema::JOINT_STATE.name) else {
            continue;
        };
        if found.contains_key(&message.topic) {
            continue;
        }
        let state = JointState::parse(messages.data()).filter(|_| topic.encoding == "cdr");
        let joints = state.as_ref().map_or_else(Vec::new, JointState::joints);
        let of_all = |n: Option<usize>| !joints.is_empty() && n == Some(joints.len());
        let (name, encoding) = (topic.name.clone(), topic.encoding.clone());
        let position = of_all(state.as_ref().map(|s| s.position.len()));
        let effort = of_all(state.as_ref().map(|s| s.effort.len()));
        found.insert(message.topic, JointTopic { name, encoding, joints, position, effort });
    }
    Ok(found.into_values().collect())
}

fn bus(path: &Path) -> Result<Bus, BadInput> {
    let mut packets = Packets::open(path)?;
    let mut out = Bus::default();
    let mut found: BTreeMap<(u8, u32, usize), BusDatagram> = BTreeMap::new();
    while packets.next(|stamp_ns, data| {
        let (low, high) = out.stamps_ns.unwrap_or((stamp_ns, stamp_ns));
        out.stamps_ns = Some((low.min(stamp_ns), high.max(stamp_ns)));
        let cut = |_| "found a frame that ends before its own length; expected whole frames".to_owned();
        let Some(frame) = Frame::parse(data).map_err(cut)? else { return Ok(false) };
        out.ethercat += 1;
        for datagram in frame.datagrams() {
            let d = datagram.map_err(cut)?;
            let Some(code) = d.command.code() else { continue };
            let key = (code, d.address, d.data.len());
            if found.len() >= MOST_DATAGRAMS && !found.contains_key(&key) {
                continue;
            }
            let entry = found.entry(key).or_insert(BusDatagram {
                command: d.command,
                address: d.address,
                bytes: d.data.len(),
                copies: 0,
                returned: 0,
                working_counter: 0,
            });
            entry.copies += 1;
            if d.working_counter > entry.working_counter {
                (entry.working_counter, entry.returned) = (d.working_counter, 0);
            }
            entry.returned += u64::from(d.working_counter == entry.working_counter && d.working_counter > 0);
        }
        Ok(true)
    })? {}
    out.frames = packets.count;
    out.datagrams = found.into_values().collect();
    Ok(out)
}
