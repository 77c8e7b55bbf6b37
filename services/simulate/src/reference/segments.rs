//! Rest-to-rest moves in joint space with dwells in between.

use super::{Motion, MotionLimits, Reference, WORKSPACE_MARGIN, step};
use crate::plant::{Mechanism, Unreachable};
use crate::random::Random;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS};

/// Peak speed and acceleration of a quintic step of length and duration 1.
const PEAK_SPEED: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Move {
    start: f64,
    duration: f64,
    from: Joints,
    to: Joints,
}

/// The moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Segments {
    first: Joints,
    moves: Vec<Move>,
    grips: Vec<(f64, f64)>,
}

impl Segments {
    /// Random targets within limits; dwells drawn from `dwell_s`.
    ///
    /// # Errors
    /// [`BadInput`] if no reachable target is found.
    pub fn draw(
        mechanism: &Mechanism,
        limits: &MotionLimits,
        duration: f64,
        dwell_s: (f64, f64),
        random: &mut Random,
    ) -> Result<Self, BadInput> {
        let n = mechanism.joints();
        let first = target(mechanism, limits, None, random)?;
        let mut s = Self { first, moves: Vec::new(), grips: Vec::new() };
        let (mut t, mut from) = (random.uniform(dwell_s.0, dwell_s.1), first);
        while t < duration {
            let to = target(mechanism, limits, Some(&from), random)?;
            let time = shortest(&from, &to, limits, n) * random.uniform(1.0, 2.0);
            s.moves.push(Move { start: t, duration: time, from, to });
            t += time + random.uniform(dwell_s.0, dwell_s.1);
            from = to;
        }
        Ok(s)
    }

    /// Back and forth between two poses, an object carried on every way out.
    ///
    /// # Errors
    /// [`BadInput`] if no reachable pose is found.
    pub fn shuttle(
        mechanism: &Mechanism,
        limits: &MotionLimits,
        duration: f64,
        random: &mut Random,
    ) -> Result<Self, BadInput> {
        let n = mechanism.joints();
        let pick = target(mechanism, limits, None, random)?;
        let place = target(mechanism, limits, Some(&pick), random)?;
        let mut s = Self { first: pick, moves: Vec::new(), grips: Vec::new() };
        let mut t = 0.3;
        loop {
            let dwell = random.uniform(0.2, 0.4);
            let out = shortest(&pick, &place, limits, n) * random.uniform(1.0, 1.5);
            let back = shortest(&place, &pick, limits, n) * random.uniform(1.0, 1.5);
            if t + out + back + 2.0 * dwell > duration {
                break;
            }
            s.grips.push((t - 0.5 * dwell.min(t), t + out + 0.5 * dwell));
            s.moves.push(Move { start: t, duration: out, from: pick, to: place });
            t += out + dwell;
            s.moves.push(Move { start: t, duration: back, from: place, to: pick });
            t += back + dwell;
        }
        Ok(s)
    }
}

/// A random pose within limits and workspace, reachable from `from` in a straight joint-space line.
fn target(
    mechanism: &Mechanism,
    limits: &MotionLimits,
    from: Option<&Joints>,
    random: &mut Random,
) -> Result<Joints, BadInput> {
    let n = mechanism.joints();
    for _ in 0..500 {
        let mut to = Joints::default();
        for i in 0..n {
            to[i] = random.uniform(limits.q_min[i], limits.q_max[i]);
        }
        let from = from.unwrap_or(&to);
        let reachable = (0..=20).all(|k| {
            let s = f64::from(k) / 20.0;
            let mut q = Joints::default();
            (0..n).for_each(|i| q[i] = from[i] + s * (to[i] - from[i]));
            mechanism.margin(&q) >= WORKSPACE_MARGIN
        });
        if reachable {
            return Ok(to);
        }
    }
    Err(BadInput::new(
        "reference: found no reachable pose within the joint limits in 500 draws; expected limits around reachable poses",
    ))
}

/// Shortest duration of a quintic move that keeps the limits.
fn shortest(from: &Joints, to: &Joints, limits: &MotionLimits, n: usize) -> f64 {
    let mut time = 0.02f64;
    for i in 0..n {
        let d = (to[i] - from[i]).abs();
        time = time.max(PEAK_SPEED * d / limits.qd_max[i]).max((PEAK_ACCELERATION * d / limits.qdd_max[i]).sqrt());
    }
    time
}

impl Reference for Segments {
    fn at(&self, t: f64) -> Result<Motion, Unreachable> {
        let mut motion = Motion { q: self.first, ..Motion::default() };
        let behind = self.moves.partition_point(|m| m.start <= t);
        if let Some(m) = behind.checked_sub(1).and_then(|k| self.moves.get(k)) {
            let [s, ds, dds] = step((t - m.start) / m.duration);
            for i in 0..MAX_JOINTS {
                let d = m.to[i] - m.from[i];
                motion.q[i] = m.from[i] + d * s;
                motion.qd[i] = d * ds / m.duration;
                motion.qdd[i] = d * dds / (m.duration * m.duration);
            }
        }
        Ok(motion)
    }

    fn grips(&self) -> &[(f64, f64)] {
        &self.grips
    }
}
