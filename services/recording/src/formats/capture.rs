//! Captures of a fieldbus: pcap and pcapng with EtherCAT frames, as a network analyser or tcpdump writes them.
//!
//! Time stamps in micro- or nanoseconds, of pcapng in each interface's own resolution. Which bytes are which joint's
//! signals is said by `[ethercat]` of the robot file ([`lacuna_interfaces::ethercat`]); frames of other protocols are
//! passed over.

use super::packets::Packets;
use super::{Format, Request};
use crate::condition::repair;
use crate::ethercat::{Cut, Cycles, Frame};
use crate::sample::{About, RawReader, Sample};
use lacuna_interfaces::{BadInput, Repair, RepairKind};
use std::collections::VecDeque;

/// The registry's line.
pub const FORMAT: Format =
    Format { name: "capture", extensions: &["pcap", "pcapng", "cap"], exact: false, sniff: Some(is_capture), open };

/// First bytes of pcap (either byte order, micro- or nanoseconds) and pcapng.
fn is_capture(first: &[u8]) -> bool {
    let magic: Option<[u8; 4]> = first.get(..4).and_then(|b| b.try_into().ok());
    magic.is_some_and(|m| {
        let read = [u32::from_le_bytes(m), u32::from_be_bytes(m)];
        read.iter().any(|v| [0xA1B2_C3D4, 0xA1B2_3C4D, 0x0A0D_0D0A].contains(v))
    })
}

fn open(request: &Request<'_>) -> Result<Box<dyn RawReader>, BadInput> {
    let cycles = Cycles::new(request.robot)?;
    let extra = request.options.extra;
    let extra_names = if extra { cycles.extra_names() } else { Vec::new() };
    Ok(Box::new(CaptureReader {
        packets: Packets::open(request.path)?,
        cycles,
        about: About { format: FORMAT.name, extra_names, ..About::default() },
        extra,
        ethercat: false,
        ready: VecDeque::new(),
    }))
}

/// Reads a capture.
struct CaptureReader {
    packets: Packets,
    cycles: Cycles,
    about: About,
    extra: bool,
    /// Whether any EtherCAT frame was seen.
    ethercat: bool,
    /// Cycles that the last frame completed, not handed over yet.
    ready: VecDeque<Sample>,
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
        let Self { packets, cycles, ready, ethercat, .. } = self;
        let mut more = true;
        while more && ready.is_empty() {
            more = packets.next(|stamp_ns, data| {
                let is = cycles_of(stamp_ns, data, cycles, ready)?;
                *ethercat |= is;
                Ok(is)
            })?;
        }
        let Some(sample) = ready.pop_front() else {
            let frames = self.packets.count;
            if frames > 0 && !self.ethercat {
                return Err(BadInput::new(format!(
                    "found {frames} frames, none of EtherCAT; expected some of type 0x88A4"
                )));
            }
            return Ok(false);
        };
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
        BadInput { what: format!("frame {}: {}", self.packets.count, error.what), ..error }
    }

    fn bytes_read(&self) -> u64 {
        self.packets.bytes
    }

    fn repairs(&self) -> Vec<Repair> {
        let mut all = self.cycles.repairs();
        if self.packets.cut {
            all.push(repair(RepairKind::TruncatedTail, "t", 1));
        }
        all
    }
}
