//! Robust regression by iteratively reweighted least squares (Huber 1981; Beaton and Tukey 1974).

use super::solve::{Fit, fit_columns, least_squares};
use crate::error::EstimationError;
use crate::stats::{MAD_TO_SD, median_in_place};
use nalgebra::{DMatrix, DVector};

/// How large residuals are weighted. c is in standard deviations of the residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// min(1, c/abs u): bounded influence; convex. 1.345 keeps 95 % efficiency on normal errors.
    Huber(f64),
    /// (1 − (u/c)²)² inside c, else 0: large outliers have no influence. 4.685 keeps 95 % efficiency. Started
    /// from Huber's estimate, since it has local minima.
    Tukey(f64),
}

impl Loss {
    /// Huber's loss at 95 % efficiency.
    pub const HUBER: Self = Self::Huber(1.345);
    /// Tukey's biweight at 95 % efficiency.
    pub const TUKEY: Self = Self::Tukey(4.685);

    fn weight(self, u: f64) -> f64 {
        match self {
            Self::Huber(c) => {
                if u.abs() <= c {
                    1.0
                } else {
                    c / u.abs()
                }
            }
            Self::Tukey(c) => {
                let r = u / c;
                if r.abs() < 1.0 { (1.0 - r * r).powi(2) } else { 0.0 }
            }
        }
    }

    fn tuning(self) -> f64 {
        match self {
            Self::Huber(c) | Self::Tukey(c) => c,
        }
    }
}

/// A robust fit.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustFit {
    /// The weighted fit at convergence (its σ and covariance are those of the weighted problem).
    pub fit: Fit,
    /// Weight of every row, 0 to 1.
    pub weights: Vec<f64>,
    /// Robust standard deviation of the residual (1.4826 MAD about zero).
    pub scale: f64,
    /// Iterations made.
    pub iterations: usize,
    /// Whether β settled to 1e-8 of its own size.
    pub converged: bool,
}

/// Iterations before giving up on convergence.
const MOST_ITERATIONS: usize = 100;

/// Robust regression of `y` on `x` (rows × p). Rows of unequal noise (several joints) must be scaled to equal
/// noise first.
///
/// # Errors
/// As [`least_squares`]; also for a tuning constant that is not positive.
pub fn robust(x: &DMatrix<f64>, y: &DVector<f64>, loss: Loss) -> Result<RobustFit, EstimationError> {
    crate::error::positive("tuning constant", loss.tuning())?;
    let start = least_squares(x, y)?;
    match loss {
        Loss::Huber(_) => reweight(x, y, loss, start),
        Loss::Tukey(_) => {
            let huber = reweight(x, y, Loss::HUBER, start)?;
            reweight(x, y, loss, huber.fit)
        }
    }
}

fn reweight(x: &DMatrix<f64>, y: &DVector<f64>, loss: Loss, start: Fit) -> Result<RobustFit, EstimationError> {
    let mut fit = start;
    let mut weights = vec![1.0; y.len()];
    let mut scale = 0.0;
    for iteration in 1..=MOST_ITERATIONS {
        let residual = y - x * &fit.beta;
        let mut size: Vec<f64> = residual.iter().map(|v| v.abs()).collect();
        scale = MAD_TO_SD * median_in_place(&mut size);
        // More than half the rows fitted exactly: nothing is left to weigh.
        if scale.is_nan() || scale <= 0.0 {
            return Ok(RobustFit { fit, weights, scale, iterations: iteration, converged: true });
        }
        for (w, r) in weights.iter_mut().zip(residual.iter()) {
            *w = loss.weight(r / scale);
        }
        let next = fit_columns(x, y.as_view(), Some(&weights))?;
        let change = (&next.beta - &fit.beta).amax();
        let size = next.beta.amax();
        fit = next;
        if change <= 1e-8 * size.max(f64::MIN_POSITIVE) {
            return Ok(RobustFit { fit, weights, scale, iterations: iteration, converged: true });
        }
    }
    Ok(RobustFit { fit, weights, scale, iterations: MOST_ITERATIONS, converged: false })
}
