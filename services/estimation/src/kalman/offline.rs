//! The full forward-backward smoother, in place: the forward pass leaves the filtered states in the output,
//! the backward pass replaces them by the smoothed ones.
//!
//! Step numbers (gains, covariances) are made per block of time and remade for the backward pass where they
//! are too many to keep, so that memory beyond the output stays below about 100 MB however long and
//! irregular the recording is.

use super::gain::{Forward, Gains, Mean, Period, Step, carried, grouped};
use super::small::{Vector, apply, congruence_plus};
use super::{MotionModel, PRIOR_SD, Settings, Smoothed};
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
/// positions, with derivatives 0 and the standard deviations of [`PRIOR_SD`].
///
/// # Errors
/// [`EstimationError`] if settings, lengths, time or a sample cannot be used.
pub fn smooth(settings: &Settings, t_s: &[f64], q_rad: &[&[f64]]) -> Result<Smoothed, EstimationError> {
    check(settings, t_s, q_rad)?;
    Ok(match settings.model {
        MotionModel::ConstantAcceleration => smooth_order::<3>(settings, t_s, q_rad),
        MotionModel::ConstantJerk => smooth_order::<4>(settings, t_s, q_rad),
    })
}

/// Smooths a recording piece by piece with bounded memory: pieces of `block` samples, each with `overlap`
/// samples of past and future around it, are handed to `sink` as (index of the first sample, piece), in order.
///
/// The influence of what lies beyond the overlap decays like exp(−overlap/memory); with an overlap of 20/π
/// divided by bandwidth × period (see [`super::Noise::bandwidth_hz`]) the difference from [`smooth`] is about
/// 1e-9 of the smoother's own correction.
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
    for start in (0..t_s.len()).step_by(block) {
        let end = (start + block).min(t_s.len());
        let range = start.saturating_sub(overlap)..(end + overlap).min(t_s.len());
        let views: Vec<&[f64]> = q_rad.iter().map(|q| &q[range.clone()]).collect();
        let mut piece = smooth(settings, &t_s[range.clone()], &views)?;
        let keep = start - range.start..end - range.start;
        for list in piece.lists_mut() {
            for signal in list {
                signal.truncate(keep.end);
                signal.drain(..keep.start);
            }
        }
        // The piece's own first sample is a start only if the recording's is.
        let cut = range.start;
        piece.starts = piece.starts.iter().map(|s| s + cut).filter(|s| (start..end).contains(s)).collect();
        piece.starts.retain(|&s| s == 0 || s > cut || t_s[s] - t_s[s - 1] > settings.gap_s);
        piece.starts.iter_mut().for_each(|s| *s -= start);
        sink(start, &piece);
    }
    Ok(())
}

impl Smoothed {
    fn lists_mut(&mut self) -> [&mut Vec<Vec<f64>>; 6] {
        [
            &mut self.q_rad,
            &mut self.qd_rad_s,
            &mut self.qdd_rad_s2,
            &mut self.sd_q_rad,
            &mut self.sd_qd_rad_s,
            &mut self.sd_qdd_rad_s2,
        ]
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

fn smooth_order<const N: usize>(settings: &Settings, t_s: &[f64], q_rad: &[&[f64]]) -> Smoothed {
    let (groups, group_of) = grouped::<N>(settings);
    let n = t_s.len();
    // x[joint][derivative][sample], sd[group][derivative][sample]
    let mut x: Vec<[Vec<f64>; N]> = q_rad.iter().map(|_| std::array::from_fn(|_| vec![0.0; n])).collect();
    let mut sd: Vec<[Vec<f64>; 3]> = groups.iter().map(|_| std::array::from_fn(|_| vec![0.0; n])).collect();
    let mut starts = Vec::new();
    for range in segments(t_s, settings.gap_s) {
        starts.push(range.start);
        let mut stretch = Stretch { settings, t_s, q_rad, group_of: &group_of, range, period: Period::new(settings) };
        stretch.smooth(&groups, &mut x, &mut sd);
    }
    let mut out = Smoothed { starts, ..Smoothed::default() };
    for (joint, signals) in x.into_iter().enumerate() {
        let mut signals = signals.into_iter();
        for list in [&mut out.q_rad, &mut out.qd_rad_s, &mut out.qdd_rad_s2] {
            list.push(signals.next().unwrap_or_default());
        }
        let own = &mut sd[group_of[joint]];
        let last_use = !group_of[joint + 1..].contains(&group_of[joint]);
        for (list, signal) in [&mut out.sd_q_rad, &mut out.sd_qd_rad_s, &mut out.sd_qdd_rad_s2].into_iter().zip(own) {
            list.push(if last_use { std::mem::take(signal) } else { signal.clone() });
        }
    }
    out
}

/// Step numbers of a block: entry k is the step from sample `first` + k to the next.
#[derive(Debug, Default)]
struct Plan<const N: usize> {
    steps: Vec<Step<N>>,
    /// Which of `steps`, per step of time; equal steps share one.
    index: Vec<u32>,
}

impl<const N: usize> Plan<N> {
    fn step(&self, k: usize) -> &Step<N> {
        &self.steps[self.index[k] as usize]
    }

    /// End of the run of equal steps from `k`, at most `end`.
    fn run_end(&self, k: usize, end: usize) -> usize {
        let same = self.index[k];
        self.index[k..end].iter().position(|i| *i != same).map_or(end, |len| k + len)
    }

    /// Makes the steps within `range` of samples, going on from `gains`.
    fn make(t_s: &[f64], range: Range<usize>, gains: &mut Gains<N>, period: &mut Period) -> Self {
        let mut plan = Self { steps: Vec::new(), index: Vec::with_capacity(range.len()) };
        let mut shared = false;
        for k in range {
            let step = *gains.advance(period.classify(t_s[k + 1] - t_s[k]));
            if !(shared && gains.at_steady()) {
                plan.steps.push(step);
            }
            shared = gains.at_steady();
            plan.index.push(plan.steps.len() as u32 - 1);
        }
        plan
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
    settings: &'a Settings,
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
            for (i, signal) in signals.iter_mut().enumerate() {
                signal[last] = p[i][i].sqrt();
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
            let sd_q = self.settings.noise[j].measurement_sd;
            let unknown = [sd_q, PRIOR_SD[0], PRIOR_SD[1]];
            for (signal, v) in sd[self.group_of[j]].iter_mut().zip(unknown) {
                signal[self.range.clone()].fill(v);
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
        let unknown = |k: usize| plans.iter().any(|p| matches!(p.step(k).forward, Forward::Information { .. }));
        while begin < block.end && unknown(begin - block.start) {
            for (j, mean) in means.iter_mut().enumerate() {
                let g = self.group_of[j];
                let step = plans[g].step(begin - block.start);
                let filtered = mean.x;
                let a =
                    mean.advance(step, self.t_s[begin + 1] - self.t_s[begin], self.q_rad[j][begin + 1], gains[g].r());
                let keep = if matches!(step.forward, Forward::Gain { .. }) { filtered } else { a };
                for (signal, v) in x[j].iter_mut().zip(keep) {
                    signal[begin] = v;
                }
            }
            begin += 1;
        }
        let work = begin..block.end;
        for (c, (x, means)) in x.chunks_mut(LANES).zip(means.chunks_mut(LANES)).enumerate() {
            let joints = c * LANES;
            match x.len() {
                4 => self.forward_lanes::<N, 4>(joints, &work, block.start, plans, means, x),
                3 => self.forward_lanes::<N, 3>(joints, &work, block.start, plans, means, x),
                2 => self.forward_lanes::<N, 2>(joints, &work, block.start, plans, means, x),
                _ => self.forward_lanes::<N, 1>(joints, &work, block.start, plans, means, x),
            }
        }
    }

    fn forward_lanes<const N: usize, const J: usize>(
        &self,
        joints: usize,
        work: &Range<usize>,
        offset: usize,
        plans: &[Plan<N>],
        means: &mut [Mean<N>],
        x: &mut [[Vec<f64>; N]],
    ) {
        let own: [&Plan<N>; J] = std::array::from_fn(|l| &plans[self.group_of[joints + l]]);
        let mut state: [Vector<N>; J] = std::array::from_fn(|l| means[l].x);
        let mut k = work.start;
        while k < work.end {
            let end = own.iter().map(|p| p.run_end(k - offset, work.end - offset)).min().unwrap_or(0) + offset;
            let gain: [Vector<N>; J] = std::array::from_fn(|l| match own[l].step(k - offset).forward {
                Forward::Gain { k, .. } => k,
                Forward::Information { .. } => [0.0; N],
            });
            let len = end - k;
            let t = &self.t_s[k..=end];
            let z: [&[f64]; J] = std::array::from_fn(|l| &self.q_rad[joints + l][k + 1..=end]);
            let mut lanes = x.iter_mut();
            let out: [[&mut [f64]; N]; J] = std::array::from_fn(|_| match lanes.next() {
                Some(signals) => signals.each_mut().map(|s| &mut s[k..end]),
                None => std::array::from_fn(|_| Default::default()),
            });
            for m in 0..len {
                let dt = t[m + 1] - t[m];
                for l in 0..J {
                    for i in 0..N {
                        out[l][i][m] = state[l][i];
                    }
                    let predicted = carried(&state[l], dt);
                    let innovation = z[l][m] - predicted[0];
                    for i in 0..N {
                        state[l][i] = predicted[i] + gain[l][i] * innovation;
                    }
                }
            }
            k = end;
        }
        for l in 0..J {
            means[l].x = state[l];
        }
    }

    /// Smooths the samples `block` backward from the smoothed sample `block.end`.
    fn backward<const N: usize>(&self, block: Range<usize>, plans: &[Plan<N>], x: &mut [[Vec<f64>; N]]) {
        for (c, x) in x.chunks_mut(LANES).enumerate() {
            let joints = c * LANES;
            match x.len() {
                4 => self.backward_lanes::<N, 4>(joints, &block, plans, x),
                3 => self.backward_lanes::<N, 3>(joints, &block, plans, x),
                2 => self.backward_lanes::<N, 2>(joints, &block, plans, x),
                _ => self.backward_lanes::<N, 1>(joints, &block, plans, x),
            }
        }
    }

    fn backward_lanes<const N: usize, const J: usize>(
        &self,
        joints: usize,
        block: &Range<usize>,
        plans: &[Plan<N>],
        x: &mut [[Vec<f64>; N]],
    ) {
        let own: [&Plan<N>; J] = std::array::from_fn(|l| &plans[self.group_of[joints + l]]);
        let mut state: [Vector<N>; J] = std::array::from_fn(|l| std::array::from_fn(|i| x[l][i][block.end]));
        let mut end = block.end;
        while end > block.start {
            let k = own.iter().map(|p| run_start(&p.index, end - 1 - block.start)).max().unwrap_or(0) + block.start;
            let c: [[Vector<N>; N]; J] = std::array::from_fn(|l| own[l].step(k - block.start).back.c);
            let direct: [bool; J] =
                std::array::from_fn(|l| matches!(own[l].step(k - block.start).forward, Forward::Information { .. }));
            let t = &self.t_s[k..=end];
            let mut lanes = x.iter_mut();
            let out: [[&mut [f64]; N]; J] = std::array::from_fn(|_| match lanes.next() {
                Some(signals) => signals.each_mut().map(|s| &mut s[k..end]),
                None => std::array::from_fn(|_| Default::default()),
            });
            for m in (0..end - k).rev() {
                let dt = t[m + 1] - t[m];
                for l in 0..J {
                    let kept: Vector<N> = std::array::from_fn(|i| out[l][i][m]);
                    let from = if direct[l] { [0.0; N] } else { carried(&kept, dt) };
                    let news = apply(&c[l], &std::array::from_fn(|i| state[l][i] - from[i]));
                    for i in 0..N {
                        state[l][i] = kept[i] + news[i];
                        out[l][i][m] = state[l][i];
                    }
                }
            }
            end = k;
        }
    }
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
            for i in 0..3 {
                let root = p[i][i].sqrt();
                if settled {
                    sd[i][k..=m].fill(root);
                } else {
                    sd[i][m] = root;
                }
            }
            if settled {
                break;
            }
        }
        end = k;
    }
}
