//! An effect along a whole recording: one column per amplitude and joint.

use super::kernel::{ColumnSink, EffectSample, Kernel};
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS};

/// A motion along time with what effects need of it: `signal[joint][sample]`.
#[derive(Debug, Clone, Copy)]
pub struct Track<'a> {
    /// Time [s], increasing; length `len`.
    pub t_s: &'a [f64],
    /// Added to `t_s`: time of the track's zero on the clock that events and warming up count on [s].
    pub start_s: f64,
    /// Joint positions [rad].
    pub q_rad: &'a [Vec<f64>],
    /// Joint velocities [rad/s].
    pub qd_rad_s: &'a [Vec<f64>],
    /// Joint accelerations [rad/s²].
    pub qdd_rad_s2: &'a [Vec<f64>],
    /// sgn θ̇ with the caller's treatment of standstill.
    pub direction: &'a [Vec<f64>],
    /// See [`EffectSample::ramp_rad_s`].
    pub ramp_rad_s: f64,
    /// See [`EffectSample::tau_link_nm`].
    pub tau_link_nm: &'a [Vec<f64>],
    /// See [`EffectSample::tau_drive_nm`].
    pub tau_drive_nm: &'a [Vec<f64>],
    /// Temperatures [°C]; empty if there are none.
    pub temperature_degc: &'a [Vec<f64>],
    /// Samples before which something is missing: memories start anew there. Increasing.
    pub resets: &'a [usize],
}

impl Track<'_> {
    fn check(&self, n: usize) -> Result<(), BadInput> {
        let len = self.t_s.len();
        for (name, signal) in [
            ("q_rad", self.q_rad),
            ("qd_rad_s", self.qd_rad_s),
            ("qdd_rad_s2", self.qdd_rad_s2),
            ("direction", self.direction),
            ("tau_link_nm", self.tau_link_nm),
            ("tau_drive_nm", self.tau_drive_nm),
            ("temperature_degc", self.temperature_degc),
        ] {
            if name == "temperature_degc" && signal.is_empty() {
                continue;
            }
            if signal.len() != n {
                return Err(BadInput::new(format!("{name}: found {} joints; expected {n}", signal.len())));
            }
            if let Some(j) = signal.iter().position(|s| s.len() != len) {
                return Err(BadInput::new(format!(
                    "{name}: found {} samples of joint {}; expected {len}",
                    signal[j].len(),
                    j + 1
                )));
            }
        }
        Ok(())
    }
}

/// Torque per unit of each amplitude along a recording [Nm per unit of the amplitude].
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    symbols: Vec<&'static str>,
    joints: usize,
    samples: usize,
    /// Column after column, joint after joint, along time.
    values: Vec<f64>,
}

impl Columns {
    pub(super) fn along(
        kernel: &mut dyn Kernel,
        symbols: Vec<&'static str>,
        n: usize,
        track: &Track<'_>,
    ) -> Result<Self, BadInput> {
        track.check(n)?;
        let samples = track.t_s.len();
        let mut out = Self { joints: n, samples, values: vec![0.0; symbols.len().max(1) * n * samples], symbols };
        let mut scratch = vec![0.0; out.count() * n];
        let mut resets = track.resets.iter().peekable();
        let mut last_t = None;
        kernel.reset();
        for k in 0..samples {
            while resets.next_if(|&&r| r <= k).is_some() {
                kernel.reset();
                last_t = None;
            }
            let t = track.t_s[k];
            let at = |signal: &[Vec<f64>], absent: f64| -> Joints {
                std::array::from_fn(|j| signal.get(j).map_or(absent, |s| s[k]))
            };
            let (q, qd, qdd) = (at(track.q_rad, 0.0), at(track.qd_rad_s, 0.0), at(track.qdd_rad_s2, 0.0));
            let sample = EffectSample {
                t_s: track.start_s + t,
                dt_s: last_t.map_or(0.0, |last| t - last),
                q_rad: &q,
                qd_rad_s: &qd,
                qdd_rad_s2: &qdd,
                direction: &at(track.direction, 0.0),
                ramp_rad_s: track.ramp_rad_s,
                tau_link_nm: &at(track.tau_link_nm, 0.0),
                tau_drive_nm: &at(track.tau_drive_nm, 0.0),
                temperature_degc: &at(track.temperature_degc, f64::NAN),
            };
            kernel.columns(&sample, &mut ColumnSink::new(n, &mut scratch));
            for (row, v) in scratch.iter().enumerate() {
                out.values[row * samples + k] = if v.is_finite() { *v } else { 0.0 };
            }
            last_t = Some(t);
        }
        Ok(out)
    }

    /// Number of columns: one per amplitude, or one with the factor 1.
    pub fn count(&self) -> usize {
        self.symbols.len().max(1)
    }

    /// Symbols of the amplitudes, in column order; empty for an effect whose one column has the factor 1.
    pub fn symbols(&self) -> &[&'static str] {
        &self.symbols
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.joints
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.samples
    }

    /// True if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.samples == 0
    }

    /// Torque at `joint` per unit of amplitude `column`, along time; empty for a column or joint that does not
    /// exist.
    pub fn column(&self, column: usize, joint: usize) -> &[f64] {
        if column >= self.count() || joint >= self.joints.min(MAX_JOINTS) {
            return &[];
        }
        let start = (column * self.joints + joint) * self.samples;
        self.values.get(start..start + self.samples).unwrap_or(&[])
    }
}
