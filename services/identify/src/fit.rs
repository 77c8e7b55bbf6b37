//! Pooled fit of all base parameters and friction: weighted by each joint's noise, robust against outliers, with a
//! covariance that holds for residuals correlated in time.
//!
//! ```text
//! β = argmin Σ_j Σ_k h_jk (τ_jk − X_jk β)² / σ_j²          σ_j and Huber's h from the residuals, in turn
//! V = (B − 1)/B Σ_b (β₍₋b₎ − β̄)(β₍₋b₎ − β̄)ᵀ                 β₍₋b₎: the fit without block b of time
//! ```
//!
//! The delete-one-block jackknife (Künsch 1989; for independent blocks the CR3 estimate of cluster-robust
//! regression) needs no model of the residual's spectrum, holds across joints, and does not shrink with the number
//! of parameters as plain cluster sums do.

use crate::base::Structure;
use crate::columns::Term;
use crate::rows::Rows;
use lacuna_estimation::EstimationError;
use lacuna_estimation::least_squares::{BlockSums, Gram, Pivoting, Statistics, accumulate, base_parameters};
use lacuna_estimation::stats::normal_quantile;
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Huber's constant: residuals beyond this many standard deviations pull no harder than at it. Keeps 98.9 % of the
/// efficiency on normal errors.
const HUBER: f64 = 2.5;
/// Part of a data column outside the span of the others below which the recordings do not tell it apart; raised
/// tenfold where the normal equations are still too ill-conditioned.
const DATA_TOLERANCE: [f64; 4] = [1e-4, 1e-3, 1e-2, 1e-1];

/// A column is zero in the data below this share of its size at random motions: a joint that a controller holds still moves
/// by its encoder's resolution.
const SILENT: f64 = 1e-4;

/// How to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitSettings {
    /// Bound the influence of large residuals.
    pub robust: bool,
    /// Fit standing joints too (every usable row), instead of `fitted` rows.
    pub standstill: bool,
}

/// A base column that the data do not support; it keeps the robot file's value (friction: 0).
#[derive(Debug, Clone, PartialEq)]
pub struct Unexcited {
    /// Index into the base.
    pub base: usize,
    /// Why.
    pub why: Why,
    /// (base, factor): the combination of fitted columns that it is, or is nearest to, in these data.
    pub combination: Vec<(usize, f64)>,
}

/// Why a base column was not fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Why {
    /// Its column is zero.
    Zero,
    /// Its column is a combination of others.
    Dependent,
    /// Fitted, its interval alone would move the torque by this many standard deviations of the torque.
    Uncertain(f64),
    /// Fitted, this friction came out negative.
    Negative(f64),
}

/// The fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// One value per base column; those not excited keep the robot file's value.
    pub beta: DVector<f64>,
    /// Covariance of β; zero rows and columns where not excited.
    pub covariance: DMatrix<f64>,
    /// Base columns that were fitted.
    pub excited: Vec<usize>,
    /// Base columns that the data do not excite or tell apart.
    pub unexcited: Vec<Unexcited>,
    /// Residual standard deviation per joint, over the fitted rows.
    pub sigma: Vec<f64>,
    /// Share of fitted rows beyond Huber's bound, per joint.
    pub outliers: Vec<f64>,
    /// Rows fitted, per joint.
    pub rows: Vec<usize>,
    /// Blocks of time that the covariance rests on.
    pub blocks: usize,
    /// Condition number of the weighted, column-scaled regressor.
    pub condition: f64,
    /// Condition number before unexcited columns were left out.
    pub condition_all: f64,
    /// XᵀWX and XᵀWy over all base columns, for constrained variants of the fit.
    pub(crate) normal: Gram,
}

impl Solution {
    /// Standard error of base column `b`; 0 where not excited.
    pub fn standard_error(&self, b: usize) -> f64 {
        self.covariance[(b, b)].max(0.0).sqrt()
    }

    /// Half width of the 95 % interval of base column `b`: Student's t with one degree of freedom less than blocks.
    pub fn half_width(&self, b: usize) -> f64 {
        student_975(self.blocks.saturating_sub(1)) * self.standard_error(b)
    }
}

/// 97.5 % point of Student's t, by the Cornish-Fisher expansion about the normal point (Abramowitz and Stegun
/// 26.7.5); within 1 % from 4 degrees of freedom on.
pub fn student_975(freedom: usize) -> f64 {
    let z = normal_quantile(0.975);
    if freedom == 0 {
        return f64::INFINITY;
    }
    let v = freedom as f64;
    let (z3, z5) = (z.powi(3), z.powi(5));
    z + (z3 + z) / (4.0 * v)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * v * v)
        + (3.0 * z.powi(7) + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * v * v * v)
}

/// The model torque of a joint at every row [Nm].
pub fn predict(structure: &Structure, rows: &Rows, beta: &DVector<f64>, joint: usize) -> Vec<f64> {
    let active = &structure.active[joint];
    let part: Vec<f64> = active.iter().map(|&b| beta[b]).collect();
    let x = &rows.joints[joint].x;
    if active.is_empty() {
        return vec![0.0; rows.len()];
    }
    x.chunks_exact(active.len()).map(|row| row.iter().zip(&part).map(|(a, b)| a * b).sum()).collect()
}

/// Fits the rows for which `train` is true.
///
/// # Errors
/// [`BadInput`] if no row is left, or fewer than parameters.
pub fn fit(structure: &Structure, rows: &Rows, train: &[bool], settings: FitSettings) -> Result<Solution, BadInput> {
    let used: Vec<Vec<bool>> = rows
        .joints
        .iter()
        .map(|j| {
            let mask = if settings.standstill { &j.usable } else { &j.fitted };
            mask.iter().zip(train).map(|(m, t)| *m && *t).collect()
        })
        .collect();
    let count: Vec<usize> = used.iter().map(|u| u.iter().filter(|b| **b).count()).collect();
    if count.iter().sum::<usize>() <= structure.base.len() {
        return Err(BadInput::new(format!(
            "found {} rows of moving joints in the training recordings; expected more than {}, one per parameter (lower \
             the moving speed, or record motion)",
            count.iter().sum::<usize>(),
            structure.base.len()
        )));
    }
    let problem = Problem { structure, rows, used, spans: block_spans(rows) };
    let mut sigma: Vec<f64> = (0..count.len()).map(|j| problem.spread_of_torque(j)).collect();
    let mut huber: Option<Vec<Vec<f64>>> = None;
    let mut outliers = vec![0.0; count.len()];
    // First with weights of the torque's size, then of the noise's, then with bounded influence.
    let (rms, size) = problem.column_sizes();
    let mut sums = problem.sums(&sigma, None)?;
    let (mut choice, mut condition_all) = problem.excited(&sums, &rms)?;
    for pass in 0..1 + usize::from(settings.robust) {
        let beta = problem.solve(&sums, &choice)?;
        let weights = problem.reweigh(&beta, &mut sigma, &mut outliers, huber.is_some());
        huber = settings.robust.then_some(weights);
        sums = problem.sums(&sigma, huber.as_deref())?;
        if pass == 0 {
            (choice, condition_all) = problem.excited(&sums, &rms)?;
        }
    }
    loop {
        let beta = problem.solve(&sums, &choice)?;
        let (covariance, blocks) = problem.jackknife(&sums, &choice)?;
        let spread = Spread { sigma: sigma.clone(), outliers: outliers.clone(), count: count.clone(), condition_all };
        let solution = problem.finish(&sums, &choice, (beta, covariance, blocks), spread)?;
        // Every turn drops a column, so this ends.
        match problem.unsupported(&solution, &size) {
            Some((base, why)) => problem.drop_column(&sums, &mut choice, base, why)?,
            None => {
                problem.reweigh(&solution.beta, &mut sigma, &mut outliers, huber.is_some());
                return Ok(Solution { sigma, outliers, ..solution });
            }
        }
    }
}

struct Spread {
    sigma: Vec<f64>,
    outliers: Vec<f64>,
    count: Vec<usize>,
    condition_all: f64,
}

/// Which base columns are fitted, and what became of the others.
struct Choice {
    excited: Vec<usize>,
    unexcited: Vec<Unexcited>,
    /// Torque of the unexcited columns is that of the robot file.
    fixed: Vec<f64>,
}

struct Problem<'a> {
    structure: &'a Structure,
    rows: &'a Rows,
    /// `[joint][row]`
    used: Vec<Vec<bool>>,
    spans: Vec<Range<usize>>,
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
    fn nominal(&self) -> DVector<f64> {
        DVector::from_iterator(self.structure.base.len(), self.structure.base.iter().map(|b| b.nominal))
    }

    fn spread_of_torque(&self, j: usize) -> f64 {
        let y = &self.rows.joints[j].y;
        let values: Vec<f64> = y.iter().zip(&self.used[j]).filter(|(_, u)| **u).map(|(v, _)| *v).collect();
        let sd = lacuna_estimation::stats::standard_deviation(&values);
        if sd.is_finite() && sd > 0.0 { sd } else { 1.0 }
    }

    /// Weighted statistics per block, over all base columns.
    fn sums(&self, sigma: &[f64], huber: Option<&[Vec<f64>]>) -> Result<BlockSums<Gram>, BadInput> {
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

    /// Columns that these data excite and tell apart, and the condition number of all that are not zero.
    fn excited(&self, sums: &BlockSums<Gram>, rms: &[f64]) -> Result<(Choice, f64), BadInput> {
        let total = sums.total().ok_or_else(nothing)?;
        let base = &self.structure.base;
        let (moved, zero): (Vec<usize>, Vec<usize>) = (0..base.len()).partition(|&b| rms[b] > SILENT * base[b].typical);
        let root = column_root(&total.select(&moved).xtx());
        let nominal = self.nominal();
        for tolerance in DATA_TOLERANCE {
            let found = base_parameters(&root, tolerance, Pivoting::InOrder)?;
            let mut excited: Vec<usize> = found.independent.iter().map(|&i| moved[i]).collect();
            excited.sort_unstable();
            if excited.is_empty() {
                break;
            }
            if total.select(&excited).condition() > 0.5 * lacuna_estimation::least_squares::GRAM_CONDITION_LIMIT {
                continue;
            }
            // Factors were found for columns of unit length.
            let length = |b: usize| total.select(&[b]).xtx()[(0, 0)].sqrt();
            let dependent = found.dependent.into_iter().map(|d| {
                let column = moved[d.column];
                let combination =
                    d.combination.iter().map(|&(i, k)| (moved[i], k * length(column) / length(moved[i]))).collect();
                Unexcited { base: column, why: Why::Dependent, combination }
            });
            let silent = zero.iter().map(|&base| Unexcited { base, why: Why::Zero, combination: Vec::new() });
            let mut unexcited: Vec<Unexcited> = dependent.chain(silent).collect();
            unexcited.sort_by_key(|u| u.base);
            let mut fixed = vec![0.0; nominal.len()];
            unexcited.iter().for_each(|u| fixed[u.base] = nominal[u.base]);
            return Ok((Choice { excited, unexcited, fixed }, total.select(&moved).condition()));
        }
        Err(BadInput::new(
            "found columns that the recordings do not tell apart at any tolerance; expected motion of every joint",
        ))
    }

    /// β of the excited columns, the others at the robot file's value.
    fn solve(&self, sums: &BlockSums<Gram>, choice: &Choice) -> Result<DVector<f64>, BadInput> {
        let total = sums.total().ok_or_else(nothing)?;
        solve_chosen(&total, choice)
    }

    /// New σ_j from the residuals, and Huber's weights; rows not used get 0.
    fn reweigh(&self, beta: &DVector<f64>, sigma: &mut [f64], outliers: &mut [f64], settled: bool) -> Vec<Vec<f64>> {
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
    fn column_sizes(&self) -> (Vec<f64>, Vec<f64>) {
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

    /// The fitted column that the data support least, if it is below what a model can use.
    fn unsupported(&self, solution: &Solution, size: &[f64]) -> Option<(usize, Why)> {
        let term = |b: usize| self.structure.columns[self.structure.base[b].column].term;
        let torque = |b: usize| solution.half_width(b) * size[b];
        // Of a Coulomb level and an offset that only appear together, the offset is the one to go.
        let preference = |b: usize| if matches!(term(b), Term::Offset(_)) { 3.0 * torque(b) } else { torque(b) };
        let worst = solution
            .excited
            .iter()
            .filter(|&&b| solution.blocks >= 3 && solution.excited.len() > 1 && torque(b) > 1.0)
            .max_by(|&&a, &&b| preference(a).total_cmp(&preference(b)));
        if let Some(&b) = worst {
            return Some((b, Why::Uncertain(torque(b))));
        }
        let friction = |b: usize| matches!(term(b), Term::Viscous(_) | Term::Coulomb(_));
        let lowest = solution
            .excited
            .iter()
            .filter(|&&b| friction(b) && solution.beta[b] < 0.0)
            .min_by(|&&a, &&b| (solution.beta[a] * size[a]).total_cmp(&(solution.beta[b] * size[b])));
        lowest.map(|&b| (b, Why::Negative(solution.beta[b])))
    }

    /// Takes a column out of the fit and notes what it is nearest to.
    fn drop_column(&self, sums: &BlockSums<Gram>, choice: &mut Choice, base: usize, why: Why) -> Result<(), BadInput> {
        choice.excited.retain(|b| *b != base);
        let total = sums.total().ok_or_else(nothing)?;
        let xtx = total.xtx();
        let rest = total.select(&choice.excited).solve()?;
        let cross = DVector::from_iterator(choice.excited.len(), choice.excited.iter().map(|&b| xtx[(b, base)]));
        let factors = rest.inverse_gram * cross;
        let length = xtx[(base, base)].sqrt();
        let combination = choice
            .excited
            .iter()
            .zip(factors.iter())
            .filter(|(b, k)| k.abs() * xtx[(**b, **b)].sqrt() > 0.1 * length)
            .map(|(&b, &k)| (b, k))
            .collect();
        choice.fixed[base] = self.structure.base[base].nominal;
        choice.unexcited.push(Unexcited { base, why, combination });
        choice.unexcited.sort_by_key(|u| u.base);
        Ok(())
    }

    /// Delete-one-block covariance of β and the number of blocks behind it.
    fn jackknife(&self, sums: &BlockSums<Gram>, choice: &Choice) -> Result<(DMatrix<f64>, usize), BadInput> {
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

    fn finish(
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

fn nothing() -> BadInput {
    BadInput::new("found no rows to fit; expected a recording in motion")
}

/// A matrix of unit columns with the column dependences of the regressor whose Gram matrix is given, to half its digits.
fn column_root(xtx: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = xtx.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(xtx.nrows(), xtx.ncols(), |i, j| xtx[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut root = eigen.eigenvectors.transpose();
    for (mut row, value) in root.row_iter_mut().zip(eigen.eigenvalues.iter()) {
        row *= value.max(0.0).sqrt();
    }
    root
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_against_tables() {
        for (v, t) in [(5, 2.5706), (10, 2.2281), (30, 2.0423), (100, 1.9840)] {
            assert!((student_975(v) / t - 1.0).abs() < 0.005, "{v}: {}", student_975(v));
        }
        assert_eq!(student_975(0), f64::INFINITY);
    }
}
