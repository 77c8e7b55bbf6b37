//! The passes over the data: step numbers of a block of time, and several joints run through them in lock step,
//! so that their independent recursions fill each other's waiting times.

use super::gain::{Gains, Information, Mean, Period, Step};
use super::model::carried;
use super::small::{Vector, apply};
use std::ops::Range;

/// Step numbers of a block: entry k is the step from sample `first` + k to the next.
#[derive(Debug, Default)]
pub(super) struct Plan<const N: usize> {
    pub steps: Vec<Step<N>>,
    /// Which of `steps`, per step of time; equal steps share one.
    pub index: Vec<u32>,
    /// Forward parts of the first steps, while the state is not determined.
    pub first: Vec<Information<N>>,
}

impl<const N: usize> Plan<N> {
    pub fn step(&self, k: usize) -> &Step<N> {
        &self.steps[self.index[k] as usize]
    }

    /// Makes the steps within `range` of samples, going on from `gains`.
    pub fn make(t_s: &[f64], range: Range<usize>, gains: &mut Gains<N>, period: &mut Period) -> Self {
        let mut plan = Self { steps: Vec::new(), index: Vec::with_capacity(range.len()), first: Vec::new() };
        let mut shared = false;
        for k in range {
            let step = *gains.advance(period.classify(t_s[k + 1] - t_s[k]));
            if !(shared && gains.at_steady()) {
                plan.steps.push(step);
            }
            shared = gains.at_steady();
            if !step.determined() {
                plan.first.push(*gains.information());
            }
            plan.index.push(plan.steps.len() as u32 - 1);
        }
        plan
    }
}

/// Filters `J` joints over the steps of `plans` from step `offset` on. `t` has one entry more than the
/// measurements `z`, which begin at the second sample; `out` takes the filtered states from the first on.
pub(super) fn forward<const N: usize, const J: usize>(
    t: &[f64],
    z: &[&[f64]],
    plans: &[&Plan<N>],
    offset: usize,
    means: &mut [Mean<N>],
    out: [[&mut [f64]; N]; J],
) {
    let z: [&[f64]; J] = std::array::from_fn(|l| z[l]);
    let index: [&[u32]; J] = std::array::from_fn(|l| &plans[l].index[offset..]);
    let mut state: [Vector<N>; J] = std::array::from_fn(|l| means[l].x);
    let mut gain = [[0.0; N]; J];
    let mut current = [u32::MAX; J];
    for m in 0..t.len().saturating_sub(1) {
        let dt = t[m + 1] - t[m];
        for l in 0..J {
            if index[l][m] != current[l] {
                current[l] = index[l][m];
                gain[l] = plans[l].steps[current[l] as usize].k;
            }
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
    for l in 0..J {
        means[l].x = state[l];
    }
}

/// Smooths `J` joints backward over the steps of `plans`: `out` holds the filtered states of the steps' samples
/// and, at its end, the smoothed state of the sample after them.
pub(super) fn backward<const N: usize, const J: usize>(t: &[f64], plans: &[&Plan<N>], out: [[&mut [f64]; N]; J]) {
    let steps = t.len().saturating_sub(1);
    let index: [&[u32]; J] = std::array::from_fn(|l| &plans[l].index[..steps]);
    let mut state: [Vector<N>; J] = std::array::from_fn(|l| std::array::from_fn(|i| out[l][i][steps]));
    let mut c = [[[0.0; N]; N]; J];
    let mut direct = [false; J];
    let mut current = [u32::MAX; J];
    for m in (0..steps).rev() {
        let dt = t[m + 1] - t[m];
        for l in 0..J {
            if index[l][m] != current[l] {
                current[l] = index[l][m];
                let step = &plans[l].steps[current[l] as usize];
                c[l] = step.back.c;
                direct[l] = !step.determined();
            }
            let kept: Vector<N> = std::array::from_fn(|i| out[l][i][m]);
            let from = if direct[l] { [0.0; N] } else { carried(&kept, dt) };
            let news = apply(&c[l], &std::array::from_fn(|i| state[l][i] - from[i]));
            for i in 0..N {
                state[l][i] = kept[i] + news[i];
                out[l][i][m] = state[l][i];
            }
        }
    }
}
