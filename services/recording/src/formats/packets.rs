//! Packets of a pcap or pcapng file, one after the other, with their stamps in nanoseconds.

use crate::files::open_error;
use lacuna_interfaces::BadInput;
use pcap_parser::traits::PcapReaderIterator;
use pcap_parser::{Block, Linktype, PcapBlockOwned, PcapError, create_reader};
use std::fs::File;
use std::path::Path;

/// Bytes that are held of a capture at a time: more than any frame or description block.
const BUFFER_BYTES: usize = 1 << 20;
/// Most interfaces of a capture.
const MOST_INTERFACES: usize = 1024;

/// A capture being read.
pub(crate) struct Packets {
    capture: Box<dyn PcapReaderIterator + Send>,
    clock: Clock,
    /// Packets so far, the present one included.
    pub count: u64,
    /// Bytes of the file used so far.
    pub bytes: u64,
    /// Whether the file ends within a packet.
    pub cut: bool,
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

impl Packets {
    pub(crate) fn open(path: &Path) -> Result<Self, BadInput> {
        let file = File::open(path).map_err(|e| open_error(path, &e))?;
        let capture = create_reader(BUFFER_BYTES, file)
            .map_err(|_| BadInput::new("found no header of a capture; expected pcap or pcapng"))?;
        Ok(Self { capture, clock: Clock::default(), count: 0, bytes: 0, cut: false })
    }

    pub(crate) fn at_frame(&self, what: impl std::fmt::Display) -> BadInput {
        BadInput::new(format!("frame {}: {what}", self.count))
    }

    /// Hands the next packet to `packet`, which says whether its content matters: then it must be whole. `false` at the
    /// end.
    ///
    /// # Errors
    /// [`BadInput`] with the number of the frame, if it is damaged, cut short or refused by `packet`.
    pub(crate) fn next(
        &mut self,
        mut packet: impl FnMut(i64, &[u8]) -> Result<bool, String>,
    ) -> Result<bool, BadInput> {
        loop {
            match self.capture.next() {
                Ok((used, block)) => {
                    let is_packet = is_packet(&block);
                    let read = take(&block, &mut self.clock, &mut packet);
                    self.count += u64::from(is_packet);
                    self.capture.consume(used);
                    self.bytes += used as u64;
                    read.map_err(|what| self.at_frame(what))?;
                    if is_packet {
                        return Ok(true);
                    }
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
                    let more = self.capture.refill().map_err(|e| e.to_string());
                    more.map_err(|e| self.at_frame(format!("cannot be read: {e}")))?;
                }
                Err(e) => {
                    let what = match e {
                        PcapError::BufferTooSmall => {
                            format!("found a block above {BUFFER_BYTES} bytes; expected a frame")
                        }
                        PcapError::ReadError => "cannot be read".to_owned(),
                        _ => "found a damaged block; expected a capture's packet".to_owned(),
                    };
                    self.count += 1;
                    return Err(self.at_frame(what));
                }
            }
        }
    }
}

fn is_packet(block: &PcapBlockOwned<'_>) -> bool {
    use Block::{EnhancedPacket, SimplePacket};
    matches!(block, PcapBlockOwned::Legacy(_) | PcapBlockOwned::NG(EnhancedPacket(_) | SimplePacket(_)))
}

/// Takes one block of the capture: descriptions set the clock, packets go to `packet`.
fn take(
    block: &PcapBlockOwned<'_>,
    clock: &mut Clock,
    packet: &mut impl FnMut(i64, &[u8]) -> Result<bool, String>,
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
        PcapBlockOwned::Legacy(block) => {
            let stamp_ns = clock.pcap_ns(block.ts_sec, block.ts_usec);
            if packet(stamp_ns, block.data)? {
                whole(block.caplen, block.origlen)?;
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
        PcapBlockOwned::NG(Block::EnhancedPacket(block)) => {
            let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
            let stamp_ns = clock.pcapng_ns(block.if_id, ticks)?;
            // The data are padded to four bytes.
            let data = usize::try_from(block.caplen).ok().and_then(|n| block.data.get(..n)).unwrap_or(block.data);
            if packet(stamp_ns, data)? {
                whole(block.caplen, block.origlen)?;
            }
        }
        PcapBlockOwned::NG(Block::SimplePacket(_)) => {
            return Err("found a packet without a time stamp; expected one with".to_owned());
        }
        PcapBlockOwned::NG(_) => {}
    }
    Ok(())
}
