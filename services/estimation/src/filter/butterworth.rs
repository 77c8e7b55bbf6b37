//! Zero-phase Butterworth low-pass: forward and backward through second-order sections, as
//! `scipy.signal.sosfiltfilt(butter(order, cutoff, fs=rate, output="sos"), x)` with its default odd padding.
//!
//! ```text
//! analog prototype  abs H(ω)² = 1/(1 + (ω/ω_c)^(2·order)), bilinear with ω_c prewarped: κ = tan(π f_c/f_s)
//! section k         b = κ²/d (1, 2, 1),  a₁ = 2 (κ² − 1)/d,  a₂ = (1 − c κ + κ²)/d,  d = 1 + c κ + κ²,
//!                   c = 2 sin(π (2k − 1)/(2·order));   odd order adds κ/(1 + κ) (1, 1), a₁ = (κ − 1)/(κ + 1)
//! both directions   abs H squared, phase zero: half amplitude at f_c
//! ```
//!
//! Padding: the signal is continued at both ends by its point reflection over 3 (2·sections + 1) samples
//! (3·2·sections for an odd order), and each pass starts in the steady state of its first value (Gustafsson
//! 1996 explains what this leaves at the ends).

use crate::error::{EstimationError, all_finite};

/// One second-order section in transposed direct form II.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Section {
    b: [f64; 3],
    a1: f64,
    a2: f64,
}

impl Section {
    /// State in which a constant input of 1 gives a constant output of 1 (every section has unit gain at 0 Hz).
    fn steady_state(&self) -> [f64; 2] {
        let s2 = self.b[2] - self.a2;
        [self.b[1] - self.a1 + s2, s2]
    }
}

/// A zero-phase Butterworth low-pass for one sampling rate.
#[derive(Debug, Clone, PartialEq)]
pub struct ZeroPhase {
    sections: Vec<Section>,
    pad: usize,
}

/// Columns filtered together: enough to fill the pipeline that one recursion leaves idle.
const LANES: usize = 4;

impl ZeroPhase {
    /// Low-pass of `order` 1 to 12 with half amplitude (−6 dB, both passes together) at `cutoff_hz`, for
    /// signals sampled at `rate_hz`.
    ///
    /// # Errors
    /// [`EstimationError::Setting`] unless 0 < cutoff < rate/2.
    pub fn butterworth(order: usize, cutoff_hz: f64, rate_hz: f64) -> Result<Self, EstimationError> {
        if !(1..=12).contains(&order) {
            return Err(EstimationError::Setting { what: "filter order", found: order as f64, expected: "1 to 12" });
        }
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(EstimationError::Setting { what: "rate_hz", found: rate_hz, expected: "a positive number" });
        }
        if !(cutoff_hz > 0.0 && cutoff_hz < 0.5 * rate_hz) {
            return Err(EstimationError::Setting {
                what: "cutoff_hz",
                found: cutoff_hz,
                expected: "above zero and below half the sampling rate",
            });
        }
        let kappa = (std::f64::consts::PI * cutoff_hz / rate_hz).tan();
        let mut sections = Vec::with_capacity(order.div_ceil(2));
        if order % 2 == 1 {
            let b = kappa / (1.0 + kappa);
            sections.push(Section { b: [b, b, 0.0], a1: (kappa - 1.0) / (kappa + 1.0), a2: 0.0 });
        }
        for k in (1..=order / 2).rev() {
            let c = 2.0 * (std::f64::consts::PI * (2 * k - 1) as f64 / (2 * order) as f64).sin();
            let d = 1.0 + c * kappa + kappa * kappa;
            let b = kappa * kappa / d;
            sections.push(Section {
                b: [b, 2.0 * b, b],
                a1: 2.0 * (kappa * kappa - 1.0) / d,
                a2: (1.0 - c * kappa + kappa * kappa) / d,
            });
        }
        let taps = 2 * sections.len() + 1 - order % 2;
        Ok(Self { sections, pad: 3 * taps })
    }

    /// Fewest samples that can be filtered.
    pub fn min_samples(&self) -> usize {
        self.pad + 1
    }

    /// The filtered signal.
    ///
    /// # Errors
    /// [`EstimationError`] for a signal shorter than [`ZeroPhase::min_samples`] or a sample that is not finite.
    pub fn apply(&self, x: &[f64]) -> Result<Vec<f64>, EstimationError> {
        let mut y = x.to_vec();
        self.apply_in_place(&mut y)?;
        Ok(y)
    }

    /// Filters a signal in place.
    ///
    /// # Errors
    /// As [`ZeroPhase::apply`]; the signal is then unchanged.
    pub fn apply_in_place(&self, x: &mut [f64]) -> Result<(), EstimationError> {
        self.apply_columns(&mut [x])
    }

    /// Filters several signals of equal length in place, four at a time: about three times as fast as one by one.
    ///
    /// # Errors
    /// As [`ZeroPhase::apply`], or for unequal lengths; all signals are then unchanged.
    pub fn apply_columns(&self, columns: &mut [&mut [f64]]) -> Result<(), EstimationError> {
        let Some(len) = columns.first().map(|c| c.len()) else { return Ok(()) };
        if len < self.min_samples() {
            return Err(EstimationError::TooShort {
                what: "zero-phase filter",
                found: len,
                needed: self.min_samples(),
            });
        }
        for column in columns.iter() {
            crate::error::same_length("signals to filter together", column.len(), len)?;
            all_finite("signal to filter", column)?;
        }
        let mut groups = columns.chunks_exact_mut(LANES);
        for group in &mut groups {
            if let [a, b, c, d] = group {
                self.both_ways::<LANES>([a, b, c, d]);
            }
        }
        for column in groups.into_remainder() {
            self.both_ways::<1>([column]);
        }
        Ok(())
    }

    /// Forward and backward over `L` columns of one length, which is at least `min_samples`.
    fn both_ways<const L: usize>(&self, mut x: [&mut [f64]; L]) {
        let pad = self.pad;
        let n = x[0].len();
        // Column-independent length for the optimiser, and the reflected ends before the pass overwrites them.
        let mut head = vec![[0.0; L]; pad];
        let mut tail = vec![[0.0; L]; pad];
        for i in 0..pad {
            for l in 0..L {
                head[i][l] = 2.0 * x[l][0] - x[l][pad - i];
                tail[i][l] = 2.0 * x[l][n - 1] - x[l][n - 2 - i];
            }
        }
        let mut cascade = Cascade::<L>::new(&self.sections, &head[0]);
        for row in &mut head {
            cascade.step(row);
        }
        cascade.run(&mut x, false);
        for row in &mut tail {
            cascade.step(row);
        }
        // The left padding's forward output is not needed: the backward pass ends at sample 0.
        let mut cascade = Cascade::<L>::new(&self.sections, &tail[pad - 1]);
        for row in tail.iter_mut().rev() {
            cascade.step(row);
        }
        cascade.run(&mut x, true);
    }
}

/// The sections with their states for `L` columns in lock step.
struct Cascade<const L: usize> {
    sections: Vec<(Section, [[f64; L]; 2])>,
}

impl<const L: usize> Cascade<L> {
    /// In the steady state of a constant input `first`.
    fn new(sections: &[Section], first: &[f64; L]) -> Self {
        let start = |s: &Section| {
            let unit = s.steady_state();
            (*s, [first.map(|v| unit[0] * v), first.map(|v| unit[1] * v)])
        };
        Self { sections: sections.iter().map(start).collect() }
    }

    #[inline]
    fn step(&mut self, row: &mut [f64; L]) {
        for (s, z) in &mut self.sections {
            for l in 0..L {
                let u = row[l];
                let y = s.b[0] * u + z[0][l];
                z[0][l] = s.b[1] * u - s.a1 * y + z[1][l];
                z[1][l] = s.b[2] * u - s.a2 * y;
                row[l] = y;
            }
        }
    }

    fn run(&mut self, x: &mut [&mut [f64]; L], backward: bool) {
        let n = x.iter().map(|c| c.len()).min().unwrap_or(0);
        for i in 0..n {
            let k = if backward { n - 1 - i } else { i };
            let mut row = std::array::from_fn(|l| x[l][k]);
            self.step(&mut row);
            for l in 0..L {
                x[l][k] = row[l];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_and_line_pass_unchanged() {
        // Point reflection continues a line as a line, and the steady-state start is that of its first value,
        // so a constant is exact; |H| at the frequency of a long sine is |H(f)|² of the formula.
        let filter = ZeroPhase::butterworth(4, 40.0, 1000.0).unwrap();
        let y = filter.apply(&[3.25; 200]).unwrap();
        assert!(y.iter().all(|v| (v - 3.25).abs() < 1e-12));
        let f = 40.0;
        let x: Vec<f64> = (0..4000).map(|k| (std::f64::consts::TAU * f * k as f64 / 1000.0).sin()).collect();
        let y = filter.apply(&x).unwrap();
        let (mut worst, half) = (0.0f64, 0.5);
        for k in 1000..3000 {
            worst = worst.max((y[k] - half * x[k]).abs());
        }
        assert!(worst < 1e-9, "half amplitude and no phase at the cut-off: {worst}");
    }

    #[test]
    fn columns_together_equal_columns_alone() {
        let filter = ZeroPhase::butterworth(3, 15.0, 200.0).unwrap();
        let column = |c: u64| (0..300).map(|k| ((k * k + 7 * c * k) as f64 * 1e-3).sin()).collect::<Vec<f64>>();
        let alone: Vec<Vec<f64>> = (0..6).map(|c| filter.apply(&column(c)).unwrap()).collect();
        let mut together: Vec<Vec<f64>> = (0..6).map(column).collect();
        let mut views: Vec<&mut [f64]> = together.iter_mut().map(Vec::as_mut_slice).collect();
        filter.apply_columns(&mut views).unwrap();
        assert_eq!(alone, together);
    }

    #[test]
    fn bad_settings_and_signals_are_refused() {
        assert!(ZeroPhase::butterworth(0, 1.0, 10.0).is_err());
        assert!(ZeroPhase::butterworth(2, 5.0, 10.0).is_err());
        assert!(ZeroPhase::butterworth(2, f64::NAN, 10.0).is_err());
        let filter = ZeroPhase::butterworth(4, 1.0, 10.0).unwrap();
        assert!(filter.apply(&[0.0; 15]).is_err());
        assert!(filter.apply(&[0.0; 16]).is_ok());
        let mut x = [0.0; 20];
        x[7] = f64::NAN;
        let e = filter.apply(&x).unwrap_err().to_string();
        assert!(e.contains("sample 7"), "{e}");
    }
}
