//! How late the torque signal is against the positions.
//!
//! τ_measured(t) = τ(t − d) ≈ τ(t) − d τ̇(t): the residual of the fit is regressed on the time derivative of the
//! *model* torque, which carries no measurement noise, with everything projected out that the parameters could
//! explain as well. The standard error comes from the scores of the blocks.

use crate::base::Structure;
use crate::fit::{Solution, block_spans, predict};
use crate::rows::Rows;
use lacuna_estimation::filter::{Stencil, differentiate};
use lacuna_estimation::least_squares::{Gram, Statistics, accumulate};
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
    let n = structure.active.len();
    let model: Vec<Vec<f64>> = (0..n).map(|j| predict(structure, rows, &solution.beta, j)).collect();
    let rate: Vec<Vec<f64>> = model.iter().map(|m| torque_rate(rows, m)).collect::<Option<_>>()?;
    let place = |b: &usize| solution.excited.iter().position(|e| e == b);
    let slots: Vec<Vec<Option<usize>>> = structure.active.iter().map(|a| a.iter().map(place).collect()).collect();
    let spans = block_spans(rows);
    let fill = |block: usize, gram: &mut Gram| {
        let (mut x, mut y, mut w) = (Vec::new(), Vec::new(), Vec::new());
        for (j, slots) in slots.iter().enumerate() {
            let data = &rows.joints[j];
            for k in spans[block].clone().filter(|&k| train[k] && data.fitted[k]) {
                let at = x.len();
                x.resize(at + p + 1, 0.0);
                for (slot, v) in slots.iter().zip(&data.x[k * slots.len()..(k + 1) * slots.len()]) {
                    if let Some(s) = slot {
                        x[at + s] = *v;
                    }
                }
                x[at + p] = rate[j][k];
                y.push(data.y[k] - model[j][k]);
                w.push(1.0 / (solution.sigma[j] * solution.sigma[j]));
            }
        }
        gram.add_rows(&x, &y, Some(&w))
    };
    let blocks = accumulate(rows.blocks, p + 1, fill).ok()?.blocks;
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
        let rate_rate = xtx[(p, p)] - 2.0 * (0..p).map(|i| gamma[i] * xtx[(i, p)]).sum::<f64>()
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
        let period =
            if k - start > 1 { (rows.time_s[k - 1] - rows.time_s[start]) / (k - 1 - start) as f64 } else { 0.0 };
        // Seven points are needed; a stretch of fewer rows adds nothing.
        if k - start >= 7 {
            let part = differentiate(&signal[start..k], period, Stencil::Seven, 1).ok()?;
            rate[start..k].copy_from_slice(&part);
        }
        start = k;
    }
    Some(rate)
}
