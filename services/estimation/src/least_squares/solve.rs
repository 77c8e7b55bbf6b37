//! From a triangular factor to parameters, and the plain fit of a matrix in memory.

use super::RANK_TOLERANCE;
use super::tsqr::Tsqr;
use crate::error::{EstimationError, same_length};
use nalgebra::{DMatrix, DVector, DVectorView};

/// A least-squares fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Parameters β, length p.
    pub beta: DVector<f64>,
    /// Covariance of β for independent errors of equal variance, σ² (XᵀX)⁻¹. Too small for errors that are
    /// correlated in time: see [`super::newey_west`], [`super::BlockSums`].
    pub covariance: DMatrix<f64>,
    /// (XᵀX)⁻¹, the "bread" of the robust covariances.
    pub inverse_gram: DMatrix<f64>,
    /// Residual standard deviation σ.
    pub sigma: f64,
    /// Residual sum of squares.
    pub residual_sum: f64,
    /// Rows used.
    pub rows: u64,
    /// Condition number of the column-scaled regressor.
    pub condition: f64,
}

impl Fit {
    /// Standard deviations of β under the fit's own covariance.
    pub fn standard_deviations(&self) -> DVector<f64> {
        self.covariance.diagonal().map(f64::sqrt)
    }

    /// Fit from the upper triangular factor of \[X y\] with `rows` rows.
    pub(super) fn from_triangle(r: &DMatrix<f64>, rows: u64) -> Result<Self, EstimationError> {
        let p = r.ncols().saturating_sub(1);
        if p == 0 || rows <= p as u64 {
            return Err(EstimationError::TooShort { what: "least squares", found: rows as usize, needed: p + 1 });
        }
        let mut scaled = r.view((0, 0), (p, p)).into_owned();
        let scale: Vec<f64> = (0..p).map(|j| scaled.column(j).norm()).collect();
        for j in 0..p {
            if !(scale[j] > 0.0 && scale[j].is_finite()) {
                let rank = scale.iter().filter(|s| **s > 0.0).count();
                return Err(EstimationError::RankDeficient { columns: p, rank, condition: f64::INFINITY });
            }
            scaled.column_mut(j).scale_mut(1.0 / scale[j]);
        }
        let condition = refuse_dependent(&scaled)?;
        let mut z = r.view((0, p), (p, 1)).into_owned();
        let mut inverse = DMatrix::identity(p, p);
        if !(scaled.solve_upper_triangular_mut(&mut z) && scaled.solve_upper_triangular_mut(&mut inverse)) {
            return Err(EstimationError::RankDeficient { columns: p, rank: p - 1, condition });
        }
        let beta = DVector::from_fn(p, |j, _| z[(j, 0)] / scale[j]);
        let mut inverse_gram = &inverse * inverse.transpose();
        for i in 0..p {
            for j in 0..p {
                inverse_gram[(i, j)] /= scale[i] * scale[j];
            }
        }
        let residual_sum = r[(p, p)] * r[(p, p)];
        let variance = residual_sum / (rows - p as u64) as f64;
        let covariance = &inverse_gram * variance;
        Ok(Self { beta, covariance, inverse_gram, sigma: variance.sqrt(), residual_sum, rows, condition })
    }
}

/// Condition number of a square matrix of unit columns, or the error if its rank is short.
fn refuse_dependent(scaled: &DMatrix<f64>) -> Result<f64, EstimationError> {
    let singular = scaled.singular_values();
    let (top, low) = (singular.max(), singular.min());
    let condition = top / low;
    if condition.is_finite() && low > RANK_TOLERANCE * top {
        return Ok(condition);
    }
    let rank = singular.iter().filter(|s| **s > RANK_TOLERANCE * top).count();
    Err(EstimationError::RankDeficient { columns: scaled.ncols(), rank, condition })
}

/// Plain least squares by QR of X (rows × p, column-major).
///
/// # Errors
/// [`EstimationError`] for unequal lengths, no more rows than columns, or dependent columns.
pub fn least_squares(x: &DMatrix<f64>, y: &DVector<f64>) -> Result<Fit, EstimationError> {
    fit_columns(x, y.as_view(), None)
}

/// Least squares with a weight per row (1/variance, up to a common factor): minimises Σ w (y − Xβ)².
///
/// # Errors
/// As [`least_squares`], or for a weight that is negative or not finite.
pub fn weighted_least_squares(x: &DMatrix<f64>, y: &DVector<f64>, weights: &[f64]) -> Result<Fit, EstimationError> {
    fit_columns(x, y.as_view(), Some(weights))
}

pub(super) fn fit_columns(
    x: &DMatrix<f64>,
    y: DVectorView<'_, f64>,
    weights: Option<&[f64]>,
) -> Result<Fit, EstimationError> {
    same_length("measurements", y.len(), x.nrows())?;
    if let Some(w) = weights {
        same_length("weights", w.len(), x.nrows())?;
        check_weights(w)?;
    }
    let mut qr = Tsqr::new(x.ncols());
    qr.add_columns(x, y, weights)?;
    qr.solve()
}

pub(super) fn check_weights(weights: &[f64]) -> Result<(), EstimationError> {
    match weights.iter().find(|w| !(w.is_finite() && **w >= 0.0)) {
        Some(&found) => {
            Err(EstimationError::Setting { what: "row weight", found, expected: "zero or a positive number" })
        }
        None => Ok(()),
    }
}
