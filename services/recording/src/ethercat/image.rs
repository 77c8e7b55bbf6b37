//! Cycles: the objects of all drives from one turn of the bus, as one sample.

use super::frame::{Command, Datagram, Frame};
use crate::condition::repair;
use crate::sample::Sample;
use lacuna_interfaces::ethercat::{Ethercat, Place};
use lacuna_interfaces::robot::TorqueUnit;
use lacuna_interfaces::{BadInput, MAX_JOINTS, Repair, RepairKind, RobotFile, flag};
use std::f64::consts::TAU;

/// Datagrams told apart when their usual working counter is learned.
const MOST_DATAGRAMS: usize = 64;
/// Bits of the status word that must read 0x27 in "operation enabled" (CiA 402).
const STATE_MASK: u16 = 0x6F;
const OPERATION_ENABLED: u16 = 0x27;

/// From a drive's counts to its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Joint angle per count [rad].
    pub rad_per_count: f64,
    /// Joint torque per count [Nm].
    pub nm_per_count: f64,
    /// Joint angle at count 0 [rad].
    pub offset_rad: f64,
}

impl Scales {
    /// Scales of joint `j`: counts of the motor's encoder by the gear ratio, torque by the rated torque at the joint;
    /// the sign of the gear ratio turns both.
    ///
    /// # Errors
    /// [`BadInput`] naming what the robot file lacks.
    pub fn of(robot: &RobotFile, table: &Ethercat, j: usize) -> Result<Self, BadInput> {
        let joint = robot.joints.get(j).map_or("", String::as_str);
        let axis = table.axis.get(j);
        let value = |list: &Option<lacuna_interfaces::robot::PerJoint>| list.as_ref().and_then(|p| p.get(j));
        let missing = |key: &str, why: &str| {
            BadInput::new(format!("joint {joint}: found no {key} in the robot file; expected it, {why}"))
        };
        let gear = value(&robot.drive.gear_ratio).unwrap_or(1.0);
        let counts = axis.and_then(|a| a.counts_per_turn).or_else(|| value(&robot.drive.encoder_bits).map(f64::exp2));
        let counts = counts.ok_or_else(|| missing("drive.encoder_bits", "since the bus gives encoder counts"))?;
        if robot.torque_unit != TorqueUnit::Nm {
            return Err(BadInput::new(format!(
                "found torque_unit = \"{}\"; expected \"Nm\", since drives give torque in per mille of the rated one",
                robot.torque_unit.symbol()
            )));
        }
        let rated = value(&robot.drive.rated_torque_nm);
        let rated = rated.ok_or_else(|| missing("drive.rated_torque_nm", "since the bus gives per mille of it"))?;
        Ok(Self {
            rad_per_count: TAU / (counts * gear),
            nm_per_count: rated * gear.signum() / 1000.0,
            offset_rad: axis.map_or(0.0, |a| a.offset_rad),
        })
    }
}

/// What an object becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Signal {
    Position,
    Torque,
    Velocity,
    Status,
}

impl Signal {
    fn bytes(self) -> usize {
        if matches!(self, Self::Position | Self::Velocity) { 4 } else { 2 }
    }
}

/// An object and what the present cycle says of it.
#[derive(Debug, Clone)]
struct Slot {
    joint: usize,
    signal: Signal,
    logical: bool,
    address: u32,
    value: i32,
    fresh: bool,
}

impl Slot {
    /// Its bytes in a datagram, if the datagram reads them.
    fn find<'a>(&self, datagram: &Datagram<'a>) -> Option<&'a [u8]> {
        if !datagram.command.reads() || datagram.command.logical() != self.logical {
            return None;
        }
        let at = if self.logical {
            self.address.checked_sub(datagram.address)?
        } else {
            if self.address & 0xFFFF != datagram.address & 0xFFFF {
                return None;
            }
            (self.address >> 16).checked_sub(datagram.address >> 16)?
        };
        let at = usize::try_from(at).ok()?;
        datagram.data.get(at..at.checked_add(self.signal.bytes())?)
    }
}

/// What is known of one recurring datagram.
#[derive(Debug, Clone, Copy)]
struct Known {
    command: Command,
    address: u32,
    /// Largest working counter seen.
    usual: u16,
    /// A copy with a smaller one was seen, and none with the usual one since [ns].
    short_since: Option<i64>,
    /// Last copy with the usual one [ns].
    last_ns: Option<i64>,
}

/// Puts datagrams together to samples.
#[derive(Debug)]
pub struct Cycles {
    joints: usize,
    slots: Vec<Slot>,
    scales: Vec<Scales>,
    /// Position with the turns of its 32-bit counter undone [counts].
    position: [Option<(i32, i64)>; MAX_JOINTS],
    known: Vec<Known>,
    /// Cycle as given, and the shortest time between two copies of a datagram [ns].
    cycle_ns: Option<i64>,
    learned_ns: Option<i64>,
    began_ns: i64,
    last_ns: Option<i64>,
    missing: u64,
    short: u64,
    /// Of `short`, what a sample was flagged for.
    told: u64,
    velocity: bool,
    status: bool,
}

impl Cycles {
    /// Cycles of a robot whose file has an `[ethercat]` table, its names resolved ([`super::resolve`]).
    ///
    /// # Errors
    /// [`BadInput`] if there is no table, or the robot file lacks what turns counts into angles and torques.
    pub fn new(robot: &RobotFile) -> Result<Self, BadInput> {
        let table = robot.ethercat.as_ref().ok_or_else(|| {
            BadInput::new(
                "found a fieldbus capture and no [ethercat] in the robot file; expected the table that says where the \
                 drives' signals are",
            )
        })?;
        let n = robot.joint_count();
        let mut slots = Vec::new();
        for (joint, axis) in table.axis.iter().enumerate().take(n) {
            for (place, signal) in [
                (&axis.position, Signal::Position),
                (&axis.torque, Signal::Torque),
                (&axis.velocity, Signal::Velocity),
                (&axis.status, Signal::Status),
            ] {
                let Some(place) = place else { continue };
                let (logical, address) = match place {
                    Place::Logical(address) => (true, *address),
                    Place::Station { station, offset } => (false, u32::from(*station) | u32::from(*offset) << 16),
                    Place::Variable(name) => {
                        return Err(BadInput::new(format!(
                            "ethercat.axis[{joint}]: found variable \"{name}\" not looked up; expected an address"
                        )));
                    }
                };
                slots.push(Slot { joint, signal, logical, address, value: 0, fresh: false });
            }
        }
        let has = |j: usize, signal| slots.iter().any(|s: &Slot| s.joint == j && s.signal == signal);
        if let Some(j) = (0..n).find(|&j| !has(j, Signal::Position) || !has(j, Signal::Torque)) {
            return Err(BadInput::new(format!(
                "ethercat.axis[{j}]: found no address of position or torque; expected both"
            )));
        }
        let all = |signal| (0..n).all(|j| has(j, signal));
        let (velocity, status) = (all(Signal::Velocity), all(Signal::Status));
        let cycle_s = table.cycle_s.or_else(|| robot.drive.sample_rate_hz.map(|f| 1.0 / f));
        Ok(Self {
            joints: n,
            scales: (0..n).map(|j| Scales::of(robot, table, j)).collect::<Result<_, _>>()?,
            slots,
            position: [None; MAX_JOINTS],
            known: Vec::new(),
            cycle_ns: cycle_s.map(|s| (s * 1e9).round() as i64).filter(|ns| *ns > 0),
            learned_ns: None,
            began_ns: 0,
            last_ns: None,
            missing: 0,
            short: 0,
            told: 0,
            velocity,
            status,
        })
    }

    /// Names of the further columns of its samples: joint velocities and status words, where every drive gives them.
    pub fn extra_names(&self) -> Vec<String> {
        let named = |have: bool, name: &str| {
            (0..if have { self.joints } else { 0 }).map(|j| format!("x_{name}{}", j + 1)).collect()
        };
        let (mut all, status): (Vec<String>, Vec<String>) = (named(self.velocity, "qd"), named(self.status, "status"));
        all.extend(status);
        all
    }

    /// Takes in a datagram; true if it completes a cycle, which [`Cycles::write`] then gives.
    pub fn push(&mut self, stamp_ns: i64, frame: &Frame<'_>, datagram: &Datagram<'_>) -> bool {
        if !self.slots.iter().any(|s| s.find(datagram).is_some()) || !self.came_back(stamp_ns, frame, datagram) {
            return false;
        }
        // An object that comes again, or comes late, begins another cycle; what is still missing of this one will not
        // come.
        let late = stamp_ns - self.began_ns > self.half_cycle_ns();
        if self.slots.iter().any(|s| s.fresh && (late || s.find(datagram).is_some())) {
            self.slots.iter_mut().for_each(|s| s.fresh = false);
        }
        if self.slots.iter().all(|s| !s.fresh) {
            self.began_ns = stamp_ns;
        }
        for slot in &mut self.slots {
            match slot.find(datagram) {
                Some(&[a, b, c, d]) => slot.value = i32::from_le_bytes([a, b, c, d]),
                Some(&[a, b]) => slot.value = i32::from(i16::from_le_bytes([a, b])),
                _ => continue,
            }
            slot.fresh = true;
        }
        let complete = self.slots.iter().all(|s| s.fresh);
        if complete {
            self.slots.iter_mut().for_each(|s| s.fresh = false);
        }
        complete
    }

    /// Whether a datagram has been round the bus, handled by all its slaves.
    ///
    /// A tap sees frames on their way out and on their way back. Out, no slave has counted yet. A count below the
    /// largest seen is a copy from the middle of the ring if the whole one follows within the cycle; if none does, a
    /// slave did not answer.
    fn came_back(&mut self, stamp_ns: i64, frame: &Frame<'_>, datagram: &Datagram<'_>) -> bool {
        if datagram.working_counter == 0 && !frame.handled {
            return false;
        }
        let same = |k: &Known| k.command == datagram.command && k.address == datagram.address;
        let i = match self.known.iter().position(same) {
            Some(i) => i,
            None if self.known.len() >= MOST_DATAGRAMS => return datagram.working_counter > 0,
            None => {
                let (command, address) = (datagram.command, datagram.address);
                self.known.push(Known { command, address, usual: 0, short_since: None, last_ns: None });
                self.known.len() - 1
            }
        };
        let half_ns = self.half_cycle_ns();
        let known = &mut self.known[i];
        let usual = known.usual.max(datagram.working_counter);
        let whole = datagram.working_counter == usual && usual > 0;
        // A new largest count makes those before it copies from the middle, not failures.
        let grew = usual > known.usual;
        known.usual = usual;
        if let Some(since) = known.short_since
            && (!whole || (!grew && stamp_ns - since > half_ns))
        {
            self.short += 1;
        }
        known.short_since = if whole { None } else { Some(stamp_ns) };
        if whole {
            let since = known.last_ns.replace(stamp_ns).map(|last| stamp_ns - last).filter(|dt| *dt > 0);
            self.learned_ns = [self.learned_ns, since].into_iter().flatten().min();
        }
        whole
    }

    /// Half the bus cycle, or half of what was learned of it; without either no copy is late.
    fn half_cycle_ns(&self) -> i64 {
        self.cycle_ns.or(self.learned_ns).map_or(i64::MAX, |c| c / 2)
    }

    /// Writes the cycle that was just completed: stamp of its first datagram, joint angles, torques, further columns.
    pub fn write(&mut self, out: &mut Sample) {
        let m = &mut out.measured;
        m.header.stamp_ns = self.began_ns;
        m.temperature_degc = [f64::NAN; MAX_JOINTS];
        m.link_q_rad = [f64::NAN; MAX_JOINTS];
        m.link_tau_nm = [f64::NAN; MAX_JOINTS];
        let n = self.joints;
        let width = usize::from(self.velocity) * n + usize::from(self.status) * n;
        out.extra.clear();
        out.extra.resize(width, 0.0);
        let status_at = usize::from(self.velocity) * n;
        for slot in &self.slots {
            let (j, scale) = (slot.joint, self.scales[slot.joint]);
            match slot.signal {
                Signal::Position => {
                    let turned = match self.position[j] {
                        Some((last, turned)) => turned + i64::from(slot.value.wrapping_sub(last)),
                        None => i64::from(slot.value),
                    };
                    self.position[j] = Some((slot.value, turned));
                    m.q_rad[j] = turned as f64 * scale.rad_per_count + scale.offset_rad;
                }
                Signal::Torque => m.tau_nm[j] = f64::from(slot.value) * scale.nm_per_count,
                Signal::Velocity => {
                    if self.velocity {
                        out.extra[j] = f64::from(slot.value) * scale.rad_per_count;
                    }
                }
                Signal::Status => {
                    let word = slot.value as u16;
                    if word & STATE_MASK != OPERATION_ENABLED {
                        m.header.flags |= flag::DRIVE_OFF;
                    }
                    if self.status {
                        out.extra[status_at + j] = f64::from(word);
                    }
                }
            }
        }
        if let (Some(last), Some(cycle)) = (self.last_ns, self.cycle_ns) {
            let missed = (self.began_ns - last + cycle / 2) / cycle - 1;
            if missed > 0 {
                self.missing += missed.unsigned_abs();
                m.header.flags |= flag::GAP;
            }
        }
        // A cycle was left out, whether or not its length is known.
        if std::mem::replace(&mut self.told, self.short) < self.short {
            m.header.flags |= flag::GAP;
        }
        self.last_ns = Some(self.began_ns);
    }

    /// What was left out so far, with empty file names; only what occurred.
    pub fn repairs(&self) -> Vec<Repair> {
        let open = self.known.iter().filter(|k| k.short_since.is_some()).count() as u64;
        let mut all = vec![
            repair(RepairKind::WorkingCounter, "t", self.short + open),
            repair(RepairKind::MissingCycle, "t", self.missing),
        ];
        all.retain(|r| r.count > 0);
        all
    }
}
