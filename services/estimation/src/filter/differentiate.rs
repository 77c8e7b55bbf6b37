//! Derivatives by finite differences that are exact for polynomials.
//!
//! A stencil of m points is exact for polynomials of degree m − 1; on m = 5, 7 points the first derivative's
//! gain stays within 1 % of ω up to 0.13 and 0.19 of the sampling rate. An even number of points (4, 6) gives
//! the derivative half-way between samples, with less amplification of noise at the top of the band.
//! Weights: B. Fornberg, Mathematics of Computation 51 (1988) 699-706.

use crate::error::{EstimationError, increasing, positive, same_length};

/// Which points a regular derivative uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stencil {
    /// Centred on the sample.
    Five,
    /// Half-way between samples k and k + 1; the result is one shorter than the signal.
    SixMidpoint,
    /// Centred on the sample.
    Seven,
}

impl Stencil {
    fn points(self) -> usize {
        match self {
            Self::Five => 5,
            Self::SixMidpoint => 6,
            Self::Seven => 7,
        }
    }
}

/// Weights w with f⁽ᵈ⁾(at) ≈ Σ w_i f(x_i), exact for polynomials of degree < `x.len()`, for `derivative` d = 0, 1, 2, ….
/// All zero if d needs more points than there are. The points must be distinct.
pub fn stencil_weights(x: &[f64], at: f64, derivative: usize) -> Vec<f64> {
    let mut weights = vec![0.0; x.len()];
    let mut table = vec![0.0; x.len() * (derivative + 1)];
    fornberg(x, at, derivative, &mut table, &mut weights);
    weights
}

/// Fornberg's recursion; `table` holds (derivative + 1) rows of `x.len()` weights.
fn fornberg(x: &[f64], at: f64, derivative: usize, table: &mut [f64], weights: &mut [f64]) {
    let n = x.len();
    if n == 0 || derivative >= n {
        weights.fill(0.0);
        return;
    }
    table.fill(0.0);
    table[0] = 1.0;
    let mut c1 = 1.0;
    let mut c4 = x[0] - at;
    for i in 1..n {
        let top = i.min(derivative);
        let mut c2 = 1.0;
        let c5 = c4;
        c4 = x[i] - at;
        for j in 0..i {
            let c3 = x[i] - x[j];
            c2 *= c3;
            if j == i - 1 {
                for d in (1..=top).rev() {
                    table[d * n + i] = c1 * (d as f64 * table[(d - 1) * n + i - 1] - c5 * table[d * n + i - 1]) / c2;
                }
                table[i] = -c1 * c5 * table[i - 1] / c2;
            }
            for d in (1..=top).rev() {
                table[d * n + j] = (c4 * table[d * n + j] - d as f64 * table[(d - 1) * n + j]) / c3;
            }
            table[j] = c4 * table[j] / c3;
        }
        c1 = c2;
    }
    weights.copy_from_slice(&table[derivative * n..]);
}

/// Derivative number `derivative` (1 or 2) of a signal sampled every `period_s` \[signal/sᵈ\]. Near the ends the
/// same number of points is used, off centre. As long as the signal; one shorter for [`Stencil::SixMidpoint`],
/// whose value k belongs to the time between samples k and k + 1.
///
/// # Errors
/// [`EstimationError`] for fewer samples than points, another derivative, or a period that is not positive.
pub fn differentiate(
    x: &[f64],
    period_s: f64,
    stencil: Stencil,
    derivative: usize,
) -> Result<Vec<f64>, EstimationError> {
    let m = stencil.points();
    check_order(derivative)?;
    positive("period_s", period_s)?;
    if x.len() < m {
        return Err(EstimationError::TooShort { what: "differentiator", found: x.len(), needed: m });
    }
    let offset = if m.is_multiple_of(2) { 0.5 } else { 0.0 };
    let half = (m - 1) / 2;
    let grid: Vec<f64> = (0..m).map(|i| i as f64).collect();
    // One set of weights per place in the stencil: all but the middle one serve the ends.
    let scale = period_s.powi(derivative as i32);
    let weights: Vec<Vec<f64>> = (0..m)
        .map(|place| stencil_weights(&grid, place as f64 + offset, derivative).iter().map(|w| w / scale).collect())
        .collect();
    let count = if m.is_multiple_of(2) { x.len() - 1 } else { x.len() };
    let last_start = x.len() - m;
    Ok((0..count)
        .map(|k| {
            let start = k.saturating_sub(half).min(last_start);
            weights[k - start].iter().zip(&x[start..start + m]).map(|(w, v)| w * v).sum()
        })
        .collect())
}

/// Derivative number `derivative` (1 or 2) at every sample of a signal with times `t_s`, by the polynomial
/// through the `points` nearest samples in order.
///
/// # Errors
/// [`EstimationError`] for fewer samples than points, unequal lengths or time that does not increase.
pub fn differentiate_irregular(
    t_s: &[f64],
    x: &[f64],
    points: usize,
    derivative: usize,
) -> Result<Vec<f64>, EstimationError> {
    check_order(derivative)?;
    same_length("signal to differentiate", x.len(), t_s.len())?;
    increasing(t_s)?;
    if !(derivative + 1..=9).contains(&points) {
        let expected = "more points than the derivative's order, at most 9";
        return Err(EstimationError::Setting { what: "stencil points", found: points as f64, expected });
    }
    if x.len() < points {
        return Err(EstimationError::TooShort { what: "differentiator", found: x.len(), needed: points });
    }
    let mut table = vec![0.0; points * (derivative + 1)];
    let mut weights = vec![0.0; points];
    let last_start = x.len() - points;
    Ok((0..x.len())
        .map(|k| {
            let start = k.saturating_sub((points - 1) / 2).min(last_start);
            fornberg(&t_s[start..start + points], t_s[k], derivative, &mut table, &mut weights);
            weights.iter().zip(&x[start..start + points]).map(|(w, v)| w * v).sum()
        })
        .collect())
}

fn check_order(derivative: usize) -> Result<(), EstimationError> {
    if (1..=2).contains(&derivative) {
        Ok(())
    } else {
        Err(EstimationError::Setting { what: "derivative", found: derivative as f64, expected: "1 or 2" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textbook_weights() {
        let w = stencil_weights(&[-2.0, -1.0, 0.0, 1.0, 2.0], 0.0, 1);
        for (a, b) in w.iter().zip([1.0 / 12.0, -2.0 / 3.0, 0.0, 2.0 / 3.0, -1.0 / 12.0]) {
            assert!((a - b).abs() < 1e-15);
        }
        let w = stencil_weights(&[-1.0, 0.0, 1.0], 0.0, 2);
        assert_eq!(w, [1.0, -2.0, 1.0]);
        let w = stencil_weights(&[0.0, 1.0], 0.0, 2);
        assert_eq!(w, [0.0, 0.0]);
    }

    #[test]
    fn polynomials_are_differentiated_exactly() {
        // Degree points − 1 everywhere, the ends included.
        for (stencil, degree) in [(Stencil::Five, 4), (Stencil::SixMidpoint, 5), (Stencil::Seven, 6)] {
            let dt = 0.1;
            let p = |t: f64| t.powi(degree) - 2.0 * t.powi(2) + t;
            let d1 = |t: f64| f64::from(degree) * t.powi(degree - 1) - 4.0 * t + 1.0;
            let d2 = |t: f64| f64::from(degree * (degree - 1)) * t.powi(degree - 2) - 4.0;
            let x: Vec<f64> = (0..20).map(|k| p(k as f64 * dt)).collect();
            let shift = if stencil == Stencil::SixMidpoint { 0.5 } else { 0.0 };
            let y1 = differentiate(&x, dt, stencil, 1).unwrap();
            let y2 = differentiate(&x, dt, stencil, 2).unwrap();
            assert_eq!(y1.len(), if shift > 0.0 { 19 } else { 20 });
            for k in 0..y1.len() {
                let t = (k as f64 + shift) * dt;
                assert!((y1[k] - d1(t)).abs() < 1e-9, "{stencil:?} {k}");
                assert!((y2[k] - d2(t)).abs() < 1e-8, "{stencil:?} {k}");
            }
        }
        let t: Vec<f64> = (0..30).map(|k| k as f64 * 0.05 + 0.01 * (k as f64 * 1.7).sin()).collect();
        let x: Vec<f64> = t.iter().map(|t| t.powi(4)).collect();
        let y = differentiate_irregular(&t, &x, 5, 2).unwrap();
        assert!(t.iter().zip(&y).all(|(t, y)| (y - 12.0 * t * t).abs() < 1e-7));
    }

    #[test]
    fn too_few_samples_are_refused() {
        assert!(differentiate(&[0.0; 6], 0.1, Stencil::Seven, 1).is_err());
        assert!(differentiate(&[0.0; 7], 0.1, Stencil::Seven, 3).is_err());
        assert!(differentiate(&[0.0; 7], f64::NAN, Stencil::Seven, 1).is_err());
        assert!(differentiate_irregular(&[0.0, 1.0, 1.0], &[0.0; 3], 3, 1).is_err());
    }
}
