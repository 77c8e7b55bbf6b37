//! What a recording holds, without knowing whose it is: the columns of a CSV, the datagrams of a capture.

use crate::ethercat::{Command, Frame};
use crate::files::open_error;
use crate::formats::packets::Packets;
use crate::formats::rows::{Lines, Row, bare};
use crate::formats::{SNIFF_BYTES, detect};
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
}

/// A CSV's columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// Column names.
    pub columns: Vec<String>,
    /// Rows below the header.
    pub rows: u64,
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

/// Surveys a file; `None` for a format that says itself what it holds (MCAP).
///
/// # Errors
/// [`BadInput`] with the file: absent, of no known format, or damaged.
pub fn survey(path: &Path) -> Result<Option<Survey>, BadInput> {
    let mut first = Vec::new();
    let file = File::open(path).map_err(|e| open_error(path, &e))?;
    file.take(SNIFF_BYTES as u64).read_to_end(&mut first).map_err(|e| open_error(path, &e))?;
    let found = match detect(path, &first)?.name {
        "csv" => Survey::Table(table(path).map_err(|e| e.in_file(path))?),
        "capture" => Survey::Bus(bus(path).map_err(|e| e.in_file(path))?),
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
    let columns = row.fields().map(|f| String::from_utf8_lossy(bare(f)).into_owned()).collect();
    let mut rows = 0;
    while row.read(&mut lines)? {
        rows += 1;
    }
    Ok(Table { columns, rows })
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
