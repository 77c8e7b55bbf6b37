//! Pooled fit of all base parameters and friction: weighted by each joint's noise, robust against outliers, with a
//! covariance that holds for residuals correlated in time.
//!
//! Everything is a matter of the sums of [`crate::sums`]: the rows themselves are looked at again only to bound the
//! influence of large residuals.
//!
//! ```text
//! β = argmin Σ_j Σ_k h_jk (τ_jk − X_jk β)² / σ_j²          σ_j and Huber's h from the residuals, in turn
//! V = (B − 1)/B Σ_b (β₍₋b₎ − β̄)(β₍₋b₎ − β̄)ᵀ                 β₍₋b₎: the fit without block b of time
//! ```
//!
//! The delete-one-block jackknife (Künsch 1989; for independent blocks the CR3 estimate of cluster-robust
//! regression) needs no model of the residual's spectrum, holds across joints, and does not shrink with the number
//! of parameters as plain cluster sums do.

pub(crate) mod commanded;
pub(crate) mod draft;
pub(crate) mod instruments;
pub(crate) mod normal;
pub(crate) mod robust;
mod support;
mod triangles;

use crate::options::Options;
use crate::split::Span;
use draft::{Data, Draft};
use instruments::InstrumentSums;
pub(crate) use instruments::Motion;
pub use instruments::{InstrumentCheck, InstrumentMotion, Instruments};
use lacuna_estimation::least_squares::Gram;
use lacuna_estimation::stats::normal_quantile;
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use robust::Store;

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
    /// Whether the fit is by QR, because normal equations could not carry every column that the data tell apart.
    pub by_qr: bool,
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

/// Memory for what bounded influence takes off, over the drafts that are worked on together [bytes].
const LOSS_MEMORY: usize = 64 << 20;

/// Fits every set of training spans, each with nuisances chosen by itself alone; `finish` makes the result of a draft
/// that is done.
///
/// # Errors
/// [`BadInput`] if no row is left, or fewer than parameters.
pub(crate) fn fit_all<T>(
    data: Data<'_>,
    store: &Store,
    trains: &[&[Span]],
    options: &Options,
    mut finish: impl FnMut(&Draft, Solution, Option<InstrumentCheck>) -> Result<T, BadInput>,
) -> Result<Vec<T>, BadInput> {
    let layout = &data.stream.layout;
    let per_cell = layout.iter().map(|l| 8 * (l.width() + 1).pow(2)).sum::<usize>() + instruments::bytes(layout);
    let together = (LOSS_MEMORY / (per_cell * data.sums.cells.list.len()).max(1)).max(1);
    let with_instruments = match options.instruments {
        Instruments::Auto => instruments::noise_share(data)? > instruments::NOISE_SHARE,
        chosen => chosen != Instruments::Off,
    };
    let motion = if with_instruments { Some(Motion::choose(data, options.instruments)?) } else { None };
    let mut out = Vec::with_capacity(trains.len());
    for group in trains.chunks(together) {
        let mut drafts: Vec<Draft> =
            group.iter().map(|train| Draft::new(data, train, options.delay)).collect::<Result<_, _>>()?;
        for round in 0..2 * usize::from(options.robust) {
            robust::reweigh(data, store, &mut drafts)?;
            drafts.iter_mut().try_for_each(|d| d.refit(data, round == 0))?;
        }
        for _ in 0..1 + usize::from(options.robust) {
            if drafts.iter().any(|d| d.choice.lossy) {
                triangles::pass(data, &mut drafts, options.robust)?;
                drafts.iter_mut().filter(|d| d.choice.lossy).try_for_each(|d| d.refit_by_qr(data))?;
            }
        }
        let settled = drafts.iter().map(|d| support::settle(data, d, &d.factored(data)?)).collect::<Result<_, _>>()?;
        let checked = match &motion {
            Some(motion) => with_motion(data, store, &mut drafts, settled, motion, options)?,
            None => settled.into_iter().map(|s| (s, None)).collect::<Vec<_>>(),
        };
        for (draft, (solution, check)) in drafts.iter_mut().zip(checked) {
            draft.beta = solution.beta.clone();
            draft.rescale(data);
            out.push(finish(draft, Solution { sigma: draft.sigma.clone(), ..solution }, check)?);
        }
    }
    Ok(out)
}

/// Rounds of instruments: from the second on, influence is bounded by residuals from the estimate before, not from least
/// squares, whose bias would be kept in the weights.
const ROUNDS: usize = 3;

/// The fits by least squares, replaced where instruments are used, with the check.
fn with_motion(
    data: Data<'_>,
    store: &Store,
    drafts: &mut [Draft],
    settled: Vec<Solution>,
    motion: &Motion,
    options: &Options,
) -> Result<Vec<(Solution, Option<InstrumentCheck>)>, BadInput> {
    let mut out: Vec<(Solution, Option<InstrumentCheck>)> = settled.iter().map(|s| (s.clone(), None)).collect();
    for round in 0..ROUNDS {
        let sums = InstrumentSums::new(data, drafts, motion)?;
        let mut again = false;
        for (d, (draft, plain)) in drafts.iter_mut().zip(&settled).enumerate() {
            let (solution, check) = &mut out[d];
            if round > 0 && !check.as_ref().is_some_and(|c| c.used) {
                continue;
            }
            let Some((own, found)) = sums.solve(data, d, draft, plain) else { continue };
            let used = round > 0 || options.instruments != Instruments::Auto || found.statistic.abs() > found.threshold;
            if used {
                draft.beta = own.beta.clone();
                draft.rescale(data);
                *solution = own;
                again = options.robust;
            }
            *check = Some(InstrumentCheck { used, ..found });
        }
        if !again || round + 1 == ROUNDS {
            break;
        }
        robust::reweigh(data, store, drafts)?;
    }
    Ok(out)
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
