//! How late the torque signal is against the positions.
//!
//! τ_measured(t) = τ(t − d) ≈ τ(t) − d τ̇(t): the residual of the fit is regressed on the time derivative of the
//! *model* torque, which carries no measurement noise, with everything projected out that the parameters could
//! explain as well. The standard error comes from the scores of the blocks.

use crate::base::Structure;
use crate::fit::{Solution, predict};
use crate::rows::Rows;
use lacuna_estimation::filter::{Stencil, differentiate};
use lacuna_estimation::least_squares::{Gram, Statistics};
use serde::{Deserialize, Serialize};

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

/// Estimates the delay that `solution` leaves; `None` if the torque hardly changes.
pub fn estimate(
    structure: &Structure,
    rows: &Rows,
    train: &[bool],
    solution: &Solution,
    undone_s: f64,
) -> Option<DelayEstimate> {
    let p = solution.excited.len();
    // Column p is the model torque's rate, so that one Gram matrix holds both regressor and rate.
    let mut blocks = vec![Gram::new(p + 1); rows.blocks];
    for (j, active) in structure.active.iter().enumerate() {
        let rate = torque_rate(rows, &predict(structure, rows, &solution.beta, j))?;
        let data = &rows.joints[j];
        let model = predict(structure, rows, &solution.beta, j);
        let slots: Vec<Option<usize>> =
            active.iter().map(|b| solution.excited.iter().position(|e| e == b)).collect();
        let weight = [1.0 / (solution.sigma[j] * solution.sigma[j])];
        let mut x = vec![0.0; p + 1];
        for k in (0..rows.len()).filter(|&k| train[k] && data.fitted[k]) {
            x.fill(0.0);
            for (slot, v) in slots.iter().zip(&data.x[k * active.len()..(k + 1) * active.len()]) {
                if let Some(s) = slot {
                    x[*s] = *v;
                }
            }
            x[p] = rate[k];
            blocks[rows.block[k]].add_rows(&x, &[data.y[k] - model[k]], Some(&weight)).ok()?;
        }
    }
    let mut total = Gram::new(p + 1);
    blocks.iter().for_each(|b| total.merge(b));
    let own: Vec<usize> = (0..p).collect();
    let inverse = total.select(&own).solve().ok()?.inverse_gram;
    let xtx = total.xtx();
    let cross = xtx.view((0, p), (p, 1)).into_owned();
    let gamma = &inverse * &cross;
    let free = xtx[(p, p)] - cross.dot(&gamma);
    // Below a thousandth of its length the rate is as good as a combination of the other columns.
    if free.is_nan() || free <= 1e-6 * xtx[(p, p)] {
        return None;
    }
    let score_of = |gram: &Gram, d: f64| {
        let (xtx, xty) = (gram.xtx(), gram.xty());
        let rate_e = xty[p] - (0..p).map(|i| gamma[i] * xty[i]).sum::<f64>();
        let rate_rate = xtx[(p, p)]
            - 2.0 * (0..p).map(|i| gamma[i] * xtx[(i, p)]).sum::<f64>()
            + (0..p).map(|a| (0..p).map(|b| gamma[a] * gamma[b] * xtx[(a, b)]).sum::<f64>()).sum::<f64>();
        rate_e + d * rate_rate
    };
    let delay_s = -score_of(&total, 0.0) / free;
    let filled: Vec<&Gram> = blocks.iter().filter(|b| b.rows() > 0).collect();
    let count = filled.len() as f64;
    let sum: f64 = filled.iter().map(|b| score_of(b, delay_s).powi(2)).sum();
    let standard_error_s = (sum * count / (count - 1.0).max(1.0)).sqrt() / free;
    (delay_s.is_finite() && standard_error_s.is_finite()).then_some(DelayEstimate {
        delay_s: delay_s + undone_s,
        standard_error_s,
        undone_s,
    })
}

/// Time derivative of a signal over rows, stretch by stretch.
fn torque_rate(rows: &Rows, signal: &[f64]) -> Option<Vec<f64>> {
    let mut rate = vec![0.0; signal.len()];
    let mut start = 0;
    for k in 1..=signal.len() {
        if k < signal.len() && rows.stretch[k] == rows.stretch[start] {
            continue;
        }
        let period = if k - start > 1 { (rows.time_s[k - 1] - rows.time_s[start]) / (k - 1 - start) as f64 } else { 0.0 };
        // Seven points are needed; a stretch of fewer rows adds nothing.
        if k - start >= 7 {
            let part = differentiate(&signal[start..k], period, Stencil::Seven, 1).ok()?;
            rate[start..k].copy_from_slice(&part);
        }
        start = k;
    }
    Some(rate)
}
