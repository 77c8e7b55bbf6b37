//! Captures of a fieldbus: pcap and pcapng with EtherCAT frames, as a network analyser or tcpdump writes them.
//!
//! Time stamps in micro- or nanoseconds, of pcapng in each interface's own resolution. Which bytes are which joint's
//! signals is said by `[ethercat]` of the robot file ([`lacuna_interfaces::ethercat`]); frames of other protocols are
//! passed over.

use super::{Format, Request};
use crate::condition::repair;
use crate::ethercat::{Cut, Cycles, Frame};
use crate::files::open_error;
use crate::sample::{About, RawReader, Sample};
use lacuna_interfaces::{BadInput, Repair, RepairKind, RobotFile};
use pcap_parser::traits::PcapReaderIterator;
use pcap_parser::{Block, Linktype, PcapBlockOwned, PcapError, create_reader};
use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;

/// The registry's line.
pub const FORMAT: Format =
    Format { name: "capture", extensions: &["pcap", "pcapng", "cap"], exact: false, sniff: Some(is_capture), open };

/// Bytes that are held of a capture at a time: more than any frame or description block.
const BUFFER_BYTES: usize = 1 << 20;
/// Most interfaces of a capture.
const MOST_INTERFACES: usize = 1024;

/// First bytes of pcap (either byte order, micro- or nanoseconds) and pcapng.
fn is_capture(first: &[u8]) -> bool {
    let magic: Option<[u8; 4]> = first.get(..4).and_then(|b| b.try_into().ok());
    magic.is_some_and(|m| {
        let read = [u32::from_le_bytes(m), u32::from_be_bytes(m)];
        read.iter().any(|v| [0xA1B2_C3D4, 0xA1B2_3C4D, 0x0A0D_0D0A].contains(v))
    })
}

fn open(request: &Request<'_>) -> Result<Box<dyn RawReader>, BadInput> {
    let file = File::open(request.path).map_err(|e| open_error(request.path, &e))?;
    Ok(Box::new(CaptureReader::new(file, request.robot, request.options.extra)?))
}

/// Reads a capture from any byte source.
pub(crate) struct CaptureReader {
    capture: Box<dyn PcapReaderIterator + Send>,
    clock: Clock,
    cycles: Cycles,
    about: About,
    extra: bool,
    frames: u64,
    /// Whether any EtherCAT frame was seen.
    ethercat: bool,
    bytes: u64,
    cut: bool,
    /// Further cycles that the last frame completed.
    ready: VecDeque<Sample>,
}

/// How stamps are counted.
#[derive(Debug, Default)]
struct Clock {
    /// Nanoseconds, not microseconds, in a pcap file.
    nanoseconds: bool,
    /// Per interface of a pcapng section: units per second and offset [s].
    interfaces: Vec<(u64, i64)>,
}

impl Clock {
    fn pcap_ns(&self, seconds: u32, part: u32) -> i64 {
        i64::from(seconds) * 1_000_000_000 + i64::from(part) * if self.nanoseconds { 1 } else { 1000 }
    }

    fn pcapng_ns(&self, interface: u32, ticks: u64) -> Result<i64, String> {
        let (per_second, offset_s) =
            usize::try_from(interface).ok().and_then(|i| self.interfaces.get(i)).copied().ok_or_else(|| {
                format!("found a packet of interface {interface}; expected its description before it")
            })?;
        let ns = u128::from(ticks) * 1_000_000_000 / u128::from(per_second.max(1));
        let ns = i64::try_from(ns).unwrap_or(i64::MAX);
        Ok(ns.saturating_add(offset_s.saturating_mul(1_000_000_000)))
    }
}

fn only_ethernet(link: Linktype) -> Result<(), String> {
    if link == Linktype::ETHERNET {
        return Ok(());
    }
    Err(format!("found link type {}; expected 1, Ethernet", link.0))
}

impl CaptureReader {
    pub(crate) fn new(source: impl Read + Send + 'static, robot: &RobotFile, extra: bool) -> Result<Self, BadInput> {
        let cycles = Cycles::new(robot)?;
        let capture = create_reader(BUFFER_BYTES, source)
            .map_err(|_| BadInput::new("found no header of a capture; expected pcap or pcapng"))?;
        let extra_names = if extra { cycles.extra_names() } else { Vec::new() };
        let about = About { format: FORMAT.name, extra_names, ..About::default() };
        Ok(Self {
            capture,
            clock: Clock::default(),
            cycles,
            about,
            extra,
            frames: 0,
            ethercat: false,
            bytes: 0,
            cut: false,
            ready: VecDeque::new(),
        })
    }

    fn at_frame(&self, what: impl std::fmt::Display) -> BadInput {
        BadInput::new(format!("frame {}: {what}", self.frames))
    }

    /// Reads until a block completes a cycle; `false` at the end.
    fn advance(&mut self) -> Result<bool, BadInput> {
        while self.ready.is_empty() {
            match self.capture.next() {
                Ok((used, block)) => {
                    let mut frame = Taken::default();
                    let read = take(&block, &mut self.clock, &mut frame, |stamp_ns, data| {
                        cycles_of(stamp_ns, data, &mut self.cycles, &mut self.ready)
                    });
                    self.frames += u64::from(frame.packet);
                    self.ethercat |= frame.ethercat;
                    self.capture.consume(used);
                    self.bytes += used as u64;
                    read.map_err(|what| self.at_frame(what))?;
                }
                Err(PcapError::Eof) => return Ok(false),
                Err(PcapError::UnexpectedEof) => {
                    self.cut = true;
                    return Ok(false);
                }
                Err(PcapError::Incomplete(_)) => {
                    if self.capture.reader_exhausted() {
                        self.cut = true;
                        return Ok(false);
                    }
                    let grown = self.capture.refill().map_err(|e| e.to_owned_vec());
                    grown.map_err(|e| self.at_frame(format!("cannot be read: {e}")))?;
                }
                Err(e) => {
                    let what = match e {
                        PcapError::BufferTooSmall => {
                            format!("found a block above {BUFFER_BYTES} bytes; expected a frame")
                        }
                        PcapError::ReadError => "cannot be read".to_owned(),
                        _ => "found a damaged block; expected a capture's packet".to_owned(),
                    };
                    self.frames += 1;
                    return Err(self.at_frame(what));
                }
            }
        }
        Ok(true)
    }
}

/// What a block held.
#[derive(Debug, Default)]
struct Taken {
    packet: bool,
    ethercat: bool,
}

/// Takes one block of the capture: descriptions set the clock, packets go to `frame`.
fn take(
    block: &PcapBlockOwned<'_>,
    clock: &mut Clock,
    taken: &mut Taken,
    mut frame: impl FnMut(i64, &[u8]) -> Result<bool, String>,
) -> Result<(), String> {
    let whole = |captured: u32, original: u32| {
        if captured < original {
            return Err(format!(
                "found {captured} of its {original} bytes; expected whole frames (capture without a length limit)"
            ));
        }
        Ok(())
    };
    match block {
        PcapBlockOwned::LegacyHeader(header) => {
            clock.nanoseconds = header.is_nanosecond_precision();
            only_ethernet(header.network)?;
        }
        PcapBlockOwned::Legacy(packet) => {
            taken.packet = true;
            let stamp_ns = clock.pcap_ns(packet.ts_sec, packet.ts_usec);
            taken.ethercat = frame(stamp_ns, packet.data)?;
            if taken.ethercat {
                whole(packet.caplen, packet.origlen)?;
            }
        }
        PcapBlockOwned::NG(Block::SectionHeader(_)) => clock.interfaces.clear(),
        PcapBlockOwned::NG(Block::InterfaceDescription(interface)) => {
            if clock.interfaces.len() >= MOST_INTERFACES {
                return Err(format!("found more than {MOST_INTERFACES} interfaces; expected a capture"));
            }
            only_ethernet(interface.linktype)?;
            let per_second = interface.ts_resolution().ok_or("found a time resolution that is none")?;
            clock.interfaces.push((per_second, interface.ts_offset()));
        }
        PcapBlockOwned::NG(Block::EnhancedPacket(packet)) => {
            taken.packet = true;
            let ticks = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
            let stamp_ns = clock.pcapng_ns(packet.if_id, ticks)?;
            // The data are padded to four bytes.
            let data = usize::try_from(packet.caplen).ok().and_then(|n| packet.data.get(..n)).unwrap_or(packet.data);
            taken.ethercat = frame(stamp_ns, data)?;
            if taken.ethercat {
                whole(packet.caplen, packet.origlen)?;
            }
        }
        PcapBlockOwned::NG(Block::SimplePacket(_)) => {
            taken.packet = true;
            return Err("found a packet without a time stamp; expected one with".to_owned());
        }
        PcapBlockOwned::NG(_) => {}
    }
    Ok(())
}

/// Adds an Ethernet frame's cycles to `ready`; true if it is an EtherCAT frame.
fn cycles_of(stamp_ns: i64, data: &[u8], cycles: &mut Cycles, ready: &mut VecDeque<Sample>) -> Result<bool, String> {
    let cut = |Cut| "found a frame that ends before its own length; expected whole frames".to_owned();
    let Some(frame) = Frame::parse(data).map_err(cut)? else { return Ok(false) };
    for datagram in frame.datagrams() {
        let datagram = datagram.map_err(cut)?;
        if cycles.push(stamp_ns, &frame, &datagram) {
            let mut sample = Sample::default();
            cycles.write(&mut sample);
            ready.push_back(sample);
        }
    }
    Ok(true)
}

impl RawReader for CaptureReader {
    fn about(&self) -> &About {
        &self.about
    }

    fn next_sample(&mut self, out: &mut Sample) -> Result<bool, BadInput> {
        if !self.advance()? {
            if self.frames > 0 && !self.ethercat {
                let frames = self.frames;
                return Err(BadInput::new(format!(
                    "found {frames} frames, none of EtherCAT; expected some of type 0x88A4"
                )));
            }
            return Ok(false);
        }
        let Some(sample) = self.ready.pop_front() else { return Ok(false) };
        let joints = out.measured.header.joints;
        out.measured = sample.measured;
        out.measured.header.joints = joints;
        out.extra.clear();
        if self.extra {
            out.extra.extend(sample.extra);
        }
        Ok(true)
    }

    fn locate(&self, error: BadInput) -> BadInput {
        BadInput { what: format!("frame {}: {}", self.frames, error.what), ..error }
    }

    fn bytes_read(&self) -> u64 {
        self.bytes
    }

    fn repairs(&self) -> Vec<Repair> {
        let mut all = self.cycles.repairs();
        if self.cut {
            all.push(repair(RepairKind::TruncatedTail, "t", 1));
        }
        all
    }
}
