//! Weighted normal equations of a choice of columns, block by block, and what follows from them.

use super::Unexcited;
use super::triangles::Factors;
use lacuna_estimation::least_squares::{Gram, least_squares};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Which base columns are fitted, and what became of the others.
#[derive(Debug, Clone, Default)]
pub(crate) struct Choice {
    pub(crate) excited: Vec<usize>,
    pub(crate) unexcited: Vec<Unexcited>,
    /// Torque of the unexcited columns is that of the robot file.
    pub(crate) fixed: Vec<f64>,
    /// Whether further columns are told apart that normal equations cannot carry beside these.
    pub(crate) lossy: bool,
}

/// Statistics of the blocks that hold rows, over all base columns, and their sum.
#[derive(Debug, Clone)]
pub(crate) struct Normal {
    pub(crate) blocks: Vec<Gram>,
    pub(crate) total: Gram,
    /// The same by QR, where normal equations lose digits.
    pub(crate) factors: Option<Factors>,
}

impl Normal {
    /// Sums `blocks` in their order.
    pub(crate) fn of(blocks: Vec<Gram>, columns: usize) -> Self {
        use lacuna_estimation::least_squares::Statistics;
        let mut total = Gram::new(columns);
        blocks.iter().for_each(|b| total.merge(b));
        Self { blocks, total, factors: None }
    }

    /// β of the excited columns, the others at the robot file's value.
    pub(crate) fn solve(&self, choice: &Choice) -> Result<DVector<f64>, BadInput> {
        if let Some(factors) = &self.factors {
            return factors.solve(choice);
        }
        let part = self.total.select(&choice.excited);
        let fit = part.solve()?;
        let mut beta = DVector::from_column_slice(&choice.fixed);
        let mut own = fit.beta;
        if choice.fixed.iter().any(|v| *v != 0.0) {
            // Xᵀ(y − X_f β_f) instead of Xᵀy.
            let shift = self.total.xtx() * &beta;
            let pulled = DVector::from_iterator(choice.excited.len(), choice.excited.iter().map(|&b| shift[b]));
            own -= fit.inverse_gram * pulled;
        }
        for (&b, v) in choice.excited.iter().zip(own.iter()) {
            beta[b] = *v;
        }
        Ok(beta)
    }

    /// Condition number of the weighted, column-scaled regressor of some columns.
    pub(crate) fn condition(&self, columns: &[usize]) -> f64 {
        match &self.factors {
            Some(factors) => condition_of(factors.columns(columns)),
            None => self.total.select(columns).condition(),
        }
    }

    /// Factors of the combination of `columns` that is nearest to column `base`.
    pub(crate) fn nearest(&self, columns: &[usize], base: usize) -> Result<DVector<f64>, BadInput> {
        if let Some(factors) = &self.factors {
            return Ok(least_squares(&factors.columns(columns), &factors.columns(&[base]).column(0).into_owned())?.beta);
        }
        let xtx = self.total.xtx();
        let cross = DVector::from_iterator(columns.len(), columns.iter().map(|&b| xtx[(b, base)]));
        Ok(self.total.select(columns).solve()?.inverse_gram * cross)
    }

    /// Delete-one-block covariance of β about its value `beta` over all blocks, and the number of blocks behind it.
    pub(crate) fn jackknife(&self, choice: &Choice) -> (DMatrix<f64>, usize) {
        let without: Vec<DVector<f64>> = self.leave_one_out(choice);
        covariance(&without, choice.fixed.len())
    }

    /// β without each block in turn; blocks without which β is not determined are left out.
    pub(crate) fn leave_one_out(&self, choice: &Choice) -> Vec<DVector<f64>> {
        if let Some(factors) = &self.factors {
            return factors.leave_one_out(choice);
        }
        let fixed = DVector::from_column_slice(&choice.fixed);
        // X_eᵀ(y − X_f β_f) and X_eᵀX_e of the whole, less the block's.
        let reduce = |gram: &Gram| {
            let xtx = gram.xtx();
            let score = gram.xty() - &xtx * &fixed;
            (xtx.select_rows(&choice.excited).select_columns(&choice.excited), score.select_rows(&choice.excited))
        };
        let (all, score) = reduce(&self.total);
        let scale = all.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
        let scales = &scale * scale.transpose();
        self.blocks
            .par_iter()
            .filter_map(|block| {
                let (part, own) = reduce(block);
                let rest = (&all - part).component_mul(&scales);
                let solved = rest.cholesky()?.solve(&(&score - own).component_mul(&scale)).component_mul(&scale);
                let mut beta = fixed.clone();
                for (&b, v) in choice.excited.iter().zip(solved.iter()) {
                    beta[b] = *v;
                }
                beta.iter().all(|v| v.is_finite()).then_some(beta)
            })
            .collect()
    }
}

/// Condition number of a matrix with its columns scaled to unit length; infinite where one is zero.
pub(crate) fn condition_of(mut columns: DMatrix<f64>) -> f64 {
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        if !(length > 0.0 && length.is_finite()) {
            return f64::INFINITY;
        }
        column.unscale_mut(length);
    }
    if columns.is_empty() {
        return f64::INFINITY;
    }
    let singular = columns.singular_values();
    singular.max() / singular.min()
}

/// Delete-one covariance of estimates of `p` parameters.
pub(crate) fn covariance(without: &[DVector<f64>], p: usize) -> (DMatrix<f64>, usize) {
    let count = without.len() as f64;
    let mut covariance = DMatrix::zeros(p, p);
    if without.len() >= 2 {
        let mean = without.iter().fold(DVector::zeros(p), |s, b| s + b) / count;
        for b in without {
            let d = b - &mean;
            covariance.ger((count - 1.0) / count, &d, &d, 1.0);
        }
    }
    (covariance, without.len())
}
