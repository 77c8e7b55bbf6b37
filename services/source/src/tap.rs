//! A live tap on an EtherCAT network: frames of a network interface as samples, with the kernel's time stamps.
//!
//! It listens only (an AF_PACKET socket, nothing is sent) and needs the right to do so (CAP_NET_RAW). What the kernel had
//! to drop because nobody read in time is counted, and the sample after it flagged as after a gap.

use crate::steady::Steady;
use lacuna_interfaces::{BadInput, JointMeasured, Repair, RobotFile, flag};
use lacuna_recording::Sample;
use lacuna_recording::condition::{Conditioner, Verdict};
use lacuna_recording::ethercat::{Cycles, Frame};
use nix::errno::Errno;
use nix::ifaddrs::getifaddrs;
use nix::sys::socket::{
    AddressFamily, ControlMessageOwned, MsgFlags, SockFlag, SockProtocol, SockType, SockaddrLike, bind, recvmsg,
    setsockopt, socket, sockopt,
};
use nix::sys::time::{TimeSpec, TimeVal, TimeValLike};
use std::collections::VecDeque;
use std::io::IoSliceMut;
use std::os::fd::{AsRawFd, OwnedFd};

/// How long one look for a frame lasts [ms].
const LOOK_MS: i64 = 50;
/// Socket buffer that is asked for [bytes]: half a second of full frames at 8 kHz.
const BUFFER_BYTES: usize = 8 << 20;
/// Largest Ethernet frame [bytes].
const FRAME_BYTES: usize = 1 << 11;

/// A network interface being listened to.
#[derive(Debug)]
pub struct Tap {
    socket: OwnedFd,
    interface: String,
    cycles: Cycles,
    steady: Steady,
    judge: Conditioner,
    ready: VecDeque<Sample>,
    frame: Vec<u8>,
    control: Vec<u8>,
    joints: u32,
    seq: u64,
    frames: u64,
    damaged: u64,
    refused: u64,
    /// Frames that the kernel dropped, by its own count, and whether a sample was flagged for them.
    dropped: u32,
    gap: bool,
}

fn refused(interface: &str, what: &str, errno: Errno) -> BadInput {
    let why = match errno {
        Errno::EPERM | Errno::EACCES => {
            "not permitted; expected the right to listen (CAP_NET_RAW: run as root, or setcap cap_net_raw+ep on \
             lacuna-source)"
                .to_owned()
        }
        other => other.desc().to_owned(),
    };
    BadInput::new(format!("interface {interface}: cannot {what}: {why}"))
}

impl Tap {
    /// Listens on `interface`.
    ///
    /// # Errors
    /// [`BadInput`] if the robot file has no `[ethercat]` table that can be used, the interface does not exist, or the
    /// process may not listen.
    pub fn open(interface: &str, robot: &RobotFile) -> Result<Self, BadInput> {
        let cycles = Cycles::new(robot)?;
        let fail = |what: &'static str| move |e: Errno| refused(interface, what, e);
        let mut all = getifaddrs().map_err(fail("list the interfaces"))?;
        let family = |a: &nix::ifaddrs::InterfaceAddress| a.address.and_then(|s| s.family());
        let found = all.find(|a| a.interface_name == interface && family(a) == Some(AddressFamily::Packet));
        let address = found.and_then(|a| a.address).ok_or_else(|| {
            BadInput::new(format!("found no network interface \"{interface}\"; expected one that `ip link` lists"))
        })?;
        let flags = SockFlag::SOCK_CLOEXEC;
        let socket =
            socket(AddressFamily::Packet, SockType::Raw, flags, SockProtocol::EthAll).map_err(fail("open a socket"))?;
        bind(socket.as_raw_fd(), &address).map_err(fail("listen"))?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true).map_err(fail("have frames stamped"))?;
        setsockopt(&socket, sockopt::RxqOvfl, &1).map_err(fail("have drops counted"))?;
        setsockopt(&socket, sockopt::ReceiveTimeout, &TimeVal::milliseconds(LOOK_MS)).map_err(fail("set a timeout"))?;
        // Beyond the system's limit only root may go; the smaller buffer then serves.
        if setsockopt(&socket, sockopt::RcvBufForce, &BUFFER_BYTES).is_err() {
            setsockopt(&socket, sockopt::RcvBuf, &BUFFER_BYTES).map_err(fail("set its buffer"))?;
        }
        Ok(Self {
            socket,
            interface: interface.to_owned(),
            cycles,
            steady: Steady::new(),
            judge: Conditioner::new(robot),
            ready: VecDeque::with_capacity(4),
            frame: vec![0; FRAME_BYTES],
            control: nix::cmsg_space!(TimeSpec, u32),
            joints: robot.joint_count() as u32,
            seq: 0,
            frames: 0,
            damaged: 0,
            refused: 0,
            dropped: 0,
            gap: false,
        })
    }

    /// The next sample, or `None` if none came within some 50 ms.
    ///
    /// # Errors
    /// [`BadInput`] if the interface is gone.
    pub fn next_sample(&mut self) -> Result<Option<JointMeasured>, BadInput> {
        loop {
            while let Some(sample) = self.ready.pop_front() {
                let mut m = sample.measured;
                m.header.joints = self.joints;
                // A value that no robot has: left out and counted, the stream goes on.
                match self.judge.judge(&mut m) {
                    Ok(Verdict::Keep) => {}
                    Ok(Verdict::Drop) => continue,
                    Err(_) => {
                        self.refused += 1;
                        self.gap = true;
                        continue;
                    }
                }
                if std::mem::take(&mut self.gap) {
                    m.header.flags |= flag::GAP;
                }
                self.seq += 1;
                m.header.seq = self.seq;
                return Ok(Some(m));
            }
            if !self.receive()? {
                return Ok(None);
            }
        }
    }

    /// Takes in one frame; `false` if none came in time.
    fn receive(&mut self) -> Result<bool, BadInput> {
        let mut parts = [IoSliceMut::new(&mut self.frame)];
        let message =
            match recvmsg::<()>(self.socket.as_raw_fd(), &mut parts, Some(&mut self.control), MsgFlags::empty()) {
                Ok(message) => message,
                Err(Errno::EAGAIN | Errno::EINTR) => return Ok(false),
                Err(e) => return Err(refused(&self.interface, "listen", e)),
            };
        let bytes = message.bytes;
        let (mut stamp_ns, mut dropped) = (None, self.dropped);
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampns(t) => {
                    stamp_ns = Some(t.tv_sec().saturating_mul(1_000_000_000).saturating_add(t.tv_nsec()));
                }
                ControlMessageOwned::RxqOvfl(count) => dropped = count,
                _ => {}
            }
        }
        if dropped != self.dropped {
            self.dropped = dropped;
            self.gap = true;
        }
        self.frames += 1;
        let (Some(stamp_ns), Some(data)) = (stamp_ns, self.frame.get(..bytes)) else { return Ok(true) };
        let now = self.steady.now();
        let stamp_ns = self.steady.stamp(stamp_ns, now);
        let Ok(Some(frame)) = Frame::parse(data) else { return Ok(true) };
        for datagram in frame.datagrams() {
            let Ok(datagram) = datagram else {
                self.damaged += 1;
                break;
            };
            if self.cycles.push(stamp_ns, &frame, &datagram) {
                let mut sample = Sample::default();
                self.cycles.write(&mut sample);
                self.ready.push_back(sample);
            }
        }
        Ok(true)
    }

    /// Makes the kernel's buffer as small as it lets it be, so that drops can be provoked.
    ///
    /// # Errors
    /// [`BadInput`] if the kernel refuses.
    pub fn shrink_buffer(&self) -> Result<(), BadInput> {
        setsockopt(&self.socket, sockopt::RcvBuf, &0).map_err(|e| refused(&self.interface, "set its buffer", e))
    }

    /// Samples handed over so far.
    pub fn count(&self) -> u64 {
        self.seq
    }

    /// Frames that the kernel dropped since nobody read in time.
    pub fn dropped(&self) -> u64 {
        u64::from(self.dropped)
    }

    /// Frames received, frames that contradict their own lengths, and samples refused as impossible.
    pub fn frames(&self) -> [u64; 3] {
        [self.frames, self.damaged, self.refused]
    }

    /// How often the machine's clock was set so far; the stamps do not follow it.
    pub fn clock_steps(&self) -> u64 {
        self.steady.steps()
    }

    /// What was left out or repaired so far.
    pub fn repairs(&self) -> Vec<Repair> {
        let mut all = self.judge.repairs();
        all.extend(self.cycles.repairs());
        all.iter_mut().for_each(|r| r.file.clone_from(&self.interface));
        all
    }
}
