//! Laws that are planted, written out here: nothing of the diagnosis' catalogue is used.

use super::motion::Motion;
use crate::error::Error;
use lacuna_estimation::filter::{Interpolation, resample};
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, RobotFile};
use lacuna_simulate::plant::TrueRobot;

/// A planted effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plant {
    /// exp(−(θ̇/v_s)²) sgn θ̇.
    Stribeck,
    /// θ̇² sgn θ̇.
    ViscousPower,
    /// abs(τ) sgn θ̇.
    LoadFriction,
    /// sin(N θ + φ).
    Cogging,
    /// A constant.
    Offset,
    /// sin(θ − θ_0), on an axis that gravity does not act on.
    GravitySpring,
    /// A point mass at the tip, for a part of the recording.
    Payload,
    /// Torque that comes late.
    Delay,
    /// A torque constant that is off.
    KtScale,
}

/// All of them.
pub const PLANTS: [Plant; 9] = [
    Plant::Stribeck,
    Plant::Cogging,
    Plant::LoadFriction,
    Plant::ViscousPower,
    Plant::Offset,
    Plant::Payload,
    Plant::Delay,
    Plant::GravitySpring,
    Plant::KtScale,
];

impl Plant {
    /// Right names, the catalogue's own first; the others are the same signal.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::Stribeck => &["stribeck"],
            Self::ViscousPower => &["viscous_power"],
            Self::LoadFriction => &["load_friction"],
            Self::Cogging => &["cogging"],
            Self::Offset => &["torque_offset", "coulomb_asym"],
            Self::GravitySpring => &["gravity_spring", "arm_inertia"],
            Self::Payload => &["payload", "payload_ecc"],
            Self::Delay => &["torque_delay"],
            Self::KtScale => &["kt_scale"],
        }
    }

    /// Acts on every joint at once.
    pub fn whole(self) -> bool {
        matches!(self, Self::Payload | Self::Delay)
    }
}

/// Where and how a law is planted.
#[derive(Debug, Clone, Copy)]
pub struct Site<'a> {
    /// Robot.
    pub robot: &'a RobotFile,
    /// Text of its URDF.
    pub urdf: Option<&'a str>,
    /// Joint, 0-based.
    pub joint: usize,
    /// Ripples per joint turn.
    pub order: f64,
    /// Stribeck speed [rad/s].
    pub v_s: f64,
}

/// Below this speed a drive's friction changes sign smoothly, as a joint at rest takes any torque up to its level [rad/s].
const REST: f64 = 0.01;

/// Time constant of the delay that the unit of [`Plant::Delay`] stands for [s].
const DELAY_UNIT_S: f64 = 1e-3;

/// The law with its amplitude 1 along a motion: torque per joint [Nm], one value per sample.
///
/// # Errors
/// If the robot cannot carry a payload there.
pub fn unit(plant: Plant, site: &Site<'_>, motion: &Motion) -> Result<Vec<Vec<f64>>, Error> {
    let n = motion.q.len();
    let samples = motion.t_s.len();
    if plant == Plant::Payload {
        return payload(site, motion);
    }
    let mut torque = vec![vec![0.0; samples]; n];
    if plant == Plant::Delay {
        for (out, tau) in torque.iter_mut().zip(&motion.tau) {
            let late: Vec<f64> = motion.t_s.iter().map(|t| t - DELAY_UNIT_S).collect();
            let delayed = resample(&motion.t_s, tau, &late, Interpolation::Linear)?;
            *out = delayed.iter().zip(tau).map(|(d, t)| d - t).collect();
        }
        return Ok(torque);
    }
    let j = site.joint;
    let (q, qd, tau) = (&motion.q[j], &motion.qd[j], &motion.tau[j]);
    for k in 0..samples {
        let direction = (qd[k] / REST).tanh();
        torque[j][k] = match plant {
            Plant::Stribeck => (-(qd[k] / site.v_s).powi(2)).exp() * direction,
            Plant::ViscousPower => qd[k] * qd[k] * direction,
            Plant::LoadFriction => tau[k].abs() * direction,
            Plant::Cogging => (site.order * q[k] + 0.7).sin(),
            Plant::Offset => 1.0,
            Plant::GravitySpring => (q[k] - 0.4).sin(),
            Plant::KtScale => tau[k],
            Plant::Payload | Plant::Delay => 0.0,
        };
    }
    Ok(torque)
}

/// Part of the recording that the payload is carried in.
const CARRIED: [f64; 2] = [0.35, 0.75];

/// Torque of 1 kg that is carried through the middle of the recording.
fn payload(site: &Site<'_>, motion: &Motion) -> Result<Vec<Vec<f64>>, Error> {
    let (first, span) = match (motion.t_s.first(), motion.t_s.last()) {
        (Some(a), Some(b)) => (*a, b - a),
        _ => return Err(BadInput::new("recording: found no sample; expected some").into()),
    };
    carried(site, motion, first + CARRIED[0] * span, first + CARRIED[1] * span)
}

/// Torque of 1 kg at the tip from `from` to `to` [s], by the simulator's own mechanics: with the mass minus without.
///
/// # Errors
/// If the motion has a pose that the robot cannot take.
pub fn carried(site: &Site<'_>, motion: &Motion, from: f64, to: f64) -> Result<Vec<Vec<f64>>, Error> {
    let robot = TrueRobot::nominal(site.robot, site.urdf)?;
    let n = motion.q.len();
    let empty = robot.loads(0.0, &[]);
    let mut loaded = empty;
    loaded.payload_kg = 1.0;
    let mut torque = vec![vec![0.0; motion.t_s.len()]; n];
    for (k, t) in motion.t_s.iter().enumerate() {
        if !(from..=to).contains(t) {
            continue;
        }
        let at = |columns: &[Vec<f64>]| {
            let mut joints: Joints = [0.0; MAX_JOINTS];
            joints.iter_mut().zip(columns).for_each(|(j, c)| *j = c[k]);
            joints
        };
        let state = [at(&motion.q), at(&motion.qd), at(&motion.qdd)];
        let of = |loads| robot.mechanism.inverse(&state[0], &state[1], &state[2], loads);
        let (Ok(with), Ok(without)) = (of(&loaded), of(&empty)) else {
            return Err(BadInput::new("recording: found a pose that the robot cannot take").into());
        };
        (0..n).for_each(|i| torque[i][k] = with[i] - without[i]);
    }
    Ok(torque)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lacuna_simulate::plant::Mechanism;

    fn pendulum() -> RobotFile {
        RobotFile::parse(
            "kind = \"serial\"\nname = \"p\"\njoints = [\"a\"]\n[env]\ngravity = [9.81, 0.0, 0.0]\n[[dh]]\na = 0.5\n",
        )
        .unwrap()
    }

    fn motion() -> Motion {
        let t_s: Vec<f64> = (0..2000).map(|k| f64::from(k) * 1e-3).collect();
        let of = |f: fn(f64) -> f64| vec![t_s.iter().map(|t| f(*t)).collect::<Vec<f64>>()];
        Motion {
            q: of(|t| (3.0 * t).sin()),
            qd: of(|t| 3.0 * (3.0 * t).cos()),
            qdd: of(|t| -9.0 * (3.0 * t).sin()),
            tau: of(|t| 2.0 * (5.0 * t).sin()),
            t_s,
        }
    }

    #[test]
    fn a_payload_is_a_pendulum_in_closed_form() {
        let robot = pendulum();
        assert!(matches!(TrueRobot::nominal(&robot, None).unwrap().mechanism, Mechanism::Serial(_)));
        let site = Site { robot: &robot, urdf: None, joint: 0, order: 1.0, v_s: 0.1 };
        let m = motion();
        let tau = unit(Plant::Payload, &site, &m).unwrap();
        // x of the base points down: m l² q̈ + m g l sin q.
        for k in [800, 1000, 1400] {
            let expected = 0.25 * m.qdd[0][k] + 9.81 * 0.5 * m.q[0][k].sin();
            assert!((tau[0][k] - expected).abs() < 1e-9, "{k}: {} {expected}", tau[0][k]);
        }
        assert_eq!((tau[0][100], tau[0][1900]), (0.0, 0.0), "not carried at either end");
    }

    #[test]
    fn laws_have_the_signs_that_their_names_promise() {
        let robot = pendulum();
        let site = Site { robot: &robot, urdf: None, joint: 0, order: 12.0, v_s: 0.3 };
        let m = motion();
        for plant in [Plant::Stribeck, Plant::ViscousPower, Plant::LoadFriction] {
            let tau = unit(plant, &site, &m).unwrap();
            let power = tau[0].iter().zip(&m.qd[0]).all(|(t, v)| t * v >= 0.0);
            assert!(power, "{plant:?} takes power from the drive, never gives");
        }
        let late = unit(Plant::Delay, &site, &m).unwrap();
        // τ(t − D) − τ(t) ≈ −D dτ/dt.
        for k in [500, 1200] {
            let expected = -1e-3 * 10.0 * (5.0 * m.t_s[k]).cos();
            assert!((late[0][k] - expected).abs() < 3e-5, "{} {expected}", late[0][k]);
        }
    }
}
