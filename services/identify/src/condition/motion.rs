//! Low-pass, derivatives and decimation of a regular stretch.

use super::signals::{Regular, Sampling};
use super::{BRISTLE_WIDTHS_RAD, ORDER, Plan, ROW_RATE, Saturation, Stretch, WORKING_RATE, mask};
use lacuna_estimation::EstimationError;
use lacuna_estimation::filter::{Stencil, ZeroPhase, differentiate};
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::effects::DirectionLaw;
use rayon::prelude::*;

/// Every how many recorded samples a working sample is taken.
pub(super) fn factor(plan: &Plan, sampling: &Sampling) -> usize {
    ((sampling.rate_hz / (WORKING_RATE * plan.band_hz)) + 1e-9).floor().max(1.0) as usize
}

/// Shortest stretch that leaves rows [s].
pub(super) fn shortest_s(plan: &Plan, sampling: &Sampling, cut_s: f64) -> f64 {
    let working = factor(plan, sampling) as f64 / sampling.rate_hz;
    // Twenty samples are what the filters' own padding needs; the rest is cut off again.
    (2.0 * cut_s + 4.0 * working).max(20.0 * working)
}

/// Every how many working samples a row is taken.
pub(super) fn row_step(plan: &Plan, sampling: &Sampling) -> usize {
    let period_s = factor(plan, sampling) as f64 / sampling.rate_hz;
    (1.0 / (ROW_RATE * plan.band_hz * period_s) + 1e-9).floor().max(1.0) as usize
}

/// The part's signals at the working rate.
pub(super) fn stretch(
    mut part: Regular,
    robot: &RobotFile,
    plan: &Plan,
    sampling: &Sampling,
    saturation: &[Option<Saturation>],
    cut: usize,
) -> Result<Stretch, BadInput> {
    let rate = sampling.rate_hz;
    let len = part.q.first().map_or(0, Vec::len);
    let k = factor(plan, sampling);
    let period_s = k as f64 / rate;
    let enabled = robot.columns.enabled.as_ref().and_then(|name| part.extra.get(name));
    // Interpolated between on and off is neither.
    let usable: Vec<bool> = (0..len).map(|i| enabled.is_none_or(|e| e[i] >= 0.999)).collect();
    let pad = (plan.reversal_s * rate).round() as usize;
    let clipped: Vec<Vec<bool>> = part
        .tau
        .iter()
        .enumerate()
        .map(|(j, tau)| mask::clipped(tau, saturation.get(j).and_then(Option::as_ref), pad))
        .collect();

    let low_pass = ZeroPhase::butterworth(ORDER, plan.position_band_hz, rate)?;
    let mut columns: Vec<&mut [f64]> = part.q.iter_mut().chain(part.tau.iter_mut()).map(Vec::as_mut_slice).collect();
    // Four columns are filtered in the time of one, so they stay together.
    columns.par_chunks_mut(4).try_for_each(|group| low_pass.apply_columns(group))?;
    let joints: Vec<Joint> = part
        .q
        .par_iter()
        .zip(&clipped)
        .map(|(q, clipped)| joint(q, &usable, clipped, plan, rate, k))
        .collect::<Result<_, EstimationError>>()?;
    let mut out = Stretch {
        start_s: part.start_s,
        period_s,
        q_rad: part.q.iter().map(|c| every(c, k)).collect(),
        qd_rad_s: Vec::new(),
        qdd_rad_s2: Vec::new(),
        sign: Vec::new(),
        bristles: Vec::new(),
        tau_nm: part.tau.iter().map(|c| every(c, k)).collect(),
        extra: part.extra.iter().map(|(name, c)| (name.clone(), every(c, k))).collect(),
        usable: every(&usable, k),
        counted: Vec::new(),
        fitted: Vec::new(),
        cut,
        row_step: row_step(plan, sampling),
        filter: ZeroPhase::butterworth(ORDER, plan.band_hz, rate / k as f64)?,
    };
    for j in joints {
        out.qd_rad_s.push(j.qd);
        out.qdd_rad_s2.push(j.qdd);
        out.sign.push(j.sign);
        out.bristles.push(j.bristles);
        out.counted.push(j.counted);
        out.fitted.push(j.fitted);
    }
    Ok(out)
}

/// What follows from one joint's position.
struct Joint {
    qd: Vec<f64>,
    qdd: Vec<f64>,
    sign: Vec<f64>,
    bristles: Vec<Vec<f64>>,
    counted: Vec<bool>,
    fitted: Vec<bool>,
}

fn joint(
    q: &[f64],
    usable: &[bool],
    clipped: &[bool],
    plan: &Plan,
    rate: f64,
    k: usize,
) -> Result<Joint, EstimationError> {
    let velocity = differentiate(q, 1.0 / rate, Stencil::Seven, 1)?;
    let acceleration = differentiate(q, 1.0 / rate, Stencil::Seven, 2)?;
    let ramp = DirectionLaw::Ramp { width_rad_s: plan.standstill_rad_s };
    let widths: &[f64] = if plan.bristle { &BRISTLE_WIDTHS_RAD } else { &[] };
    let bristle = |&width_rad| DirectionLaw::Bristle { width_rad, kappa_s_rad: 0.0 };
    let (counted, fitted) = mask::moving(&velocity, usable, clipped, plan, rate);
    Ok(Joint {
        sign: mask::direction(q, &velocity, ramp, k),
        bristles: widths.iter().map(|w| mask::direction(q, &velocity, bristle(w), k)).collect(),
        counted: every(&counted, k),
        fitted: every(&fitted, k),
        qd: every(&velocity, k),
        qdd: every(&acceleration, k),
    })
}

fn every<T: Copy>(x: &[T], step: usize) -> Vec<T> {
    x.iter().copied().step_by(step).collect()
}
