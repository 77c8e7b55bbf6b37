//! Statistics per block: filled in parallel, summed in order, resampled for intervals.

use super::gram::Gram;
use super::solve::Fit;
use crate::error::EstimationError;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Sufficient statistics that rows can be added to.
pub trait Statistics: Clone + Send {
    /// None yet, for `columns` parameters.
    fn empty(columns: usize) -> Self;

    /// Adds rows: `x` row-major, p entries a row; `y` one measurement a row; `weights` one a row (1/variance).
    ///
    /// # Errors
    /// [`EstimationError`] for lengths that do not fit or a negative weight.
    fn add_rows(&mut self, x: &[f64], y: &[f64], weights: Option<&[f64]>) -> Result<(), EstimationError>;

    /// Adds the statistics of further rows (of the same number of columns).
    fn merge(&mut self, other: &Self);

    /// Rows so far.
    fn rows(&self) -> u64;

    /// The fit over all rows so far.
    ///
    /// # Errors
    /// As [`Gram::solve`] or [`super::Tsqr::solve`].
    fn fit(&self) -> Result<Fit, EstimationError>;
}

/// Statistics of consecutive blocks of a recording. A block should be several correlation times of the
/// residual long (0.2 s and more for a filtered torque), so that blocks are independent of each other.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockSums<S = Gram> {
    /// One per block, in the order of time.
    pub blocks: Vec<S>,
}

/// Fills `blocks` blocks of `columns` parameters in parallel; `fill(k, statistics)` adds the rows of block k.
/// The result does not depend on the number of threads.
///
/// # Errors
/// The first error, in block order, that `fill` returned.
pub fn accumulate<S, E, F>(blocks: usize, columns: usize, fill: F) -> Result<BlockSums<S>, E>
where
    S: Statistics,
    E: Send,
    F: Fn(usize, &mut S) -> Result<(), E> + Sync,
{
    let filled: Vec<Result<S, E>> = (0..blocks)
        .into_par_iter()
        .map(|k| {
            let mut statistics = S::empty(columns);
            fill(k, &mut statistics).map(|()| statistics)
        })
        .collect();
    Ok(BlockSums { blocks: filled.into_iter().collect::<Result<_, _>>()? })
}

impl<S: Statistics> BlockSums<S> {
    /// Sum over all blocks, in order; `None` without blocks.
    pub fn total(&self) -> Option<S> {
        let (first, rest) = self.blocks.split_first()?;
        let mut total = first.clone();
        for block in rest {
            total.merge(block);
        }
        Some(total)
    }
}

/// Parameters of the resampled recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct Bootstrap {
    /// One β a column; replicates whose blocks did not determine β are left out.
    pub replicates: DMatrix<f64>,
    /// How many were left out.
    pub failed: usize,
}

impl Bootstrap {
    /// Covariance of β over the replicates.
    pub fn covariance(&self) -> DMatrix<f64> {
        let b = self.replicates.ncols();
        let mean = self.replicates.column_mean();
        let mut centred = self.replicates.clone();
        for mut column in centred.column_iter_mut() {
            column -= &mean;
        }
        &centred * centred.transpose() / (b.max(2) - 1) as f64
    }

    /// Percentile interval of parameter `j` that holds `level` (0.95, say) of the replicates.
    pub fn interval(&self, j: usize, level: f64) -> (f64, f64) {
        if j >= self.replicates.nrows() {
            return (f64::NAN, f64::NAN);
        }
        let mut values: Vec<f64> = self.replicates.row(j).iter().copied().collect();
        let tail = 0.5 * (1.0 - level);
        let low = crate::stats::quantile_in_place(&mut values, tail);
        (low, crate::stats::quantile_in_place(&mut values, 1.0 - tail))
    }
}

impl BlockSums<Gram> {
    /// Covariance of β that is right for residuals correlated within blocks (cluster-robust, Liang and Zeger
    /// 1986): (XᵀX)⁻¹ Σ_b s_b s_bᵀ (XᵀX)⁻¹ · B/(B − 1), with the score s_b = X_bᵀ(y_b − X_b β) of block b.
    ///
    /// # Errors
    /// [`EstimationError::TooShort`] for no more blocks than parameters.
    pub fn cluster_covariance(&self, fit: &Fit) -> Result<DMatrix<f64>, EstimationError> {
        let p = fit.beta.len();
        let blocks: Vec<&Gram> = self.blocks.iter().filter(|b| b.rows() > 0).collect();
        if blocks.len() <= p {
            return Err(EstimationError::TooShort { what: "blocks", found: blocks.len(), needed: p + 1 });
        }
        let mut meat = DMatrix::zeros(p, p);
        for block in &blocks {
            crate::error::same_length("columns of a block", block.columns(), p)?;
            let score: DVector<f64> = block.score(&fit.beta);
            meat.ger(1.0, &score, &score, 1.0);
        }
        let count = blocks.len() as f64;
        Ok(&fit.inverse_gram * meat * &fit.inverse_gram * (count / (count - 1.0)))
    }

    /// Block bootstrap (Künsch 1989, non-overlapping blocks): `replicates` times as many blocks as there are,
    /// drawn with replacement, and β of each draw. Deterministic by `seed`, whatever the number of threads.
    ///
    /// # Errors
    /// [`EstimationError::TooShort`] for fewer than two blocks or replicates, or if no draw determined β.
    pub fn bootstrap(&self, replicates: usize, seed: u64) -> Result<Bootstrap, EstimationError> {
        let n = self.blocks.len();
        if n < 2 || replicates < 2 {
            return Err(EstimationError::TooShort { what: "block bootstrap", found: n.min(replicates), needed: 2 });
        }
        let draw = |r: usize| -> Option<DVector<f64>> {
            // A generator of its own per replicate keeps the draw independent of the schedule.
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (r as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
            let mut total = self.blocks[rng.random_range(0..n)].clone();
            for _ in 1..n {
                total.merge(&self.blocks[rng.random_range(0..n)]);
            }
            total.solve().ok().map(|fit| fit.beta)
        };
        let drawn: Vec<Option<DVector<f64>>> = (0..replicates).into_par_iter().map(draw).collect();
        let solved: Vec<DVector<f64>> = drawn.into_iter().flatten().collect();
        if solved.len() < 2 {
            return Err(EstimationError::TooShort { what: "bootstrap replicates", found: solved.len(), needed: 2 });
        }
        Ok(Bootstrap { failed: replicates - solved.len(), replicates: DMatrix::from_columns(&solved) })
    }
}
