//! Irregular samples onto a regular grid, decimation, and stretches without gaps.

use super::butterworth::ZeroPhase;
use crate::error::{EstimationError, all_finite, increasing, positive, same_length};
use crate::stats::median_in_place;
use std::ops::Range;

/// How values between samples are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// Straight lines.
    Linear,
    /// Natural cubic spline: two continuous derivatives, second derivative zero at the ends
    /// (`scipy.interpolate.CubicSpline(t, x, bc_type="natural")`).
    Cubic,
}

/// Median step of `t_s` [s]; `None` for fewer than two samples.
pub fn median_step(t_s: &[f64]) -> Option<f64> {
    let mut dt: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).collect();
    if dt.is_empty() { None } else { Some(median_in_place(&mut dt)) }
}

/// Times from `from_s` in steps of `period_s`, none above `to_s` (a rounding error above counts as reached).
/// Empty for a period that is not positive.
pub fn regular_grid(from_s: f64, to_s: f64, period_s: f64) -> Vec<f64> {
    if !(period_s > 0.0 && to_s >= from_s && (to_s - from_s).is_finite()) {
        return Vec::new();
    }
    let steps = ((to_s - from_s) / period_s + 1e-9).floor() as usize;
    (0..=steps).map(|k| from_s + k as f64 * period_s).collect()
}

/// Stretches of `t_s` in which no step is longer than `gap_s`.
pub fn segments(t_s: &[f64], gap_s: f64) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut start = 0;
    for k in 1..=t_s.len() {
        if k == t_s.len() || t_s[k] - t_s[k - 1] > gap_s {
            found.push(start..k);
            start = k;
        }
    }
    found
}

/// Values of the signal `x` with times `t_s` at the ascending times `grid_s`. Times outside the recording take
/// the value of the nearest end (nothing is extrapolated). Interpolates across gaps: cut with [`segments`] first.
///
/// # Errors
/// [`EstimationError`] for unequal lengths, no sample, time that does not increase, or values not finite.
pub fn resample(t_s: &[f64], x: &[f64], grid_s: &[f64], how: Interpolation) -> Result<Vec<f64>, EstimationError> {
    same_length("signal to resample", x.len(), t_s.len())?;
    increasing(t_s)?;
    all_finite("signal to resample", x)?;
    all_finite("grid", grid_s)?;
    if x.is_empty() {
        return Err(EstimationError::TooShort { what: "resampling", found: 0, needed: 1 });
    }
    let bend = match how {
        Interpolation::Cubic if x.len() > 2 => natural_spline(t_s, x),
        _ => vec![0.0; x.len()],
    };
    let last = x.len() - 1;
    let mut k = 0;
    Ok(grid_s
        .iter()
        .map(|&g| {
            if g <= t_s[0] {
                return x[0];
            }
            if g >= t_s[last] {
                return x[last];
            }
            if t_s[k] > g {
                k = 0;
            }
            while t_s[k + 1] <= g {
                k += 1;
            }
            let h = t_s[k + 1] - t_s[k];
            let b = (g - t_s[k]) / h;
            let a = 1.0 - b;
            let curve = (a * a * a - a) * bend[k] + (b * b * b - b) * bend[k + 1];
            a * x[k] + b * x[k + 1] + curve * h * h / 6.0
        })
        .collect())
}

/// Second derivatives of the natural cubic spline at its knots (at least 3): a tridiagonal system.
fn natural_spline(t: &[f64], x: &[f64]) -> Vec<f64> {
    let n = t.len();
    let mut bend = vec![0.0; n];
    let mut above = vec![0.0; n];
    for i in 1..n - 1 {
        let (h0, h1) = (t[i] - t[i - 1], t[i + 1] - t[i]);
        let pivot = 2.0 * (h0 + h1) - h0 * above[i - 1];
        above[i] = h1 / pivot;
        let slope_change = (x[i + 1] - x[i]) / h1 - (x[i] - x[i - 1]) / h0;
        bend[i] = (6.0 * slope_change - h0 * bend[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        bend[i] -= above[i] * bend[i + 1];
    }
    bend
}

/// Every `factor`-th sample of `x`, from the first on, after a zero-phase Butterworth low-pass of order 8 at 0.8
/// of the new Nyquist frequency; `factor` 1 copies.
///
/// # Errors
/// [`EstimationError`] for factor 0, or a signal too short for the filter.
pub fn decimate(x: &[f64], factor: usize) -> Result<Vec<f64>, EstimationError> {
    positive("decimation factor", factor as f64)?;
    if factor == 1 {
        return Ok(x.to_vec());
    }
    let filter = ZeroPhase::butterworth(8, 0.4 / factor as f64, 1.0)?;
    Ok(filter.apply(x)?.into_iter().step_by(factor).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_ends() {
        let t = [0.0, 0.1, 0.25, 0.3, 0.6];
        let x: Vec<f64> = t.iter().map(|t| 2.0 * t - 1.0).collect();
        let grid = [-1.0, 0.0, 0.05, 0.26, 0.6, 2.0];
        for how in [Interpolation::Linear, Interpolation::Cubic] {
            let y = resample(&t, &x, &grid, how).unwrap();
            for (y, e) in y.iter().zip([-1.0, -1.0, -0.9, -0.48, 0.2, 0.2]) {
                assert!((y - e).abs() < 1e-14, "{how:?}");
            }
        }
        assert!(resample(&t, &x[1..], &grid, Interpolation::Linear).is_err());
        assert!(resample(&[], &[], &grid, Interpolation::Linear).is_err());
    }

    #[test]
    fn grids_and_segments() {
        assert_eq!(regular_grid(0.0, 0.3, 0.1).len(), 4);
        assert!(regular_grid(0.0, 1.0, 0.0).is_empty());
        assert_eq!(segments(&[0.0, 0.1, 0.2, 1.0, 1.1], 0.5), [0..3, 3..5]);
        assert!(segments(&[], 0.5).is_empty());
    }

    #[test]
    fn decimation_keeps_the_band() {
        let x: Vec<f64> = (0..2000).map(|k| (k as f64 * 0.02).sin() + 0.3 * (k as f64 * 2.0).sin()).collect();
        let y = decimate(&x, 5).unwrap();
        assert_eq!(y.len(), 400);
        assert!((50..350).all(|k| (y[k] - (k as f64 * 0.1).sin()).abs() < 1e-3));
        assert!(decimate(&x, 0).is_err());
    }
}
