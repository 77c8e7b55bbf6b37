//! Sums of sines and chirps about a centre, ramped in and out so that they begin and end at rest.

use super::{Motion, MotionLimits, Reference, WORKSPACE_MARGIN, inside, step, usage};
use crate::plant::{Mechanism, Unreachable};
use crate::random::Random;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS};
use std::f64::consts::TAU;

/// Time to ramp in and out [s].
const RAMP_S: f64 = 0.6;
/// Grid for checking limits [s].
const CHECK_S: f64 = 0.005;

/// Window 0 → 1 → 0 with its first two derivatives.
fn window(t: f64, duration: f64) -> [f64; 3] {
    let ramp = RAMP_S.min(0.25 * duration);
    let [a, da, dda] = step(t / ramp);
    let [b, db, ddb] = step((duration - t) / ramp);
    [a * b, (da * b - a * db) / ramp, (dda * b - 2.0 * da * db + a * ddb) / (ramp * ramp)]
}

/// centre + scale · window · wave, by the product rule.
fn windowed(centre: &Joints, scale: f64, window: [f64; 3], wave: &Motion) -> Motion {
    let [w, dw, ddw] = window;
    let mut m = Motion::default();
    for i in 0..MAX_JOINTS {
        m.q[i] = centre[i] + scale * w * wave.q[i];
        m.qd[i] = scale * (dw * wave.q[i] + w * wave.qd[i]);
        m.qdd[i] = scale * (ddw * wave.q[i] + 2.0 * dw * wave.qd[i] + w * wave.qdd[i]);
    }
    m
}

/// Largest common scale at which `at(scale, t)` keeps limits and workspace, starting from `scale`.
fn fit(
    mechanism: &Mechanism,
    limits: &MotionLimits,
    duration: f64,
    mut scale: f64,
    at: impl Fn(f64, f64) -> Motion,
) -> Result<f64, BadInput> {
    let n = mechanism.joints();
    let ticks = (duration / CHECK_S) as usize;
    for _ in 0..60 {
        let keeps = (0..=ticks).all(|k| {
            let m = at(scale, k as f64 * CHECK_S);
            usage(&m, limits, n) <= 1.0 && inside(&m.q, limits, n) && mechanism.margin(&m.q) >= WORKSPACE_MARGIN
        });
        if keeps {
            return Ok(scale);
        }
        scale *= 0.93;
    }
    Err(BadInput::new(
        "reference: found no amplitude at which the motion stays inside limits and workspace; expected limits around reachable poses",
    ))
}

/// Middle of the joint range, drawn from its inner part.
fn draw_centre(limits: &MotionLimits, n: usize, random: &mut Random) -> Joints {
    let mut centre = Joints::default();
    for i in 0..n {
        centre[i] = limits.q_min[i] + (limits.q_max[i] - limits.q_min[i]) * random.uniform(0.4, 0.6);
    }
    centre
}

/// Sines per joint of a [`Fourier`].
const SINES: usize = 7;

/// Multisine: per joint seven sines of random frequency and phase.
#[derive(Debug, Clone, PartialEq)]
pub struct Fourier {
    centre: Joints,
    scale: f64,
    duration: f64,
    /// (amplitude, angular frequency, phase).
    sines: [[(f64, f64, f64); SINES]; MAX_JOINTS],
}

impl Fourier {
    /// Draws one that uses the limits as far as they go.
    ///
    /// # Errors
    /// [`BadInput`] if none fits.
    pub fn draw(m: &Mechanism, limits: &MotionLimits, duration: f64, random: &mut Random) -> Result<Self, BadInput> {
        let n = m.joints();
        let mut f = Self { centre: draw_centre(limits, n, random), scale: 1.0, duration, sines: Default::default() };
        for i in 0..n {
            let half = 0.5 * (limits.q_max[i] - limits.q_min[i]);
            // Where position and acceleration limits meet is where most of the spectrum belongs.
            let corner = (limits.qdd_max[i] / half).sqrt() / TAU;
            let top = (2.0 * corner).min(6.0 * limits.qd_max[i] / half / TAU);
            for (k, sine) in f.sines[i].iter_mut().enumerate() {
                let frequency = top * random.uniform(k as f64 + 0.2, k as f64 + 1.0) / SINES as f64;
                let roll = 1.0 / (1.0 + (frequency / (0.5 * corner)).powi(2));
                *sine = (half * roll * random.uniform(0.3, 1.0), TAU * frequency, TAU * random.unit());
            }
        }
        f.scale = fit(m, limits, duration, 1.0, |scale, t| f.wave(scale, t))?;
        Ok(f)
    }

    fn wave(&self, scale: f64, t: f64) -> Motion {
        let mut m = Motion::default();
        for (i, sines) in self.sines.iter().enumerate() {
            for &(amplitude, omega, phase) in sines.iter().filter(|s| s.0 != 0.0) {
                let (sin, cos) = (omega * t + phase).sin_cos();
                m.q[i] += amplitude * sin;
                m.qd[i] += amplitude * omega * cos;
                m.qdd[i] -= amplitude * omega * omega * sin;
            }
        }
        windowed(&self.centre, scale, window(t, self.duration), &m)
    }
}

impl Reference for Fourier {
    fn at(&self, t: f64) -> Result<Motion, Unreachable> {
        Ok(self.wave(self.scale, t))
    }
}

/// Sines whose frequency rises with time, one phase and direction per joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Chirp {
    centre: Joints,
    scale: f64,
    duration: f64,
    /// (amplitude, lowest frequency, highest frequency [Hz], phase).
    sweeps: [(f64, f64, f64, f64); MAX_JOINTS],
}

impl Chirp {
    /// Draws one that uses the limits as far as they go.
    ///
    /// # Errors
    /// [`BadInput`] if none fits.
    pub fn draw(m: &Mechanism, limits: &MotionLimits, duration: f64, random: &mut Random) -> Result<Self, BadInput> {
        let n = m.joints();
        let mut c = Self { centre: draw_centre(limits, n, random), scale: 1.0, duration, sweeps: Default::default() };
        for i in 0..n {
            let half = 0.5 * (limits.q_max[i] - limits.q_min[i]);
            let corner = (limits.qdd_max[i] / half).sqrt() / TAU;
            let low = corner * random.uniform(0.1, 0.3);
            c.sweeps[i] =
                (half * random.uniform(0.6, 1.0), low, corner * random.uniform(1.2, 2.0), TAU * random.unit());
        }
        c.scale = fit(m, limits, duration, 1.0, |scale, t| c.wave(scale, t))?;
        Ok(c)
    }

    fn wave(&self, scale: f64, t: f64) -> Motion {
        let mut m = Motion::default();
        for (i, &(amplitude, low, high, phase)) in self.sweeps.iter().enumerate() {
            let rate = (high - low) / self.duration;
            let omega = TAU * (low + rate * t);
            let (sin, cos) = (TAU * (low * t + 0.5 * rate * t * t) + phase).sin_cos();
            m.q[i] = amplitude * sin;
            m.qd[i] = amplitude * omega * cos;
            m.qdd[i] = amplitude * (TAU * rate * cos - omega * omega * sin);
        }
        windowed(&self.centre, scale, window(t, self.duration), &m)
    }
}

impl Reference for Chirp {
    fn at(&self, t: f64) -> Result<Motion, Unreachable> {
        Ok(self.wave(self.scale, t))
    }
}
