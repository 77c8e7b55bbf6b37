//! Covariance of β when the residual is correlated in time.

use super::solve::Fit;
use crate::error::{EstimationError, same_length};
use nalgebra::{DMatrix, DVector};

/// Heteroskedasticity- and autocorrelation-consistent covariance of β (Newey and West 1987):
/// (XᵀX)⁻¹ S (XᵀX)⁻¹ · n/(n − p), S = Γ_0 + Σ_{l=1..L} (1 − l/(L+1)) (Γ_l + Γ_lᵀ),
/// Γ_l = Σ_t u_t u_{t−l}ᵀ, u_t = x_t e_t.
///
/// Rows are in the order of time; `starts` are the rows at which another recording (or joint) begins, across
/// which nothing correlates. `lags` L: see [`bartlett_bandwidth`].
///
/// # Errors
/// [`EstimationError`] for lengths that do not fit the fit.
pub fn newey_west(
    fit: &Fit,
    x: &DMatrix<f64>,
    y: &DVector<f64>,
    lags: usize,
    starts: &[usize],
) -> Result<DMatrix<f64>, EstimationError> {
    let (n, p) = (x.nrows(), x.ncols());
    same_length("regressor columns", p, fit.beta.len())?;
    same_length("measurements", y.len(), n)?;
    if n <= p {
        return Err(EstimationError::TooShort { what: "autocorrelation-robust covariance", found: n, needed: p + 1 });
    }
    let residual = y - x * &fit.beta;
    // One score a column, so that a lag is an offset between two contiguous ranges.
    let score = DMatrix::from_fn(p, n, |j, t| x[(t, j)] * residual[t]);
    let mut cuts: Vec<usize> = starts.iter().copied().filter(|s| *s > 0 && *s < n).collect();
    cuts.push(0);
    cuts.push(n);
    cuts.sort_unstable();
    cuts.dedup();
    let mut meat = DMatrix::zeros(p, p);
    for range in cuts.windows(2) {
        let (from, len) = (range[0], range[1] - range[0]);
        for lag in 0..=lags.min(len.saturating_sub(1)) {
            let now = score.columns(from + lag, len - lag);
            let then = score.columns(from, len - lag);
            let gamma = now * then.transpose();
            let weight = 1.0 - lag as f64 / (lags + 1) as f64;
            if lag == 0 {
                meat += gamma;
            } else {
                meat += (&gamma + gamma.transpose()) * weight;
            }
        }
    }
    Ok(&fit.inverse_gram * meat * &fit.inverse_gram * (n as f64 / (n - p) as f64))
}

/// Number of lags for [`newey_west`] from the residual itself: the Bartlett plug-in of Andrews (1991, equations
/// 5.2 and 6.4) for a first-order autoregression, L = 1.1447 (α n)^⅓ with α = 4ρ²/(1 − ρ²)².
pub fn bartlett_bandwidth(residual: &[f64]) -> usize {
    let n = residual.len();
    if n < 3 {
        return 0;
    }
    let mean = crate::stats::mean(residual);
    let product: f64 = residual.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum();
    let square: f64 = residual.iter().map(|v| (v - mean) * (v - mean)).sum();
    // Beyond 0.97 the plug-in grows without bound while the estimate of ρ is at its least certain.
    let rho = if square > 0.0 { (product / square).clamp(-0.97, 0.97) } else { 0.0 };
    let alpha = 4.0 * rho * rho / (1.0 - rho * rho).powi(2);
    let lags = 1.1447 * (alpha * n as f64).cbrt();
    (lags.ceil() as usize).min(n - 1)
}
