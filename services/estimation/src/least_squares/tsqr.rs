//! Sufficient statistics by QR, block after block (sequential TSQR: Demmel et al. 2012, section 3).

use super::blocks::Statistics;
use super::solve::{Fit, check_weights};
use crate::error::{EstimationError, same_length};
use nalgebra::{DMatrix, DVectorView};

/// The triangular factor R of \[X y\] over all rows so far. Loses no digits to the condition number of X.
#[derive(Debug, Clone, PartialEq)]
pub struct Tsqr {
    /// Upper triangular, (p + 1) × (p + 1).
    r: DMatrix<f64>,
    rows: u64,
}

/// Rows factored at a time: enough that stacking R on top costs little.
const BLOCK: usize = 512;

impl Tsqr {
    /// No rows yet, `columns` parameters.
    pub fn new(columns: usize) -> Self {
        Self { r: DMatrix::zeros(columns + 1, columns + 1), rows: 0 }
    }

    /// Number of parameters p.
    pub fn columns(&self) -> usize {
        self.r.ncols() - 1
    }

    /// The factor R of X alone, p × p: singular values and column dependence are those of X.
    pub fn regressor_factor(&self) -> DMatrix<f64> {
        let p = self.columns();
        self.r.view((0, 0), (p, p)).into_owned()
    }

    /// The factor R of \[X y\], (p + 1) × (p + 1).
    pub fn factor(&self) -> &DMatrix<f64> {
        &self.r
    }

    /// Adds a matrix and its measurements, with a weight per row if given.
    pub(super) fn add_columns(
        &mut self,
        x: &DMatrix<f64>,
        y: DVectorView<'_, f64>,
        weights: Option<&[f64]>,
    ) -> Result<(), EstimationError> {
        same_length("regressor columns", x.ncols(), self.columns())?;
        let root = |k: usize| weights.map_or(1.0, |w| w[k].sqrt());
        let mut start = 0;
        while start < x.nrows() {
            let count = BLOCK.max(self.r.nrows()).min(x.nrows() - start);
            self.stack(count, |i, j| {
                let k = start + i;
                root(k) * if j < x.ncols() { x[(k, j)] } else { y[k] }
            });
            start += count;
        }
        Ok(())
    }

    /// R ← R factor of \[R; `count` new rows\].
    fn stack(&mut self, count: usize, entry: impl Fn(usize, usize) -> f64) {
        let m = self.r.nrows();
        let stacked = DMatrix::from_fn(m + count, m, |i, j| if i < m { self.r[(i, j)] } else { entry(i - m, j) });
        self.r = stacked.qr().r();
        self.rows += count as u64;
    }

    /// The fit over all rows so far.
    ///
    /// # Errors
    /// [`EstimationError::TooShort`] for no more rows than parameters, [`EstimationError::RankDeficient`] for
    /// dependent columns.
    pub fn solve(&self) -> Result<Fit, EstimationError> {
        Fit::from_triangle(&self.r, self.rows)
    }
}

impl Statistics for Tsqr {
    fn empty(columns: usize) -> Self {
        Self::new(columns)
    }

    fn add_rows(&mut self, x: &[f64], y: &[f64], weights: Option<&[f64]>) -> Result<(), EstimationError> {
        let p = self.columns();
        same_length("regressor entries", x.len(), p * y.len())?;
        if let Some(w) = weights {
            same_length("weights", w.len(), y.len())?;
            check_weights(w)?;
        }
        let root = |k: usize| weights.map_or(1.0, |w| w[k].sqrt());
        let mut start = 0;
        while start < y.len() {
            let count = BLOCK.max(self.r.nrows()).min(y.len() - start);
            self.stack(count, |i, j| {
                let k = start + i;
                root(k) * if j < p { x[k * p + j] } else { y[k] }
            });
            start += count;
        }
        Ok(())
    }

    fn merge(&mut self, other: &Self) {
        let rows = self.rows + other.rows;
        self.stack(other.r.nrows(), |i, j| other.r[(i, j)]);
        self.rows = rows;
    }

    fn rows(&self) -> u64 {
        self.rows
    }

    fn fit(&self) -> Result<Fit, EstimationError> {
        self.solve()
    }
}
