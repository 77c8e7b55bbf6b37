//! The robot's controller: PD on the encoder reading with nominal feed-forward, every 0.25 ms.

use crate::plant::{JointMatrix, Loads, TrueRobot, Unreachable};
use crate::reference::Motion;
use lacuna_interfaces::robot::RobotFile;
use lacuna_interfaces::{BadInput, Joints};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// How the controller is tuned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlConfig {
    /// Controller rate [Hz].
    pub rate_hz: f64,
    /// Simulation steps per controller period.
    pub substeps: u32,
    /// Closed-loop bandwidth on the nominal inertia [Hz].
    pub bandwidth_hz: f64,
    /// Damping ratio.
    pub damping: f64,
    /// Corner of the velocity filter [Hz].
    pub velocity_filter_hz: f64,
}

impl Default for ControlConfig {
    fn default() -> Self {
        Self { rate_hz: 4000.0, substeps: 4, bandwidth_hz: 12.0, damping: 0.9, velocity_filter_hz: 400.0 }
    }
}

impl ControlConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`BadInput`] naming the key.
    pub fn validate(&self) -> Result<(), BadInput> {
        for (key, v, low, high) in [
            ("control.rate_hz", self.rate_hz, 100.0, 1e5),
            ("control.substeps", f64::from(self.substeps), 1.0, 64.0),
            ("control.bandwidth_hz", self.bandwidth_hz, 0.1, 0.05 * self.rate_hz),
            ("control.damping", self.damping, 0.1, 3.0),
            ("control.velocity_filter_hz", self.velocity_filter_hz, 10.0, 0.25 * self.rate_hz),
        ] {
            if !(v >= low && v <= high) {
                return Err(BadInput::new(format!("{key}: found {v}; expected {low} to {high}")));
            }
        }
        Ok(())
    }
}

/// Gains and memory.
#[derive(Debug, Clone)]
pub struct Controller<'a> {
    model: &'a TrueRobot,
    loads: Loads,
    kp: Joints,
    kd: Joints,
    limit: Joints,
    last: Option<Joints>,
    speed: Joints,
    period: f64,
    blend: f64,
}

/// Largest period · λ(M⁻¹ K_d) at which the sampled velocity loop is well damped.
const SAMPLED_GAIN: f64 = 0.25;

/// Largest eigenvalue of M⁻¹ diag(kd) [1/s], by power iteration.
fn fastest_mode(inverse: &JointMatrix, kd: &Joints, n: usize) -> f64 {
    let mut x = [1.0; lacuna_interfaces::MAX_JOINTS];
    let mut largest = 0.0;
    for k in 0..60 {
        // Starting directions that differ: the fastest mode may be square to a constant one.
        let mut y = Joints::default();
        for i in 0..n {
            y[i] =
                (0..n).map(|j| inverse[i][j] * kd[j] * x[j]).sum::<f64>() + if k == 0 { 0.1 * i as f64 } else { 0.0 };
        }
        largest = y[..n].iter().fold(0.0f64, |m, v| m.max(v.abs()));
        x = y.map(|v| v / largest.max(f64::MIN_POSITIVE));
    }
    largest
}

/// Largest kd · period / J_r at which a sampled velocity loop on the bare rotor is well damped.
const ROTOR_GAIN: f64 = 0.3;

/// Peak torque of a servo over its rated torque.
const PEAK_OVER_RATED: f64 = 3.0;

impl<'a> Controller<'a> {
    /// A controller tuned on the inertia of `model`, the nominal robot, at the pose `q`. Where `truth` has a
    /// spring, the gain is what the rotor alone bears: whoever commissions a drive turns it down until it
    /// stops singing.
    ///
    /// # Errors
    /// [`BadInput`] if the pose does not exist or a joint has no inertia.
    pub fn new(
        config: &ControlConfig,
        model: &'a TrueRobot,
        truth: &TrueRobot,
        robot: &RobotFile,
        q: &Joints,
    ) -> Result<Self, BadInput> {
        let (inertia, inverse) = model.inertia(q)?;
        let omega = TAU * config.bandwidth_hz;
        let mut limit = [f64::INFINITY; lacuna_interfaces::MAX_JOINTS];
        if let Some(rated) = &robot.drive.rated_torque_nm {
            for (i, l) in limit.iter_mut().enumerate() {
                *l = rated.get(i).map_or(f64::INFINITY, |r| PEAK_OVER_RATED * r);
            }
        }
        let period = 1.0 / config.rate_hz;
        let (mut kp, mut kd) = (Joints::default(), Joints::default());
        for i in 0..model.joints.len() {
            kp[i] = inertia[i][i] * omega * omega;
            kd[i] = 2.0 * config.damping * omega * inertia[i][i];
        }
        // A light wrist on a heavy arm moves faster under its gain than the arm's inertia makes believe.
        let fastest = fastest_mode(&inverse, &kd, model.joints.len());
        let share = (SAMPLED_GAIN / (period * fastest)).min(1.0);
        kp.iter_mut().for_each(|k| *k *= share * share);
        kd.iter_mut().for_each(|k| *k *= share);
        for (i, joint) in truth.joints.iter().enumerate().filter(|(_, j)| j.transmission.is_some()) {
            let share = (ROTOR_GAIN * joint.rotor / (period * kd[i])).min(1.0);
            kd[i] *= share;
            kp[i] *= share * share;
        }
        Ok(Self {
            model,
            loads: model.loads(0.0, &[]),
            kp,
            kd,
            limit,
            last: None,
            speed: Joints::default(),
            period,
            blend: 1.0 - (-TAU * config.velocity_filter_hz * period).exp(),
        })
    }

    /// Torque command for an encoder reading.
    ///
    /// # Errors
    /// [`Unreachable`] if the reference has no nominal torque.
    pub fn command(&mut self, reading: &Joints, reference: &Motion) -> Result<Joints, Unreachable> {
        let mut u = self.model.mechanism.inverse(&reference.q, &reference.qd, &reference.qdd, &self.loads)?;
        for (i, joint) in self.model.joints.iter().enumerate() {
            if let Some(last) = &self.last {
                let raw = (reading[i] - last[i]) / self.period;
                self.speed[i] += self.blend * (raw - self.speed[i]);
            }
            u[i] += joint.rotor * reference.qdd[i]
                + self.kp[i] * (reference.q[i] - reading[i])
                + self.kd[i] * (reference.qd[i] - self.speed[i]);
            u[i] = u[i].clamp(-self.limit[i], self.limit[i]);
        }
        self.last = Some(*reading);
        Ok(u)
    }
}
