//! The weighted normal equations of a fit, per block of time, and what follows from them.

use super::{Solution, Unexcited, predict};
use crate::base::Structure;
use crate::rows::Rows;
use lacuna_estimation::EstimationError;
use lacuna_estimation::least_squares::{BlockSums, Gram, Statistics, accumulate};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Huber's constant: residuals beyond this many standard deviations pull no harder than at it. Keeps 98.9 % of the
/// efficiency on normal errors.
const HUBER: f64 = 2.5;
/// What the iteration found beside β.
pub(super) struct Spread {
    pub(super) sigma: Vec<f64>,
    pub(super) outliers: Vec<f64>,
    pub(super) count: Vec<usize>,
    pub(super) condition_all: f64,
}

/// Which base columns are fitted, and what became of the others.
pub(super) struct Choice {
    pub(super) excited: Vec<usize>,
    pub(super) unexcited: Vec<Unexcited>,
    /// Torque of the unexcited columns is that of the robot file.
    pub(super) fixed: Vec<f64>,
}

/// Rows to fit, and the sums over them.
pub(super) struct Problem<'a> {
    pub(super) structure: &'a Structure,
    pub(super) rows: &'a Rows,
    /// `[joint][row]`
    pub(super) used: Vec<Vec<bool>>,
    pub(super) spans: Vec<Range<usize>>,
}

/// Rows of every block.
pub(crate) fn block_spans(rows: &Rows) -> Vec<Range<usize>> {
    let mut spans = vec![0..0; rows.blocks];
    let mut start = 0;
    for k in 1..=rows.len() {
        if k == rows.len() || rows.block[k] != rows.block[start] {
            spans[rows.block[start]] = start..k;
            start = k;
        }
    }
    spans
}

impl Problem<'_> {
    pub(super) fn nominal(&self) -> DVector<f64> {
        DVector::from_iterator(self.structure.base.len(), self.structure.base.iter().map(|b| b.nominal))
    }

    pub(super) fn spread_of_torque(&self, j: usize) -> f64 {
        let y = &self.rows.joints[j].y;
        let values: Vec<f64> = y.iter().zip(&self.used[j]).filter(|(_, u)| **u).map(|(v, _)| *v).collect();
        let sd = lacuna_estimation::stats::standard_deviation(&values);
        if sd.is_finite() && sd > 0.0 { sd } else { 1.0 }
    }

    /// Weighted statistics per block, over all base columns.
    pub(super) fn sums(&self, sigma: &[f64], huber: Option<&[Vec<f64>]>) -> Result<BlockSums<Gram>, BadInput> {
        let p = self.structure.base.len();
        let fill = |k: usize, gram: &mut Gram| -> Result<(), EstimationError> {
            let span = self.spans[k].clone();
            let (mut x, mut y, mut w) = (Vec::new(), Vec::new(), Vec::new());
            for (j, active) in self.structure.active.iter().enumerate() {
                let joint = &self.rows.joints[j];
                let width = active.len();
                for row in span.clone().filter(|&row| self.used[j][row]) {
                    let at = x.len();
                    x.resize(at + p, 0.0);
                    let entries = &joint.x[row * width..(row + 1) * width];
                    for (&b, v) in active.iter().zip(entries) {
                        x[at + b] = *v;
                    }
                    y.push(joint.y[row]);
                    w.push(huber.map_or(1.0, |h| h[j][row]) / (sigma[j] * sigma[j]));
                }
            }
            gram.add_rows(&x, &y, Some(&w))
        };
        Ok(accumulate(self.spans.len(), p, fill)?)
    }

    /// β of the excited columns, the others at the robot file's value.
    pub(super) fn solve(&self, sums: &BlockSums<Gram>, choice: &Choice) -> Result<DVector<f64>, BadInput> {
        let total = sums.total().ok_or_else(nothing)?;
        solve_chosen(&total, choice)
    }

    /// New σ_j from the residuals, and Huber's weights; rows not used get 0.
    pub(super) fn reweigh(
        &self,
        beta: &DVector<f64>,
        sigma: &mut [f64],
        outliers: &mut [f64],
        settled: bool,
    ) -> Vec<Vec<f64>> {
        let found: Vec<(f64, f64, Vec<f64>)> = (0..sigma.len())
            .into_par_iter()
            .map(|j| {
                let model = predict(self.structure, self.rows, beta, j);
                let joint = &self.rows.joints[j];
                let old = sigma[j];
                // Before the first fit σ is the torque's size, not the noise's: nothing is an outlier yet.
                let rms = {
                    let (mut sum, mut weight) = (0.0, 0.0);
                    for ((y, m), _) in joint.y.iter().zip(&model).zip(&self.used[j]).filter(|(_, u)| **u) {
                        let e = y - m;
                        let h = if settled { huber_weight(e / old) } else { 1.0 };
                        sum += h * e * e;
                        weight += h;
                    }
                    (sum / f64::max(weight, 1.0)).sqrt()
                };
                let new = if rms > 0.0 { rms } else { old };
                let mut beyond = 0usize;
                let mut count = 0usize;
                let weights = joint
                    .y
                    .iter()
                    .zip(&model)
                    .zip(&self.used[j])
                    .map(|((y, m), used)| {
                        if !used {
                            return 0.0;
                        }
                        let h = huber_weight((y - m) / new);
                        count += 1;
                        beyond += usize::from(h < 1.0);
                        h
                    })
                    .collect();
                (new, beyond as f64 / count.max(1) as f64, weights)
            })
            .collect();
        let mut all = Vec::with_capacity(found.len());
        for (j, (s, o, w)) in found.into_iter().enumerate() {
            sigma[j] = s;
            outliers[j] = o;
            all.push(w);
        }
        all
    }

    /// Root mean square of every base column over a joint's fitted rows, and the same in standard deviations of that
    /// joint's torque; each at the joint where it is largest.
    pub(super) fn column_sizes(&self) -> (Vec<f64>, Vec<f64>) {
        let p = self.structure.base.len();
        let (mut rms, mut size) = (vec![0.0f64; p], vec![0.0f64; p]);
        for (j, active) in self.structure.active.iter().enumerate() {
            let scale = self.spread_of_torque(j);
            let mut sum = vec![0.0; active.len()];
            let mut count = 0.0;
            for row in (0..self.rows.len()).filter(|&row| self.used[j][row]) {
                let entries = &self.rows.joints[j].x[row * active.len()..(row + 1) * active.len()];
                sum.iter_mut().zip(entries).for_each(|(s, v)| *s += v * v);
                count += 1.0;
            }
            for (&b, s) in active.iter().zip(&sum) {
                let own = (s / f64::max(count, 1.0)).sqrt();
                rms[b] = rms[b].max(own);
                size[b] = size[b].max(own / scale);
            }
        }
        (rms, size)
    }

    /// Delete-one-block covariance of β and the number of blocks behind it.
    pub(super) fn jackknife(&self, sums: &BlockSums<Gram>, choice: &Choice) -> Result<(DMatrix<f64>, usize), BadInput> {
        let p = self.structure.base.len();
        let total = sums.total().ok_or_else(nothing)?;
        let filled: Vec<&Gram> = sums.blocks.iter().filter(|b| b.rows() > 0).collect();
        let without: Vec<DVector<f64>> = filled
            .par_iter()
            .filter_map(|block| total.without(block).ok().and_then(|rest| solve_chosen(&rest, choice).ok()))
            .collect();
        let count = without.len() as f64;
        let mut covariance = DMatrix::zeros(p, p);
        if without.len() >= 2 {
            let mean = without.iter().fold(DVector::zeros(p), |s, b| s + b) / count;
            for b in &without {
                let d = b - &mean;
                covariance.ger((count - 1.0) / count, &d, &d, 1.0);
            }
        }
        Ok((covariance, without.len()))
    }

    pub(super) fn finish(
        &self,
        sums: &BlockSums<Gram>,
        choice: &Choice,
        (beta, covariance, blocks): (DVector<f64>, DMatrix<f64>, usize),
        spread: Spread,
    ) -> Result<Solution, BadInput> {
        let normal = sums.total().ok_or_else(nothing)?;
        Ok(Solution {
            condition: normal.select(&choice.excited).condition(),
            condition_all: spread.condition_all,
            beta,
            covariance,
            blocks,
            excited: choice.excited.clone(),
            unexcited: choice.unexcited.clone(),
            sigma: spread.sigma,
            outliers: spread.outliers,
            rows: spread.count,
            normal,
        })
    }
}

pub(super) fn nothing() -> BadInput {
    BadInput::new("found no rows to fit; expected a recording in motion")
}

fn huber_weight(u: f64) -> f64 {
    if u.abs() <= HUBER { 1.0 } else { HUBER / u.abs() }
}

/// Solves for the chosen columns; the fixed ones' torque is taken off the measurement first.
fn solve_chosen(total: &Gram, choice: &Choice) -> Result<DVector<f64>, BadInput> {
    let part = total.select(&choice.excited);
    let fit = part.solve()?;
    let mut beta = DVector::from_column_slice(&choice.fixed);
    let mut own = fit.beta;
    if choice.fixed.iter().any(|v| *v != 0.0) {
        // Xᵀ(y − X_f β_f) instead of Xᵀy.
        let shift = total.xtx() * &beta;
        let pulled = DVector::from_iterator(choice.excited.len(), choice.excited.iter().map(|&b| shift[b]));
        own -= fit.inverse_gram * pulled;
    }
    for (&b, v) in choice.excited.iter().zip(own.iter()) {
        beta[b] = *v;
    }
    Ok(beta)
}
