//! Cross products of all columns of a table, so that any regression between them can be made afterwards.
//!
//! Z is rows × m; M = ZᵀZ. A regression of one combination of the columns on others, Z C against Z d, has the normal
//! equations CᵀMC and CᵀMd: which columns to take, or which mixture of them, is decided without a second look at the
//! rows.

use super::gram::Gram;
use crate::error::{EstimationError, same_length};
use nalgebra::{DMatrix, DMatrixView, Dyn};

/// Sum of cross products of m columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    sum: DMatrix<f64>,
}

/// One column of a regression as a mixture: (column of Z, column of the regression, factor).
pub type Mixture = (usize, usize, f64);

/// Rows per matrix product: what stays in the second-level cache.
const BLOCK: usize = 512;

impl Moments {
    /// No rows yet.
    pub fn new(columns: usize) -> Self {
        Self { sum: DMatrix::zeros(columns, columns) }
    }

    /// Number of columns m.
    pub fn columns(&self) -> usize {
        self.sum.ncols()
    }

    /// ZᵀZ so far, m × m.
    pub fn products(&self) -> &DMatrix<f64> {
        &self.sum
    }

    /// Adds rows, row-major, m entries a row.
    ///
    /// # Errors
    /// [`EstimationError::Length`] if the last row is not complete.
    pub fn add_rows(&mut self, z: &[f64]) -> Result<(), EstimationError> {
        let m = self.columns();
        if m == 0 {
            return same_length("entries of rows without columns", z.len(), 0);
        }
        same_length("entries of rows", z.len(), z.len() / m * m)?;
        let mut block = DMatrix::zeros(m, m);
        for part in z.chunks(m * BLOCK) {
            let n = part.len() / m;
            // The same numbers read as columns and as rows. Blocks are summed among themselves first: rounding then grows
            // with the root of their number.
            let left = DMatrixView::from_slice_generic(part, Dyn(m), Dyn(n));
            let right = DMatrixView::from_slice_with_strides_generic(part, Dyn(n), Dyn(m), Dyn(m), Dyn(1));
            block.gemm(1.0, &left, &right, 1.0);
        }
        self.sum += block;
        Ok(())
    }

    /// Adds one row of m entries with a weight; entries beyond m are left out.
    pub fn add_row(&mut self, weight: f64, row: &[f64]) {
        for (mut column, &b) in self.sum.column_iter_mut().zip(row) {
            for (s, &a) in column.iter_mut().zip(row) {
                *s += weight * a * b;
            }
        }
    }

    /// Adds the cross products of further rows of as many columns.
    pub fn merge(&mut self, other: &Self) {
        if other.columns() == self.columns() {
            self.sum += &other.sum;
        }
    }

    /// cᵀMd: sum over the rows of the product of two mixtures, given as (column, factor).
    pub fn product(&self, c: &[(usize, f64)], d: &[(usize, f64)]) -> f64 {
        c.iter().map(|&(i, a)| a * d.iter().map(|&(j, b)| b * self.sum[(i, j)]).sum::<f64>()).sum()
    }

    /// Adds `weight` CᵀMC to `into`.
    pub fn mix_into(&self, into: &mut DMatrix<f64>, mixture: &[Mixture], weight: f64) {
        for &(i, a, f) in mixture {
            for &(j, b, g) in mixture {
                into[(a, b)] += weight * f * g * self.sum[(i, j)];
            }
        }
    }
}

/// Sum of cross products of two tables' columns, AᵀB, row by row alike.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossMoments {
    sum: DMatrix<f64>,
}

impl CrossMoments {
    /// No rows yet, for as many columns on either side.
    pub fn new(left: usize, right: usize) -> Self {
        Self { sum: DMatrix::zeros(left, right) }
    }

    /// AᵀB so far.
    pub fn products(&self) -> &DMatrix<f64> {
        &self.sum
    }

    /// Adds rows of both tables, row-major.
    ///
    /// # Errors
    /// [`EstimationError::Length`] for unequal numbers of rows, or a row that is not complete.
    pub fn add_rows(&mut self, left: &[f64], right: &[f64]) -> Result<(), EstimationError> {
        let (p, m) = self.sum.shape();
        let n = left.len() / p.max(1);
        same_length("entries of the left rows", left.len(), n * p)?;
        same_length("entries of the right rows", right.len(), n * m)?;
        let a = DMatrixView::from_slice_generic(left, Dyn(p), Dyn(n));
        let b = DMatrixView::from_slice_with_strides_generic(right, Dyn(n), Dyn(m), Dyn(m), Dyn(1));
        self.sum.gemm(1.0, &a, &b, 1.0);
        Ok(())
    }

    /// Adds a row of both tables with a weight.
    pub fn add_row(&mut self, weight: f64, left: &[f64], right: &[f64]) {
        for (mut column, &b) in self.sum.column_iter_mut().zip(right) {
            column.iter_mut().zip(left).for_each(|(s, &a)| *s += weight * a * b);
        }
    }

    /// Adds the cross products of further rows of as many columns.
    pub fn merge(&mut self, other: &Self) {
        if other.sum.shape() == self.sum.shape() {
            self.sum += &other.sum;
        }
    }
}

impl Gram {
    /// \[XᵀX Xᵀy\], p × (p + 1).
    pub fn xtx_xty(&self) -> DMatrix<f64> {
        let p = self.columns();
        let mut out = self.xtx().insert_column(p, 0.0);
        out.set_column(p, &self.xty());
        out
    }

    /// The statistics whose cross products \[X y\]ᵀ\[X y\] are known; p + 1 columns, y the last.
    pub fn from_products(products: DMatrix<f64>, rows: u64) -> Self {
        Self::of(products, rows)
    }
}
