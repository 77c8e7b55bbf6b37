//! Sufficient statistics as normal equations, guarded.

use super::blocks::Statistics;
use super::solve::{Fit, check_weights};
use super::{GRAM_CONDITION_LIMIT, RANK_TOLERANCE};
use crate::error::{EstimationError, same_length};
use nalgebra::{DMatrix, DMatrixView, DVector, Dyn};

/// XᵀX, Xᵀy and yᵀy over all rows so far.
///
/// Rows enter in blocks through a matrix product (cache-blocked, with the machine's vector units), block
/// sums are added with compensation (Neumaier 1974), so that rounding does not grow with the recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Gram {
    /// \[X y\]ᵀ\[X y\], (p + 1) × (p + 1), symmetric.
    sum: DMatrix<f64>,
    /// What rounding took from `sum` so far.
    lost: DMatrix<f64>,
    rows: u64,
}

/// Rows per matrix product: a block of 20 columns stays in the second-level cache.
const BLOCK: usize = 1024;

impl Gram {
    /// No rows yet, `columns` parameters.
    pub fn new(columns: usize) -> Self {
        let m = columns + 1;
        Self { sum: DMatrix::zeros(m, m), lost: DMatrix::zeros(m, m), rows: 0 }
    }

    pub(super) fn of(sum: DMatrix<f64>, rows: u64) -> Self {
        // An empty matrix would have no place for y.
        let sum = if sum.is_empty() { DMatrix::zeros(1, 1) } else { sum };
        Self { lost: DMatrix::zeros(sum.nrows(), sum.ncols()), sum, rows }
    }

    /// Number of parameters p.
    pub fn columns(&self) -> usize {
        self.sum.ncols() - 1
    }

    /// XᵀX, p × p.
    pub fn xtx(&self) -> DMatrix<f64> {
        let p = self.columns();
        (self.sum.view((0, 0), (p, p))) + self.lost.view((0, 0), (p, p))
    }

    /// Xᵀy, length p.
    pub fn xty(&self) -> DVector<f64> {
        let p = self.columns();
        DVector::from_fn(p, |j, _| self.sum[(j, p)] + self.lost[(j, p)])
    }

    /// yᵀy.
    pub fn yty(&self) -> f64 {
        let p = self.columns();
        self.sum[(p, p)] + self.lost[(p, p)]
    }

    /// Σ (y − Xβ)², from the statistics. Accurate to about 1e-15 yᵀy, not to 1e-15 of itself.
    pub fn residual_sum(&self, beta: &DVector<f64>) -> f64 {
        (self.yty() - 2.0 * beta.dot(&self.xty()) + beta.dot(&(self.xtx() * beta))).max(0.0)
    }

    /// Xᵀ(y − Xβ): the score of β.
    pub fn score(&self, beta: &DVector<f64>) -> DVector<f64> {
        self.xty() - self.xtx() * beta
    }

    /// The statistics of the chosen columns alone (p' parameters, in the order given); a fit on a subset of
    /// the columns needs no second pass. Columns beyond p are left out.
    pub fn select(&self, columns: &[usize]) -> Self {
        let p = self.columns();
        let mut keep: Vec<usize> = columns.iter().copied().filter(|c| *c < p).collect();
        keep.push(p);
        let pick = |m: &DMatrix<f64>| DMatrix::from_fn(keep.len(), keep.len(), |i, j| m[(keep[i], keep[j])]);
        Self { sum: pick(&self.sum), lost: pick(&self.lost), rows: self.rows }
    }

    /// The statistics minus those of `part`, which must have been merged into it: what a fold that leaves
    /// `part` out is fitted on.
    ///
    /// # Errors
    /// [`EstimationError::Length`] for another number of columns or more rows than there are.
    pub fn without(&self, part: &Self) -> Result<Self, EstimationError> {
        same_length("columns of the part", part.columns(), self.columns())?;
        let rows = self.rows.checked_sub(part.rows).ok_or(EstimationError::Length {
            what: "rows of the part",
            found: part.rows as usize,
            expected: self.rows as usize,
        })?;
        let sum = &self.sum - &part.sum + (&self.lost - &part.lost);
        Ok(Self { lost: DMatrix::zeros(sum.nrows(), sum.ncols()), sum, rows })
    }

    /// Condition number of the column-scaled regressor; infinite where a column is zero.
    pub fn condition(&self) -> f64 {
        self.scaled().map_or(f64::INFINITY, |(scaled, _)| condition_of(&scaled))
    }

    /// XᵀX with unit diagonal, and the column lengths.
    fn scaled(&self) -> Option<(DMatrix<f64>, Vec<f64>)> {
        let mut g = self.xtx();
        let scale: Vec<f64> = g.diagonal().iter().map(|d| d.sqrt()).collect();
        if scale.iter().any(|s| !(*s > 0.0 && s.is_finite())) {
            return None;
        }
        for i in 0..g.nrows() {
            for j in 0..g.ncols() {
                g[(i, j)] /= scale[i] * scale[j];
            }
        }
        Some((g, scale))
    }

    /// The fit over all rows so far.
    ///
    /// # Errors
    /// [`EstimationError::TooShort`] for no more rows than parameters, [`EstimationError::RankDeficient`] for
    /// dependent columns, [`EstimationError::IllConditioned`] above [`GRAM_CONDITION_LIMIT`].
    pub fn solve(&self) -> Result<Fit, EstimationError> {
        let p = self.columns();
        if p == 0 || self.rows <= p as u64 {
            return Err(EstimationError::TooShort { what: "least squares", found: self.rows as usize, needed: p + 1 });
        }
        let Some((scaled, scale)) = self.scaled() else {
            let rank = self.xtx().diagonal().iter().filter(|d| **d > 0.0).count();
            return Err(EstimationError::RankDeficient { columns: p, rank, condition: f64::INFINITY });
        };
        let eigen = scaled.clone().symmetric_eigenvalues();
        let (top, low) = (eigen.max(), eigen.min());
        let condition = if low > 0.0 { (top / low).sqrt() } else { f64::INFINITY };
        // An eigenvalue of a rank-deficient Gram matrix is zero up to rounding, about p · 1e-16.
        let floor = (RANK_TOLERANCE * RANK_TOLERANCE).max(p as f64 * 4.0 * f64::EPSILON) * top;
        let rank = eigen.iter().filter(|v| **v > floor).count();
        if rank < p {
            return Err(EstimationError::RankDeficient { columns: p, rank, condition });
        }
        if condition > GRAM_CONDITION_LIMIT {
            return Err(EstimationError::IllConditioned { condition, limit: GRAM_CONDITION_LIMIT });
        }
        let Some(factor) = scaled.cholesky() else {
            return Err(EstimationError::RankDeficient { columns: p, rank: p - 1, condition });
        };
        let xty = self.xty();
        let z = factor.solve(&DVector::from_fn(p, |j, _| xty[j] / scale[j]));
        let beta = DVector::from_fn(p, |j, _| z[j] / scale[j]);
        let mut inverse_gram = factor.inverse();
        for i in 0..p {
            for j in 0..p {
                inverse_gram[(i, j)] /= scale[i] * scale[j];
            }
        }
        let residual_sum = self.residual_sum(&beta);
        let variance = residual_sum / (self.rows - p as u64) as f64;
        let covariance = &inverse_gram * variance;
        Ok(Fit { beta, covariance, inverse_gram, sigma: variance.sqrt(), residual_sum, rows: self.rows, condition })
    }

    /// Adds block sums with compensation.
    fn add_compensated(&mut self, block: &DMatrix<f64>) {
        for ((s, c), &b) in self.sum.iter_mut().zip(self.lost.iter_mut()).zip(block.iter()) {
            let total = *s + b;
            *c += if s.abs() >= b.abs() { (*s - total) + b } else { (b - total) + *s };
            *s = total;
        }
    }
}

fn condition_of(scaled: &DMatrix<f64>) -> f64 {
    let eigen = scaled.clone().symmetric_eigenvalues();
    if eigen.min() > 0.0 { (eigen.max() / eigen.min()).sqrt() } else { f64::INFINITY }
}

impl Statistics for Gram {
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
        if p == 0 {
            return Ok(());
        }
        let m = p + 1;
        let mut rows = Vec::with_capacity(m * BLOCK.min(y.len()));
        let mut block = DMatrix::zeros(m, m);
        for (b, (xs, ys)) in x.chunks(p * BLOCK).zip(y.chunks(BLOCK)).enumerate() {
            rows.clear();
            for (i, (row, &v)) in xs.chunks_exact(p).zip(ys).enumerate() {
                rows.extend_from_slice(row);
                rows.push(v);
                if let Some(w) = weights {
                    let root = w[b * BLOCK + i].sqrt();
                    let from = rows.len() - m;
                    rows[from..].iter_mut().for_each(|v| *v *= root);
                }
            }
            let n = ys.len();
            // The same numbers read as columns and as rows: \[X y\]ᵀ times \[X y\].
            let left = DMatrixView::from_slice_generic(&rows, Dyn(m), Dyn(n));
            let right = DMatrixView::from_slice_with_strides_generic(&rows, Dyn(n), Dyn(m), Dyn(m), Dyn(1));
            block.gemm(1.0, &left, &right, 0.0);
            self.add_compensated(&block);
            self.rows += n as u64;
        }
        Ok(())
    }

    fn merge(&mut self, other: &Self) {
        self.add_compensated(&other.sum);
        self.lost += &other.lost;
        self.rows += other.rows;
    }

    fn rows(&self) -> u64 {
        self.rows
    }

    fn fit(&self) -> Result<Fit, EstimationError> {
        self.solve()
    }
}
