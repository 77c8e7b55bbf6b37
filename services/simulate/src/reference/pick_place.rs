//! Pick-and-place of a Delta between two conveyors: up, over, down, in Cartesian space, with the corners
//! rounded by letting the horizontal way begin before the lift has ended. Twice continuously differentiable.

use super::{Motion, MotionLimits, Reference, WORKSPACE_MARGIN, inside, step, usage};
use crate::plant::{Delta, Unreachable};
use crate::random::Random;
use lacuna_interfaces::BadInput;
use nalgebra::Vector3;

type V3 = Vector3<f64>;

/// One way: from one place up, over, and down on another.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Way {
    start: f64,
    duration: f64,
    from: V3,
    to: V3,
    lift: f64,
}

/// Share of a way in which the platform rises, and again in which it sinks.
const VERTICAL: f64 = 0.42;
/// Share of a way after which the horizontal move begins, and before whose end it ends.
const CORNER: f64 = 0.16;

impl Way {
    fn at(&self, t: f64) -> [V3; 3] {
        let s = (t - self.start) / self.duration;
        let up = step(s / VERTICAL);
        let down = step((s - 1.0 + VERTICAL) / VERTICAL);
        let over = step((s - CORNER) / (1.0 - 2.0 * CORNER));
        let mut motion = [V3::zeros(); 3];
        for (order, m) in motion.iter_mut().enumerate() {
            let vertical = (VERTICAL * self.duration).powi(order as i32);
            let horizontal = ((1.0 - 2.0 * CORNER) * self.duration).powi(order as i32);
            *m = (self.to - self.from) * (over[order] / horizontal);
            m.z += self.lift * (up[order] - down[order]) / vertical;
        }
        motion[0] += self.from;
        motion
    }
}

/// The cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct PickPlace {
    delta: Delta,
    home: V3,
    ways: Vec<Way>,
    grips: Vec<(f64, f64)>,
}

impl PickPlace {
    /// Draws conveyors in the middle of the workspace and cycles between them as fast as the limits allow.
    ///
    /// # Errors
    /// [`BadInput`] if the limits do not hold such a path.
    pub fn draw(delta: &Delta, limits: &MotionLimits, duration: f64, random: &mut Random) -> Result<Self, BadInput> {
        let none = || {
            BadInput::new(
                "reference: found no pick-and-place path within limits and workspace; expected limits around reachable poses",
            )
        };
        let mut q = lacuna_interfaces::Joints::default();
        for i in 0..3 {
            q[i] = 0.45 * limits.q_min[i] + 0.55 * limits.q_max[i];
        }
        let middle = delta.forward(&q).map_err(|_| none())?;
        let reach = delta.forearm[0].length;
        let heading = random.uniform(0.0, std::f64::consts::TAU);
        let (sin, cos) = heading.sin_cos();
        let across = V3::new(cos, sin, 0.0);
        let along = V3::new(-sin, cos, 0.0);
        let mut span = reach * random.uniform(0.30, 0.38);
        for _ in 0..20 {
            let place = |side: f64, r: &mut Random| {
                middle + across * (side * span) + along * (0.2 * span * r.uniform(-1.0, 1.0))
            };
            let lift = span * random.uniform(0.25, 0.4);
            let down = V3::new(0.0, 0.0, -0.5 * lift);
            let ends = [(place(-1.0, random) + down, place(1.0, random) + down)];
            if let Some(path) = Self::cycles(delta, limits, duration, &ends, lift, random) {
                return Ok(path);
            }
            span *= 0.9;
        }
        Err(none())
    }

    fn cycles(
        delta: &Delta,
        limits: &MotionLimits,
        duration: f64,
        ends: &[(V3, V3)],
        lift: f64,
        random: &mut Random,
    ) -> Option<Self> {
        let (pick, place) = *ends.first()?;
        // Speeds scale with 1/T, accelerations with 1/T²: one trial way tells how long a way must last.
        let trial = Way { start: 0.0, duration: 1.0, from: pick, to: place, lift };
        let back = Way { from: place, to: pick, ..trial };
        let mut shortest = 0.05f64;
        for k in 0..=200 {
            for way in [&trial, &back] {
                let m = joint_motion(delta, way.at(f64::from(k) / 200.0)).ok()?;
                if !inside(&m.q, limits, 3) || delta.margin(&m.q) < WORKSPACE_MARGIN {
                    return None;
                }
                let still = Motion { qdd: Default::default(), ..m };
                let pushed = Motion { qd: Default::default(), ..m };
                shortest = shortest.max(usage(&still, limits, 3)).max(usage(&pushed, limits, 3).sqrt());
            }
        }
        let mut path = Self { delta: delta.clone(), home: pick, ways: Vec::new(), grips: Vec::new() };
        let mut t = random.uniform(0.4, 0.6);
        loop {
            let dwell = [0; 2].map(|_| random.uniform(0.12, 0.3));
            let last = [0; 2].map(|_| shortest * random.uniform(1.0, 1.5));
            if t + dwell[0] + dwell[1] + last[0] + last[1] > duration {
                break;
            }
            let out = Way { start: t + 0.5 * dwell[0], duration: last[0], ..trial };
            let placed = out.start + last[0] + 0.5 * dwell[1];
            path.grips.push((t, placed));
            path.ways.push(out);
            let home = Way { start: placed + 0.5 * dwell[1], duration: last[1], ..back };
            t = home.start + last[1] + 0.5 * dwell[0];
            path.ways.push(home);
        }
        Some(path)
    }
}

fn joint_motion(delta: &Delta, [x, xd, xdd]: [V3; 3]) -> Result<Motion, Unreachable> {
    let [q, qd, qdd] = delta.inverse_motion(&x, &xd, &xdd)?;
    Ok(Motion { q, qd, qdd })
}

impl Reference for PickPlace {
    fn at(&self, t: f64) -> Result<Motion, Unreachable> {
        let behind = self.ways.partition_point(|w| w.start <= t);
        let state = match behind.checked_sub(1).and_then(|k| self.ways.get(k)) {
            Some(way) => way.at(t),
            None => [self.home, V3::zeros(), V3::zeros()],
        };
        joint_motion(&self.delta, state)
    }

    fn grips(&self) -> &[(f64, f64)] {
        &self.grips
    }
}
