//! Reference motions: what the robot is told to do.

mod pick_place;
mod sampled;
mod segments;
mod waves;

pub use pick_place::PickPlace;
pub use sampled::Sampled;
pub use segments::Segments;
pub use waves::{Chirp, Fourier};

use crate::plant::{Mechanism, TrueRobot, Unreachable};
use crate::random::Random;
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, Joints, RobotFile};
use serde::{Deserialize, Serialize};

/// Joint positions, velocities and accelerations at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// θ [rad].
    pub q: Joints,
    /// θ̇ [rad/s].
    pub qd: Joints,
    /// θ̈ [rad/s²].
    pub qdd: Joints,
}

/// A reference motion from time 0 on; before 0 and after its end it stands still.
pub trait Reference: Send + Sync + std::fmt::Debug {
    /// The motion at time `t` [s].
    ///
    /// # Errors
    /// [`Unreachable`] where the path leaves the workspace.
    fn at(&self, t: f64) -> Result<Motion, Unreachable>;

    /// Times between which an object is carried [s].
    fn grips(&self) -> &[(f64, f64)] {
        &[]
    }
}

/// Kind of a reference motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kinds {
    /// Multisine on all joints, ramped in and out.
    Fourier,
    /// Random rest-to-rest moves with dwells.
    PointToPoint,
    /// Pick-and-place cycles between two places.
    PickPlace,
    /// Sines of rising frequency.
    Chirp,
    /// Slow rest-to-rest moves, for friction.
    Sweep,
}

/// Limits of position, speed and acceleration per joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Lowest position [rad].
    pub q_min: Joints,
    /// Highest position [rad].
    pub q_max: Joints,
    /// Speed [rad/s].
    pub qd_max: Joints,
    /// Acceleration [rad/s²].
    pub qdd_max: Joints,
}

/// Smallest [`Mechanism::margin`] that a reference may come to.
pub const WORKSPACE_MARGIN: f64 = 0.25;

impl MotionLimits {
    /// The robot file's limits; where it gives none, those of a fast Delta or of a mid-sized arm.
    pub fn of(robot: &RobotFile) -> Self {
        let (lo, hi, speed, acceleration) = match robot.kind {
            Kind::Delta => (-0.5, 1.5, 9.0, 110.0),
            Kind::Serial => (-1.5, 1.5, 2.0, 8.0),
        };
        let mut limits = Self {
            q_min: Joints::default(),
            q_max: Joints::default(),
            qd_max: Joints::default(),
            qdd_max: Joints::default(),
        };
        let l = &robot.limits;
        for i in 0..robot.joint_count().min(limits.q_min.len()) {
            let get = |p: &Option<lacuna_interfaces::robot::PerJoint>, default| {
                p.as_ref().and_then(|p| p.get(i)).unwrap_or(default)
            };
            limits.q_min[i] = get(&l.q_min_rad, lo);
            limits.q_max[i] = get(&l.q_max_rad, hi);
            limits.qd_max[i] = get(&l.qd_max_rad_s, speed);
            limits.qdd_max[i] = get(&l.qdd_max_rad_s2, acceleration);
        }
        limits
    }

    /// Speeds times `share`, accelerations times its square: the same paths, slower.
    #[must_use]
    pub fn slowed(mut self, share: f64) -> Self {
        self.qd_max.iter_mut().for_each(|v| *v *= share);
        self.qdd_max.iter_mut().for_each(|v| *v *= share * share);
        self
    }
}

/// Largest share of the limits that `motion` uses; positions are not scaled and count apart.
fn usage(motion: &Motion, limits: &MotionLimits, n: usize) -> f64 {
    (0..n)
        .map(|i| (motion.qd[i].abs() / limits.qd_max[i]).max(motion.qdd[i].abs() / limits.qdd_max[i]))
        .fold(0.0, f64::max)
}

fn inside(q: &Joints, limits: &MotionLimits, n: usize) -> bool {
    (0..n).all(|i| q[i] >= limits.q_min[i] && q[i] <= limits.q_max[i])
}

/// Quintic step from 0 to 1 over 0 … 1 with its first two derivatives.
fn step(s: f64) -> [f64; 3] {
    if s <= 0.0 {
        return [0.0; 3];
    }
    if s >= 1.0 {
        return [1.0, 0.0, 0.0];
    }
    let u = s * (1.0 - s);
    [s * s * s * (10.0 + s * (6.0 * s - 15.0)), 30.0 * u * u, 60.0 * u * (1.0 - 2.0 * s)]
}

/// Draws a reference of `kind` that stays within limits and workspace.
///
/// `intensity` (0 to 1) is the share of the speed limits that it may use.
///
/// # Errors
/// [`BadInput`] if no such motion is found, or pick-and-place is asked of limits that do not hold the path.
pub fn draw(
    kind: Kinds,
    robot: &TrueRobot,
    limits: &MotionLimits,
    duration_s: f64,
    intensity: f64,
    random: &mut Random,
) -> Result<Box<dyn Reference>, BadInput> {
    let mechanism = &robot.mechanism;
    let n = mechanism.joints();
    let slowed = limits.slowed(intensity);
    Ok(match kind {
        Kinds::Fourier => Box::new(Fourier::draw(mechanism, &slowed, duration_s, random)?),
        Kinds::Chirp => Box::new(Chirp::draw(mechanism, &slowed, duration_s, random)?),
        Kinds::PointToPoint => Box::new(Segments::draw(mechanism, &slowed, duration_s, (0.05, 0.5), random)?),
        Kinds::Sweep => {
            // From a crawl to a tenth of full speed: where friction laws differ.
            let mut slow = slowed;
            for i in 0..n {
                slow.qd_max[i] *= 0.1 * random.log_uniform(0.2, 1.0);
            }
            Box::new(Segments::draw(mechanism, &slow, duration_s, (0.0, 0.1), random)?)
        }
        Kinds::PickPlace => match mechanism {
            Mechanism::Delta(delta) => Box::new(PickPlace::draw(delta, &slowed, duration_s, random)?),
            Mechanism::Serial(_) => Box::new(Segments::shuttle(mechanism, &slowed, duration_s, random)?),
        },
    })
}
