//! What the true model leaves of the recordings: the residual that no diagnosis can go below.
//!
//! τ − (hidden torque) − (nominal torque at the motion that zero-phase 60 Hz derivatives of the recorded
//! positions give), then a zero-phase 40 Hz low-pass: sensor noise and what the encoder's noise makes of the
//! acceleration.

use crate::log::Logged;
use crate::plant::TrueRobot;
use crate::truth::pooled_rms;
use lacuna_interfaces::{Joints, Recording};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Corner for positions before differentiation [Hz].
const MOTION_HZ: f64 = 60.0;
/// Corner for the residual [Hz].
const RESIDUAL_HZ: f64 = 40.0;
/// Left out at both ends, where the filters have no past [s].
const EDGE_S: f64 = 0.15;

/// RMS per joint [Nm].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[allow(non_snake_case, reason = "the field names are those of the concealed cases' keys")]
pub struct Oracle {
    /// Residual of the true model.
    pub from_csv_rms: Vec<f64>,
    /// The same below 40 Hz.
    #[serde(rename = "from_csv_rms_40Hz")]
    pub from_csv_rms_40hz: Vec<f64>,
}

impl Oracle {
    /// From recordings and what is behind them; empty where a recording is too short for the filters or the
    /// nominal model has no torque somewhere.
    pub(crate) fn of(nominal: &TrueRobot, recordings: &[Recording], behind: &[Logged]) -> Self {
        let n = nominal.joints.len();
        let mut raw: Vec<Vec<f64>> = vec![Vec::new(); n];
        let mut band: Vec<Vec<f64>> = vec![Vec::new(); n];
        for (recording, logged) in recordings.iter().zip(behind) {
            let Some(period) = recording.median_period_s() else { return Self::default() };
            let Some(residual) = residual(nominal, recording, logged, period) else { return Self::default() };
            let edge = (EDGE_S / period) as usize;
            for (i, r) in residual.iter().enumerate() {
                let filtered = Lowpass::new(RESIDUAL_HZ * period).zero_phase(r);
                let inner = |v: &[f64]| v.get(edge..v.len().saturating_sub(edge)).unwrap_or(&[]).to_vec();
                raw[i].extend(inner(r));
                band[i].extend(inner(&filtered));
            }
        }
        let rms = |columns: &[Vec<f64>]| columns.iter().map(|c| pooled_rms(std::iter::once(c.as_slice()))).collect();
        Self { from_csv_rms: rms(&raw), from_csv_rms_40hz: rms(&band) }
    }
}

fn residual(nominal: &TrueRobot, recording: &Recording, logged: &Logged, period: f64) -> Option<Vec<Vec<f64>>> {
    let n = nominal.joints.len();
    let samples = recording.len();
    if samples < 32 {
        return None;
    }
    let filter = Lowpass::new(MOTION_HZ * period);
    let q: Vec<Vec<f64>> = recording.q_rad.iter().map(|q| filter.zero_phase(q)).collect();
    let qd: Vec<Vec<f64>> = q.iter().map(|q| derivative(q, period)).collect();
    let qdd: Vec<Vec<f64>> = qd.iter().map(|v| derivative(v, period)).collect();
    let loads = nominal.loads(0.0, &[]);
    let mut residual = vec![Vec::with_capacity(samples); n];
    for k in 0..samples {
        let at = |columns: &[Vec<f64>]| {
            let mut j = Joints::default();
            (0..n).for_each(|i| j[i] = columns[i][k]);
            j
        };
        let motion = [at(&q), at(&qd), at(&qdd)];
        let tau = nominal.mechanism.inverse(&motion[0], &motion[1], &motion[2], &loads).ok()?;
        for i in 0..n {
            let known = tau[i] + nominal.joints[i].rotor * motion[2][i];
            residual[i].push(recording.tau_nm[i][k] - logged.hidden_nm[i][k] - known);
        }
    }
    Some(residual)
}

/// Central differences of sixth order; one-sided values at the ends are repeated.
fn derivative(x: &[f64], period: f64) -> Vec<f64> {
    let n = x.len();
    let mut d = vec![0.0; n];
    for k in 3..n.saturating_sub(3) {
        d[k] = (45.0 * (x[k + 1] - x[k - 1]) - 9.0 * (x[k + 2] - x[k - 2]) + (x[k + 3] - x[k - 3])) / (60.0 * period);
    }
    if n > 6 {
        let (first, last) = (d[3], d[n - 4]);
        d[..3].fill(first);
        d[n - 3..].fill(last);
    }
    d
}

/// Fourth-order Butterworth low-pass as two second-order sections.
struct Lowpass {
    sections: Vec<[f64; 5]>,
}

impl Lowpass {
    /// `corner` is the corner frequency times the sample period; at 0.45 and above nothing is filtered.
    fn new(corner: f64) -> Self {
        if corner >= 0.45 {
            return Self { sections: Vec::new() };
        }
        let w = (PI * corner).tan();
        let section = |k: f64| {
            // Poles of the Butterworth prototype at angles π/8 and 3π/8 from the real axis.
            let damping = 2.0 * (TAU * k / 16.0).cos();
            let a0 = 1.0 + damping * w + w * w;
            [w * w / a0, 2.0 * w * w / a0, w * w / a0, 2.0 * (w * w - 1.0) / a0, (1.0 - damping * w + w * w) / a0]
        };
        Self { sections: vec![section(1.0), section(3.0)] }
    }

    /// Forward and backward over the signal, extended by odd reflection.
    fn zero_phase(&self, x: &[f64]) -> Vec<f64> {
        let (Some(&first), Some(&last)) = (x.first(), x.last()) else { return Vec::new() };
        let pad = 300.min(x.len() - 1);
        let mut y: Vec<f64> = (1..=pad).rev().map(|k| 2.0 * first - x[k]).collect();
        y.extend_from_slice(x);
        y.extend((1..=pad).map(|k| 2.0 * last - x[x.len() - 1 - k]));
        for _ in 0..2 {
            for c in &self.sections {
                pass(c, &mut y);
            }
            y.reverse();
        }
        y[pad..pad + x.len()].to_vec()
    }
}

/// One section in place, begun in the steady state of its first value.
fn pass([b0, b1, b2, a1, a2]: &[f64; 5], y: &mut [f64]) {
    let first = y.first().copied().unwrap_or(0.0);
    // Transposed direct form II with unit gain at standstill.
    let mut s2 = first * (b2 - a2);
    let mut s1 = first * (b1 - a1) + s2;
    for v in y {
        let x = *v;
        let out = b0 * x + s1;
        s1 = b1 * x - a1 * out + s2;
        s2 = b2 * x - a2 * out;
        *v = out;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lowpass_has_butterworth_gain_and_no_phase() {
        let period = 1e-3;
        let filter = Lowpass::new(40.0 * period);
        for hz in [2.0, 20.0, 40.0, 80.0] {
            let x: Vec<f64> = (0..6000).map(|k| (TAU * hz * f64::from(k) * period + 0.3).sin()).collect();
            let y = filter.zero_phase(&x);
            let inner = 1000..5000;
            // Both passes together: |H|² = 1 / (1 + (tan ratio)⁸), and the output is that share of the input.
            let ratio = (PI * hz * period).tan() / (PI * 40.0 * period).tan();
            let gain = 1.0 / (1.0 + ratio.powi(8));
            let worst = inner.map(|k| (y[k] - gain * x[k]).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{hz} Hz: {worst:.1e}");
        }
    }

    #[test]
    fn derivative_is_exact_for_a_polynomial() {
        let x: Vec<f64> = (0..40).map(|k| (f64::from(k) * 0.01).powi(3)).collect();
        let d = derivative(&x, 0.01);
        for (k, d) in d.iter().enumerate().take(37).skip(3) {
            assert!((d - 3.0 * (k as f64 * 0.01).powi(2)).abs() < 1e-11);
        }
    }
}
