//! How late the torque signal is against the positions.
//!
//! ```text
//! J(d) = min_β Σ (τ(t + d) − X β)² / σ²       d by Newton's method, J′ = 2 Σ e τ̇/σ², its error from the blocks' shares
//! ```
//!
//! Between samples the torque is the polynomial through seven of them. Its noise biases nothing: noise and its own
//! derivative are uncorrelated, and moving it leaves its size as it is.

use crate::condition::Prepared;
use crate::fit::draft::{Data, Draft};
use crate::layout::torque_at;
use lacuna_estimation::least_squares::Mixture;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What to do about a delay between torque and position.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delay {
    /// Estimate it; undo it if it is certain and at most two sample periods.
    #[default]
    Estimate,
    /// Take the signals as they are.
    Off,
    /// Undo this delay [s].
    Fixed(f64),
}

/// An estimated delay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DelayEstimate {
    /// The torque is this much later than the position [s].
    pub delay_s: f64,
    /// Its standard error [s].
    pub standard_error_s: f64,
    /// Delay that was undone before the fit [s].
    pub undone_s: f64,
}

/// Newton steps to the best delay.
const STEPS: usize = 12;

/// Estimates the delay that the training cells' torque has; `None` if the torque hardly changes.
pub(crate) fn estimate(data: Data<'_>, draft: &Draft) -> Option<DelayEstimate> {
    let prepared = data.stream.prepared;
    // The torque is known three working samples around a row: a delay further off is only said to be about so long.
    let reach_s = 2.5 * prepared.iter().map(Prepared::working_period_s).fold(f64::INFINITY, f64::min);
    let mut delay_s = 0.0;
    let mut first_s = None;
    for _ in 0..STEPS {
        let step = Profile::at(data, draft, delay_s)?.step_s();
        first_s.get_or_insert(step);
        delay_s += step;
        if delay_s.is_nan() || delay_s.abs() > reach_s {
            delay_s = first_s?;
            break;
        }
        if step.abs() < 1e-6 * reach_s {
            break;
        }
    }
    let inside = delay_s.abs() <= reach_s;
    let standard_error_s = Profile::at(data, draft, if inside { delay_s } else { 0.0 })?.standard_error_s();
    let undone_s = data.stream.plan.torque_delay_s;
    let out = DelayEstimate { delay_s: delay_s + undone_s, standard_error_s, undone_s };
    (delay_s.is_finite() && standard_error_s.is_finite()).then_some(out)
}

/// A delay is undone if it is certain, worth the trouble and one that sampling explains.
pub(crate) fn worth_undoing(d: &DelayEstimate, data: Data<'_>, draft: &Draft) -> bool {
    let trained = |r: usize| draft.own_cells().any(|c| data.sums.cells.list[c].recording == r);
    let recordings = data.stream.prepared.iter().enumerate().filter(|(r, _)| trained(*r));
    let period = recordings.map(|(_, p)| 1.0 / p.sample_rate_hz).fold(0.0, f64::max);
    let size = d.delay_s.abs();
    size > 4.0 * d.standard_error_s && size > 0.02 * period && size <= 2.0 * period
}

/// Squared residual J over the delay, with β free, about one delay.
struct Profile {
    /// Half of J′ and of J″.
    slope: f64,
    bend: f64,
    /// Half of J′ block by block, β held.
    scores: Vec<f64>,
}

impl Profile {
    /// `None` if the torque's rate is as good as a combination of the columns.
    fn at(data: Data<'_>, draft: &Draft, delay_s: f64) -> Option<Self> {
        let p = draft.choice.excited.len();
        let mut blocks: BTreeMap<usize, DMatrix<f64>> = BTreeMap::new();
        for cell in draft.own_cells() {
            let own = blocks.entry(data.sums.cells.list[cell].block).or_insert_with(|| DMatrix::zeros(p + 3, p + 3));
            add_cell(data, draft, cell, delay_s, own);
        }
        let total = blocks.values().fold(DMatrix::zeros(p + 3, p + 3), |sum, b| sum + b);
        let scale = DVector::from_fn(p, |i, _| if total[(i, i)] > 0.0 { 1.0 / total[(i, i)].sqrt() } else { 0.0 });
        let xtx = total.view((0, 0), (p, p)).component_mul(&(&scale * scale.transpose()));
        let factor = xtx.cholesky()?;
        let solve = |column: usize| {
            let rhs = total.view((0, column), (p, 1)).column(0).component_mul(&scale);
            factor.solve(&rhs).component_mul(&scale)
        };
        // What is left of the torque and its two derivatives beside the columns.
        let left: Vec<DVector<f64>> = (0..3)
            .map(|k| {
                let beta = solve(p + k);
                let mut c = DVector::zeros(p + 3);
                c.rows_mut(0, p).copy_from(&-beta);
                c[p + k] = 1.0;
                c
            })
            .collect();
        let product = |m: &DMatrix<f64>, a: usize, b: usize| left[a].dot(&(m * &left[b]));
        let bend = product(&total, 1, 1) + product(&total, 0, 2);
        if bend.is_nan() || bend <= 1e-6 * total[(p + 1, p + 1)] {
            return None;
        }
        let scores = blocks.values().filter(|b| b.diagonal().sum() > 0.0).map(|b| product(b, 0, 1)).collect();
        Some(Self { slope: product(&total, 0, 1), bend, scores })
    }

    fn step_s(&self) -> f64 {
        -self.slope / self.bend
    }

    fn standard_error_s(&self) -> f64 {
        let count = self.scores.len() as f64;
        let mean = self.slope / count.max(1.0);
        let sum: f64 = self.scores.iter().map(|s| (s - mean).powi(2)).sum();
        (sum * count / (count - 1.0).max(1.0)).sqrt() / self.bend
    }
}

/// Adds a cell's weighted products of the excited columns, the torque and its two derivatives, the torque read later by
/// `delay_s`.
fn add_cell(data: Data<'_>, draft: &Draft, cell: usize, delay_s: f64, into: &mut DMatrix<f64>) {
    let p = draft.choice.excited.len();
    let place = |b: usize| draft.choice.excited.iter().position(|e| *e == b);
    let period = data.stream.prepared[data.sums.cells.list[cell].recording].working_period_s();
    for (j, layout) in data.stream.layout.iter().enumerate() {
        let chosen = draft.chosen(data, cell, j);
        let mut mixture: Vec<Mixture> = Vec::new();
        for (slot, &b) in layout.active.iter().enumerate() {
            match place(b) {
                Some(column) => mixture.push((layout.place(slot, chosen.bristle), column, 1.0)),
                // Columns that are not fitted keep their torque.
                None if draft.beta[b] != 0.0 => {
                    mixture.push((layout.place(slot, chosen.bristle), p, -draft.beta[b]));
                }
                None => {}
            }
        }
        for derivative in 0..3 {
            let weights = torque_at(delay_s / period, derivative);
            let per_s = period.powi(-(derivative as i32));
            mixture.extend(weights.iter().enumerate().map(|(m, w)| (layout.torque() + m, p + derivative, w * per_s)));
        }
        data.sums.fitted[cell][j].mix_into(into, &mixture, 1.0 / (draft.sigma[j] * draft.sigma[j]));
    }
}
