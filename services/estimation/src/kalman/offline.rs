//! The full forward-backward smoother, in place: the forward pass leaves the filtered states in the output,
//! the backward pass replaces them by the smoothed ones.
//!
//! Step numbers (gains, covariances) are made per block of time and remade for the backward pass where they
//! are too many to keep, so that memory beyond the output stays below about 100 MB however long and
//! irregular the recording is.

use super::gain::{Gains, Mean, Period, deviations, group};
use super::lanes::{self, Plan};
use super::small::{Vector, congruence_plus};
use super::{MotionModel, Settings, Smoothed};
use crate::error::{EstimationError, all_finite, increasing, same_length};
use crate::filter::segments;
use std::ops::Range;

/// Samples whose step numbers are made at a time.
const BLOCK: usize = 8192;
/// Steps kept for the backward pass, all groups together; beyond, blocks are computed twice.
const STEPS_KEPT: usize = 400_000;
/// Joints filtered in lock step: independent recursions fill each other's waiting times.
const LANES: usize = 4;

/// Smooths a recording forward and backward (RTS). `t_s` strictly increasing; `q_rad[joint][sample]`.
///
/// A stretch between gaps that is too short to determine a state (fewer than N samples) keeps its measured
/// positions, with derivatives 0 and the standard deviations of [`super::PRIOR_SD`].
///
/// # Errors
/// [`EstimationError`] if settings, lengths, time or a sample cannot be used.
pub fn smooth(settings: &Settings, t_s: &[f64], q_rad: &[&[f64]]) -> Result<Smoothed, EstimationError> {
    let mut out = Smoothed::default();
    smooth_into(settings, t_s, q_rad, &mut out)?;
    Ok(out)
}

/// As [`smooth`], into the memory of an earlier result: fresh memory costs more than the smoothing itself.
///
/// # Errors
/// As [`smooth`]; `out` is then unchanged.
pub fn smooth_into(
    settings: &Settings,
    t_s: &[f64],
    q_rad: &[&[f64]],
    out: &mut Smoothed,
) -> Result<(), EstimationError> {
    check(settings, t_s, q_rad)?;
    match settings.model {
        MotionModel::ConstantAcceleration => smooth_order::<3>(settings, t_s, q_rad, out),
        MotionModel::ConstantJerk => smooth_order::<4>(settings, t_s, q_rad, out),
    }
    Ok(())
}

/// Smooths a recording piece by piece with bounded memory: pieces of `block` samples, each with `overlap`
/// samples of past and future around it, are handed to `sink` as (index of the first sample, piece), in order.
///
/// What lies beyond the overlap matters like exp(−overlap/memory): with an overlap of 20/π divided by bandwidth
/// × period (see [`super::Noise::bandwidth_hz`]) the difference from [`smooth`] is about 2e-9 of the smoother's
/// own correction (constant jerk: 2e-7).
///
/// # Errors
/// As [`smooth`], or for a block of 0 samples.
pub fn smooth_blocks(
    settings: &Settings,
    t_s: &[f64],
    q_rad: &[&[f64]],
    block: usize,
    overlap: usize,
    sink: &mut dyn FnMut(usize, &Smoothed),
) -> Result<(), EstimationError> {
    check(settings, t_s, q_rad)?;
    crate::error::positive("block", block as f64)?;
    let mut piece = Smoothed::default();
    for start in (0..t_s.len()).step_by(block) {
        let end = (start + block).min(t_s.len());
        let range = start.saturating_sub(overlap)..(end + overlap).min(t_s.len());
        let views: Vec<&[f64]> = q_rad.iter().map(|q| &q[range.clone()]).collect();
        smooth_into(settings, &t_s[range.clone()], &views, &mut piece)?;
        let keep = start - range.start..end - range.start;
        for signal in piece.signals_mut() {
            signal.truncate(keep.end);
            signal.drain(..keep.start);
        }
        // The piece's own first sample is a start only if the recording's is.
        let cut = range.start;
        piece.starts.iter_mut().for_each(|s| *s += cut);
        piece.starts.retain(|&s| (start..end).contains(&s));
        piece.starts.retain(|&s| s == 0 || s > cut || t_s[s] - t_s[s - 1] > settings.gap_s);
        piece.starts.iter_mut().for_each(|s| *s -= start);
        sink(start, &piece);
    }
    Ok(())
}

impl Smoothed {
    fn signals_mut(&mut self) -> impl Iterator<Item = &mut Vec<f64>> {
        let states = [&mut self.q_rad, &mut self.qd_rad_s, &mut self.qdd_rad_s2];
        states.into_iter().flatten().chain(self.deviations.iter_mut().flatten())
    }
}

fn check(settings: &Settings, t_s: &[f64], q_rad: &[&[f64]]) -> Result<(), EstimationError> {
    settings.validate()?;
    same_length("joints", q_rad.len(), settings.noise.len())?;
    increasing(t_s)?;
    for q in q_rad {
        same_length("positions", q.len(), t_s.len())?;
        all_finite("position", q)?;
    }
    Ok(())
}

fn smooth_order<const N: usize>(settings: &Settings, t_s: &[f64], q_rad: &[&[f64]], out: &mut Smoothed) {
    let mut groups: Vec<Gains<N>> = Vec::new();
    group(&settings.noise, settings.update, &mut groups, &mut out.group_of);
    out.measurement_sd.clear();
    out.measurement_sd.extend(settings.noise.iter().map(|n| n.measurement_sd));
    let (n, joints) = (t_s.len(), q_rad.len());
    let mut lists = [&mut out.q_rad, &mut out.qd_rad_s, &mut out.qdd_rad_s2, &mut out.spare];
    for list in &mut lists {
        list.resize_with(joints, Vec::new);
    }
    // x[joint][derivative][sample]; deviations[group][derivative][sample]
    let sized = |mut v: Vec<f64>| {
        v.resize(n, 0.0);
        v
    };
    let mut x: Vec<[Vec<f64>; N]> =
        (0..joints).map(|j| std::array::from_fn(|i| sized(std::mem::take(&mut lists[i][j])))).collect();
    out.deviations.resize_with(groups.len(), Default::default);
    for signal in out.deviations.iter_mut().flatten() {
        *signal = sized(std::mem::take(signal));
    }
    out.starts.clear();
    for range in segments(t_s, settings.gap_s) {
        out.starts.push(range.start);
        let period = Period::new(settings);
        let mut stretch = Stretch { t_s, q_rad, group_of: &out.group_of, range, period };
        stretch.smooth(&groups, &mut x, &mut out.deviations);
    }
    for (j, signals) in x.into_iter().enumerate() {
        for (list, signal) in lists.iter_mut().zip(signals) {
            list[j] = signal;
        }
    }
}

/// State of the covariance recursion at the start of a block, from which its plans can be made again.
struct Checkpoint<const N: usize> {
    groups: Vec<Gains<N>>,
    period: Period,
    plans: Option<Vec<Plan<N>>>,
}

/// A stretch without gaps.
struct Stretch<'a> {
    t_s: &'a [f64],
    q_rad: &'a [&'a [f64]],
    group_of: &'a [usize],
    range: Range<usize>,
    period: Period,
}

impl Stretch<'_> {
    fn smooth<const N: usize>(&mut self, groups: &[Gains<N>], x: &mut [[Vec<f64>; N]], sd: &mut [[Vec<f64>; 3]]) {
        let (first, last) = (self.range.start, self.range.end - 1);
        let mut gains: Vec<Gains<N>> = groups.to_vec();
        let mut means: Vec<Mean<N>> = self.q_rad.iter().map(|q| Mean::start(q[first])).collect();
        let mut checkpoints: Vec<Checkpoint<N>> = Vec::new();
        let mut kept = 0;
        for start in (first..last).step_by(BLOCK) {
            let block = start..(start + BLOCK).min(last);
            let mut point = Checkpoint { groups: gains.clone(), period: self.period, plans: None };
            let plans = self.plans(block.clone(), &mut gains);
            self.forward(block, &plans, &gains, &mut means, x);
            kept += plans.iter().map(|p| p.steps.len()).sum::<usize>();
            if kept <= STEPS_KEPT {
                point.plans = Some(plans);
            }
            checkpoints.push(point);
        }
        let Some(mut p) = gains.iter().map(|g| g.covariance().copied()).collect::<Option<Vec<_>>>() else {
            self.undetermined(x, sd);
            return;
        };
        for (signals, mean) in x.iter_mut().zip(&means) {
            for (signal, v) in signals.iter_mut().zip(mean.x) {
                signal[last] = v;
            }
        }
        for (signals, p) in sd.iter_mut().zip(&p) {
            for (signal, v) in signals.iter_mut().zip(deviations(p)) {
                signal[last] = v;
            }
        }
        for (b, point) in checkpoints.into_iter().enumerate().rev() {
            let start = first + b * BLOCK;
            let block = start..(start + BLOCK).min(last);
            let plans = point.plans.unwrap_or_else(|| {
                self.period = point.period;
                let mut groups = point.groups;
                self.plans(block.clone(), &mut groups)
            });
            self.backward(block.clone(), &plans, x);
            for ((plan, p), sd) in plans.iter().zip(&mut p).zip(sd.iter_mut()) {
                backward_covariance(&block, plan, p, sd);
            }
        }
    }

    /// Plans of all groups for the steps `block`; `gains` and the period go on with them.
    fn plans<const N: usize>(&mut self, block: Range<usize>, gains: &mut [Gains<N>]) -> Vec<Plan<N>> {
        let before = self.period;
        let mut make = |g: &mut Gains<N>| {
            self.period = before;
            Plan::make(self.t_s, block.clone(), g, &mut self.period)
        };
        gains.iter_mut().map(&mut make).collect()
    }

    /// Too few samples for a state: positions as measured.
    fn undetermined<const N: usize>(&self, x: &mut [[Vec<f64>; N]], sd: &mut [[Vec<f64>; 3]]) {
        for (j, signals) in x.iter_mut().enumerate() {
            for (i, signal) in signals.iter_mut().enumerate() {
                for k in self.range.clone() {
                    signal[k] = if i == 0 { self.q_rad[j][k] } else { 0.0 };
                }
            }
            for (order, signal) in sd[self.group_of[j]].iter_mut().enumerate() {
                signal[self.range.clone()].fill(if order == 0 { 1.0 } else { f64::INFINITY });
            }
        }
    }

    /// Filters over the steps `block`, leaving at every sample the filtered state (first samples: the
    /// smoother's a_k, since no filtered state exists there).
    fn forward<const N: usize>(
        &self,
        block: Range<usize>,
        plans: &[Plan<N>],
        gains: &[Gains<N>],
        means: &mut [Mean<N>],
        x: &mut [[Vec<f64>; N]],
    ) {
        // Samples in information form come one by one, each joint by itself.
        let mut begin = block.start;
        let unknown = |k: usize| plans.iter().any(|p| !p.step(k).determined());
        while begin < block.end && unknown(begin - block.start) {
            for (j, mean) in means.iter_mut().enumerate() {
                let g = self.group_of[j];
                let k = begin - block.start;
                let step = plans[g].step(k);
                let filtered = mean.x;
                let dt = self.t_s[begin + 1] - self.t_s[begin];
                let first = plans[g].first.get(k).unwrap_or(gains[g].information());
                let a = mean.advance(step, first, dt, self.q_rad[j][begin + 1]);
                let keep = if step.determined() { filtered } else { a };
                for (signal, v) in x[j].iter_mut().zip(keep) {
                    signal[begin] = v;
                }
            }
            begin += 1;
        }
        let work = begin..block.end;
        let offset = begin - block.start;
        for (c, (x, means)) in x.chunks_mut(LANES).zip(means.chunks_mut(LANES)).enumerate() {
            let joints = c * LANES..c * LANES + x.len();
            let own: Vec<&Plan<N>> = self.group_of[joints.clone()].iter().map(|g| &plans[*g]).collect();
            let times = &self.t_s[work.start..=work.end];
            let z: Vec<&[f64]> = self.q_rad[joints].iter().map(|q| &q[work.start + 1..=work.end]).collect();
            match x.len() {
                4 => lanes::forward::<N, 4>(times, &z, &own, offset, means, window(x, &work)),
                3 => lanes::forward::<N, 3>(times, &z, &own, offset, means, window(x, &work)),
                2 => lanes::forward::<N, 2>(times, &z, &own, offset, means, window(x, &work)),
                _ => lanes::forward::<N, 1>(times, &z, &own, offset, means, window(x, &work)),
            }
        }
    }

    /// Smooths the samples `block` backward from the smoothed sample `block.end`.
    fn backward<const N: usize>(&self, block: Range<usize>, plans: &[Plan<N>], x: &mut [[Vec<f64>; N]]) {
        for (c, x) in x.chunks_mut(LANES).enumerate() {
            let joints = c * LANES..c * LANES + x.len();
            let own: Vec<&Plan<N>> = self.group_of[joints].iter().map(|g| &plans[*g]).collect();
            let times = &self.t_s[block.start..=block.end];
            let reach = block.start..block.end + 1;
            match x.len() {
                4 => lanes::backward::<N, 4>(times, &own, window(x, &reach)),
                3 => lanes::backward::<N, 3>(times, &own, window(x, &reach)),
                2 => lanes::backward::<N, 2>(times, &own, window(x, &reach)),
                _ => lanes::backward::<N, 1>(times, &own, window(x, &reach)),
            }
        }
    }
}

/// The samples `range` of `J` joints' states.
fn window<'a, const N: usize, const J: usize>(
    x: &'a mut [[Vec<f64>; N]],
    range: &Range<usize>,
) -> [[&'a mut [f64]; N]; J] {
    let mut joints = x.iter_mut();
    std::array::from_fn(|_| match joints.next() {
        Some(signals) => signals.each_mut().map(|s| &mut s[range.clone()]),
        None => std::array::from_fn(|_| Default::default()),
    })
}

/// Start of the run of equal steps that ends with `k`.
fn run_start(index: &[u32], k: usize) -> usize {
    let same = index[k];
    index[..k].iter().rposition(|i| *i != same).map_or(0, |before| before + 1)
}

/// P_k = A + C P_{k+1} Cᵀ backward over the steps `block`; `p` is that of sample `block.end` before, of
/// `block.start` after. Where equal steps have made P converge, its roots are reused.
fn backward_covariance<const N: usize>(
    block: &Range<usize>,
    plan: &Plan<N>,
    p: &mut [Vector<N>; N],
    sd: &mut [Vec<f64>; 3],
) {
    let mut end = block.end;
    while end > block.start {
        let k = run_start(&plan.index, end - 1 - block.start) + block.start;
        let back = &plan.step(k - block.start).back;
        let mut m = end;
        while m > k {
            m -= 1;
            let next = congruence_plus(&back.c, p, &back.a);
            let settled = (0..N).all(|i| (next[i][i] - p[i][i]).abs() <= 1e-13 * p[i][i]);
            *p = next;
            for (signal, v) in sd.iter_mut().zip(deviations(p)) {
                if settled {
                    signal[k..=m].fill(v);
                } else {
                    signal[m] = v;
                }
            }
            if settled {
                break;
            }
        }
        end = k;
    }
}
