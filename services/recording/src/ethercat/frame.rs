//! Frames and datagrams.
//!
//! ```text
//! Ethernet   destination 6, source 6, [0x8100 tag 2]…, type 2 = 0x88A4   (or UDP port 0x88A4 over IPv4)
//! EtherCAT   u16: length 11 bits, reserved 1, protocol 4 (1 = datagrams)
//! datagram   command 1, index 1, address 4, u16: length 11, reserved 3, circulating 1, more follow 1, interrupt 2,
//!            data, working counter 2                                                 (all little endian)
//! ```

/// EtherType, and UDP port.
const ETHERCAT: u16 = 0x88A4;
const VLAN: [u16; 2] = [0x8100, 0x88A8];
const IPV4: u16 = 0x0800;
const UDP: u8 = 17;
/// Protocol of an EtherCAT frame that holds datagrams.
const DATAGRAMS: u16 = 1;

/// What a datagram asks of the slaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Command {
    /// Reads the memory of the slave with a station address.
    Fprd,
    /// Writes it.
    Fpwr,
    /// Reads and writes it.
    Fprw,
    /// Reads logical memory.
    Lrd,
    /// Writes it.
    Lwr,
    /// Reads and writes it.
    Lrw,
    /// Any other: by position, broadcast, distributed clocks.
    Other(u8),
}

impl From<u8> for Command {
    fn from(code: u8) -> Self {
        match code {
            4 => Self::Fprd,
            5 => Self::Fpwr,
            6 => Self::Fprw,
            10 => Self::Lrd,
            11 => Self::Lwr,
            12 => Self::Lrw,
            other => Self::Other(other),
        }
    }
}

impl Command {
    /// Code of a process data command.
    pub fn code(self) -> Option<u8> {
        Some(match self {
            Self::Fprd => 4,
            Self::Fpwr => 5,
            Self::Fprw => 6,
            Self::Lrd => 10,
            Self::Lwr => 11,
            Self::Lrw => 12,
            Self::Other(_) => return None,
        })
    }

    /// Name as the standard has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fprd => "FPRD",
            Self::Fpwr => "FPWR",
            Self::Fprw => "FPRW",
            Self::Lrd => "LRD",
            Self::Lwr => "LWR",
            Self::Lrw => "LRW",
            Self::Other(_) => "other",
        }
    }

    /// Whether the data that come back are the slaves'.
    pub fn reads(self) -> bool {
        matches!(self, Self::Fprd | Self::Fprw | Self::Lrd | Self::Lrw)
    }

    /// Whether the address is a logical one.
    pub fn logical(self) -> bool {
        matches!(self, Self::Lrd | Self::Lwr | Self::Lrw)
    }
}

/// A frame was captured in part only, or its lengths contradict each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut;

/// An EtherCAT frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// A slave has handled it: slaves set the "locally administered" bit of the source address.
    pub handled: bool,
    datagrams: &'a [u8],
}

/// One datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// What it asks.
    pub command: Command,
    /// The master's index.
    pub index: u8,
    /// Logical address, or station (low half) and memory offset (high half).
    pub address: u32,
    /// Process data.
    pub data: &'a [u8],
    /// How many slaves handled it; counts up along the ring.
    pub working_counter: u16,
}

fn u16_at(bytes: &[u8], at: usize, big_endian: bool) -> Option<u16> {
    let two: [u8; 2] = bytes.get(at..at + 2)?.try_into().ok()?;
    Some(if big_endian { u16::from_be_bytes(two) } else { u16::from_le_bytes(two) })
}

impl<'a> Frame<'a> {
    /// The EtherCAT frame in an Ethernet frame; `None` if there is none.
    ///
    /// # Errors
    /// [`Cut`] if it ends before the length it states.
    pub fn parse(ethernet: &'a [u8]) -> Result<Option<Self>, Cut> {
        let mut at = 12;
        let kind = loop {
            let Some(kind) = u16_at(ethernet, at, true) else { return Ok(None) };
            at += 2;
            if !VLAN.contains(&kind) {
                break kind;
            }
            at += 2;
        };
        let body = match kind {
            ETHERCAT => ethernet.get(at..),
            IPV4 => ethernet.get(at..).and_then(udp),
            _ => None,
        };
        let Some(body) = body else { return Ok(None) };
        let head = u16_at(body, 0, false).ok_or(Cut)?;
        if head >> 12 != DATAGRAMS {
            return Ok(None);
        }
        let datagrams = body.get(2..2 + usize::from(head & 0x7FF)).ok_or(Cut)?;
        Ok(Some(Self { handled: ethernet.get(6).is_some_and(|b| b & 2 != 0), datagrams }))
    }

    /// Its datagrams.
    pub fn datagrams(&self) -> Datagrams<'a> {
        Datagrams { rest: Some(self.datagrams) }
    }
}

/// The payload of an IPv4 packet to or from EtherCAT's UDP port.
fn udp(ip: &[u8]) -> Option<&[u8]> {
    let first = *ip.first()?;
    let header = usize::from(first & 0xF) * 4;
    if first >> 4 != 4 || header < 20 || *ip.get(9)? != UDP {
        return None;
    }
    let ports = [u16_at(ip, header, true)?, u16_at(ip, header + 2, true)?];
    if ports.contains(&ETHERCAT) { ip.get(header + 8..) } else { None }
}

/// Iterates over datagrams; ends after the first [`Cut`].
#[derive(Debug, Clone)]
pub struct Datagrams<'a> {
    rest: Option<&'a [u8]>,
}

impl<'a> Iterator for Datagrams<'a> {
    type Item = Result<Datagram<'a>, Cut>;

    fn next(&mut self) -> Option<Self::Item> {
        let bytes = self.rest.take()?;
        let one = || {
            let head: [u8; 10] = bytes.get(..10)?.try_into().ok()?;
            let sizes = u16::from_le_bytes([head[6], head[7]]);
            let end = 10 + usize::from(sizes & 0x7FF);
            let datagram = Datagram {
                command: head[0].into(),
                index: head[1],
                address: u32::from_le_bytes([head[2], head[3], head[4], head[5]]),
                data: bytes.get(10..end)?,
                working_counter: u16_at(bytes, end, false)?,
            };
            Some((datagram, (sizes >> 15 == 1).then(|| bytes.get(end + 2..).unwrap_or(&[]))))
        };
        match one() {
            Some((datagram, rest)) => {
                self.rest = rest;
                Some(Ok(datagram))
            }
            None => Some(Err(Cut)),
        }
    }
}
