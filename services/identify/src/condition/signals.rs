//! Repair of the raw signals and regular sampling.

use super::Plan;
use lacuna_estimation::filter::{
    Interpolation, SpikeRule, median_step, remove_spikes, resample, segments, unwrap_angles,
};
use lacuna_interfaces::{BadInput, Recording, Repair, RepairKind, RobotFile};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::ops::Range;

/// Share of a position's range below which nothing is a spike.
pub const SPIKE_SHARE_POSITION: f64 = 1e-4;
/// The same of a torque.
pub const SPIKE_SHARE_TORQUE: f64 = 1e-2;
/// A step longer than this many median steps is a gap.
const GAP_FACTOR: f64 = 10.0;
/// Share of the median step by which sampling may wander before it counts as irregular.
const JITTER: f64 = 0.1;

/// Refuses a recording that is not one of the robot's.
pub(super) fn check(recording: &Recording, robot: &RobotFile) -> Result<(), BadInput> {
    let n = robot.joint_count();
    if recording.joints != robot.joints {
        return Err(BadInput::new(format!(
            "found joints {}; expected the robot file's, {}",
            recording.joints.join(", "),
            robot.joints.join(", ")
        )));
    }
    let len = recording.len();
    for (what, list) in [("q", &recording.q_rad), ("tau", &recording.tau_nm)] {
        if list.len() != n {
            return Err(BadInput::new(format!("found {} {what} columns; expected {n}, one per joint", list.len())));
        }
        if let Some(column) = list.iter().find(|c| c.len() != len) {
            return Err(BadInput::new(format!(
                "found {} {what} samples for {len} times; expected as many",
                column.len()
            )));
        }
    }
    Ok(())
}

/// Unwraps angles and removes single-sample spikes of position and torque in place; returns what was done.
pub(super) fn repair(recording: &mut Recording, plan: &Plan) -> Vec<Repair> {
    // The reader undoes wraps near ±π; between two samples no joint turns half a turn, so the rest is wraps too.
    let found_q: Vec<(usize, usize)> = recording
        .q_rad
        .par_iter_mut()
        .map(|column| (unwrap_angles(column, TAU), despike(column, SPIKE_SHARE_POSITION, plan.spike_threshold)))
        .collect();
    let found_tau: Vec<usize> = recording
        .tau_nm
        .par_iter_mut()
        .map(|column| despike(column, SPIKE_SHARE_TORQUE, plan.spike_threshold))
        .collect();
    let mut repairs = Vec::new();
    let mut note = |kind, signal: String, count: usize| {
        if count > 0 {
            repairs.push(Repair { file: recording.name.clone(), kind, signal, count: count as u64 });
        }
    };
    for (j, (wraps, spikes)) in found_q.into_iter().enumerate() {
        note(RepairKind::Unwrapped, format!("q{}", j + 1), wraps);
        note(RepairKind::Spike, format!("q{}", j + 1), spikes);
    }
    for (j, spikes) in found_tau.into_iter().enumerate() {
        note(RepairKind::Spike, format!("tau{}", j + 1), spikes);
    }
    repairs
}

/// Removes spikes larger than `share` of the signal's range.
fn despike(column: &mut [f64], share: f64, threshold: f64) -> usize {
    if threshold == 0.0 {
        return 0;
    }
    let rule = SpikeRule::of(column, share, threshold);
    remove_spikes(column, &rule).len()
}

/// How a recording is sampled.
#[derive(Debug, Clone)]
pub(super) struct Sampling {
    pub(super) rate_hz: f64,
    pub(super) irregular: bool,
    /// Sample ranges without gaps.
    pub(super) ranges: Vec<Range<usize>>,
}

impl Sampling {
    pub(super) fn of(t_s: &[f64], plan: &Plan) -> Result<Self, BadInput> {
        let step = median_step(t_s).filter(|s| s.is_finite() && *s > 0.0).ok_or_else(|| {
            BadInput::new(format!("found {} samples; expected at least 2 at increasing times", t_s.len()))
        })?;
        let ranges = segments(t_s, GAP_FACTOR * step);
        // The mean step of the longest stretch is known far better than the median step, which rounding may have touched.
        let longest = ranges.iter().max_by_key(|r| r.len()).cloned().unwrap_or(0..t_s.len());
        let mean = (t_s[longest.end - 1] - t_s[longest.start]) / (longest.len() - 1).max(1) as f64;
        let wanders = |r: &Range<usize>| {
            (r.clone()).any(|k| (t_s[k] - t_s[r.start] - (k - r.start) as f64 * mean).abs() > JITTER * mean)
        };
        let irregular = mean <= 0.0 || ranges.iter().any(wanders);
        let own = if irregular { 1.0 / step } else { 1.0 / mean };
        // Rates are whole numbers of hertz; the stamps' rounding is not.
        let own = if own > 10.0 && (own - own.round()).abs() < 5e-3 * own { own.round() } else { own };
        match plan.rate_hz {
            Some(rate) if (rate - own).abs() > 1e-6 * own => Ok(Self { rate_hz: rate, irregular: true, ranges }),
            _ => Ok(Self { rate_hz: own, irregular, ranges }),
        }
    }
}

/// A part of a gap-free stretch at regular times.
pub(super) struct Regular {
    pub(super) start_s: f64,
    pub(super) q: Vec<Vec<f64>>,
    pub(super) tau: Vec<Vec<f64>>,
    pub(super) extra: BTreeMap<String, Vec<f64>>,
}

/// Recorded samples on either side of a part that its interpolation looks at: a natural spline forgets 0.27-fold from
/// sample to sample.
const SPLINE_REACH: usize = 24;

impl Sampling {
    /// Number of regular samples of a gap-free range of recorded ones.
    pub(super) fn regular_len(&self, t_s: &[f64], range: &Range<usize>) -> usize {
        if !self.irregular {
            return range.len();
        }
        let duration = t_s[range.end - 1] - t_s[range.start];
        (duration * self.rate_hz + 1e-9).floor() as usize + 1
    }

    /// Time of regular sample `k` of a range [s].
    pub(super) fn time_s(&self, t_s: &[f64], range: &Range<usize>, k: usize) -> f64 {
        if self.irregular { t_s[range.start] + k as f64 / self.rate_hz } else { t_s[range.start + k] }
    }
}

/// Brings the regular samples `part` of the gap-free `range` about, and undoes the torque's delay.
pub(super) fn regular(
    recording: &Recording,
    positions: &[&[f64]],
    range: &Range<usize>,
    part: Range<usize>,
    sampling: &Sampling,
    delay_s: f64,
) -> Result<Regular, BadInput> {
    let grid: Vec<f64> = part.clone().map(|k| sampling.time_s(&recording.t_s, range, k)).collect();
    let (first, last) = (grid.first().copied().unwrap_or(0.0), grid.last().copied().unwrap_or(0.0));
    // Recorded samples behind these: all for a straight copy, else with what the interpolation looks at.
    let all = &recording.t_s[range.clone()];
    let low = all.partition_point(|t| *t < first.min(first + delay_s)).saturating_sub(SPLINE_REACH);
    let high = (all.partition_point(|t| *t <= last.max(last + delay_s)) + SPLINE_REACH).min(all.len());
    let near = range.start + low..range.start + high;
    let own = range.start + part.start..range.start + part.end;
    let t = &recording.t_s[near.clone()];
    let torques: Vec<&[f64]> = recording.tau_nm.iter().map(Vec::as_slice).collect();
    let cut = |columns: &[&[f64]]| -> Vec<Vec<f64>> { columns.iter().map(|c| c[own.clone()].to_vec()).collect() };
    let on = |columns: &[&[f64]], grid: &[f64]| -> Result<Vec<Vec<f64>>, BadInput> {
        columns.iter().map(|c| Ok(resample(t, &c[near.clone()], grid, Interpolation::Cubic)?)).collect()
    };
    let q = if sampling.irregular { on(positions, &grid)? } else { cut(positions) };
    let tau = if sampling.irregular || delay_s != 0.0 {
        let late: Vec<f64> = grid.iter().map(|t| t + delay_s).collect();
        on(&torques, &late)?
    } else {
        cut(&torques)
    };
    let mut extra = BTreeMap::new();
    for (name, column) in recording.extra.iter().filter(|(_, c)| c.len() == recording.len()) {
        // A further column with a value missing is of no use, but no reason to refuse the recording.
        if column[near.clone()].iter().all(|v| v.is_finite()) {
            let values = if sampling.irregular {
                resample(t, &column[near.clone()], &grid, Interpolation::Linear)?
            } else {
                column[own.clone()].to_vec()
            };
            extra.insert(name.clone(), values);
        }
    }
    Ok(Regular { start_s: first, q, tau, extra })
}
