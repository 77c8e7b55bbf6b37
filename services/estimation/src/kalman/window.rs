//! The waiting samples of the fixed-lag smoother and the maps between them, for N states.

use super::gain::{Back, Gains, Mean, Period, deviations, group, scaled};
use super::maps::{Maps, Powers, composed, shifted};
use super::model::carried;
use super::small::{Vector, congruence_plus};
use super::stream::{LagEstimate, Wait};
use super::{JointState, PRIOR_SD, Settings};

/// What is remembered of a waiting sample besides its map.
#[derive(Debug, Clone, Copy, Default)]
struct Sample {
    stamp_ns: i64,
    start: bool,
    gap: bool,
    bridged: bool,
}

/// Two stacks: compositions from each of the older samples on, and the composition of the newer ones so far.
#[derive(Debug, Clone)]
pub(super) struct Window<const N: usize> {
    wait: Wait,
    gap_s: f64,
    period: Period,
    pub(super) groups: Vec<Gains<N>>,
    group_of: Vec<usize>,
    measurement_sd: Vec<f64>,
    means: Vec<Mean<N>>,
    /// Ring of the waiting samples, the newest included, with their raw measurements.
    samples: Vec<Sample>,
    raw: Vec<f64>,
    first: usize,
    count: usize,
    newest_ns: Option<i64>,
    /// Entry i: map of the i-th newer sample. Their composition stands beside it.
    newer: Maps<N>,
    newer_back: Vec<Back<N>>,
    newer_shift: Vec<Vector<N>>,
    /// Entry i: composition over i + 1 samples; the last entry begins at the oldest waiting sample.
    older: Maps<N>,
    /// True if the data-free parts of `older` are `powers` and not stored.
    older_steady: bool,
    /// How many of the newest maps are the converged one.
    steady_run: usize,
    powers: Powers<N>,
    states: Vec<JointState>,
    /// Number of converged maps that the standard deviations in `states` belong to; 0: other maps.
    sd_of: usize,
}

impl<const N: usize> Window<N> {
    pub fn new(settings: &Settings, mut wait: Wait) -> Self {
        let n = settings.noise.len();
        let (mut groups, mut group_of) = (Vec::with_capacity(n), Vec::with_capacity(n));
        group(&settings.noise, settings.update, &mut groups, &mut group_of);
        // Nothing can be given out before N samples determine the state, whatever the lag.
        wait.most = wait.most.max(N);
        // Room for a noise per joint, should [`Window::set`] bring that.
        let (g, room) = (n, wait.most + 1);
        let zero = Back { c: [[0.0; N]; N], a: [[0.0; N]; N] };
        Self {
            wait,
            gap_s: settings.gap_s,
            period: Period::new(settings),
            means: vec![Mean::start(0.0); n],
            samples: vec![Sample::default(); room],
            raw: vec![0.0; room * n],
            first: 0,
            count: 0,
            newest_ns: None,
            newer: Maps::new(room, g, n),
            newer_back: vec![zero; g],
            newer_shift: vec![[0.0; N]; n],
            older: Maps::new(room, g, n),
            older_steady: false,
            steady_run: 0,
            powers: Powers { table: vec![zero; room * g], len: 0, version: 0 },
            states: vec![JointState::default(); n],
            sd_of: 0,
            groups,
            group_of,
            measurement_sd: settings.noise.iter().map(|n| n.measurement_sd).collect(),
        }
    }

    /// Other noise, gap and lag (within the room of the first), from the next stretch on.
    pub fn set(&mut self, settings: &Settings, wait: Wait) {
        self.wait = Wait { most: self.wait.most, ..wait };
        self.gap_s = settings.gap_s;
        self.period = Period::new(settings);
        group(&settings.noise, settings.update, &mut self.groups, &mut self.group_of);
        for (own, noise) in self.measurement_sd.iter_mut().zip(&settings.noise) {
            *own = noise.measurement_sd;
        }
        self.powers.len = 0;
        self.powers.version = 0;
    }

    pub fn joints(&self) -> usize {
        self.means.len()
    }

    /// Most samples that can wait besides the newest.
    pub fn room(&self) -> usize {
        self.wait.most
    }

    pub fn pending(&self) -> usize {
        self.count
    }

    pub fn push(&mut self, stamp_ns: i64, q: &[f64], emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        match self.newest_ns {
            None => self.start(stamp_ns, q, false),
            Some(before) => {
                let dt = stamp_ns.saturating_sub(before) as f64 * 1e-9;
                if dt > 0.0 && dt <= self.gap_s {
                    self.go_on(stamp_ns, dt, q);
                } else {
                    self.flush(emit);
                    self.start(stamp_ns, q, dt > 0.0);
                }
            }
        }
        self.emit_ready(emit);
    }

    /// Gives out every waiting sample and forgets the stretch.
    pub fn flush(&mut self, emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        while self.count > 0 {
            self.emit_oldest(emit);
        }
        self.newest_ns = None;
    }

    fn determined(&self) -> bool {
        self.groups.iter().all(|g| g.covariance().is_some())
    }

    fn emit_ready(&mut self, emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        let determined = self.determined();
        while self.count > 0 {
            let later = self.count - 1;
            let waited = self.newest_ns.unwrap_or(0).saturating_sub(self.samples[self.first].stamp_ns);
            let full = later >= self.wait.most;
            if full && !determined {
                // Time steps so unequal that all this did not determine a state: begin again.
                self.flush(emit);
                return;
            }
            if !(full || determined && (later >= self.wait.lag_samples || waited >= self.wait.lag_ns)) {
                return;
            }
            self.emit_oldest(emit);
        }
    }

    fn remember(&mut self, stamp_ns: i64, q: &[f64], start: bool, gap: bool) -> usize {
        let place = (self.first + self.count) % self.samples.len();
        self.count += 1;
        let n = self.means.len();
        let bridged = (0..n).any(|j| !q.get(j).is_some_and(|v| v.is_finite()));
        self.samples[place] = Sample { stamp_ns, start, gap, bridged };
        self.newest_ns = Some(stamp_ns);
        place
    }

    fn start(&mut self, stamp_ns: i64, q: &[f64], gap: bool) {
        self.newer.len = 0;
        self.older.len = 0;
        self.steady_run = 0;
        self.sd_of = 0;
        let place = self.remember(stamp_ns, q, true, gap);
        let n = self.means.len();
        for g in &mut self.groups {
            g.start();
        }
        for j in 0..n {
            let z = q.get(j).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
            self.raw[place * n + j] = z;
            self.means[j] = Mean::start(z);
        }
    }

    /// Filter step to the new sample; the map back to the one before joins the newer stack.
    fn go_on(&mut self, stamp_ns: i64, dt: f64, q: &[f64]) {
        let waiting = self.count > 0;
        let determined = self.determined();
        let before = (self.first + self.count + self.samples.len() - 1) % self.samples.len();
        let place = self.remember(stamp_ns, q, false, false);
        let classified = self.period.classify(dt);
        for g in &mut self.groups {
            g.advance(classified);
        }
        let steady = self.groups.iter().all(Gains::at_steady);
        if steady {
            self.renew_powers();
        }
        // Until the first map that is not the converged one, compositions are powers.
        let all_steady = steady && self.steady_run >= self.newer.len;
        if waiting && !all_steady {
            self.leave_powers();
        }
        let (n, g, len) = (self.means.len(), self.groups.len(), self.newer.len);
        if steady && len > 0 {
            self.extend_powers(len);
        }
        for j in 0..n {
            let group = self.group_of[j];
            let gains = &self.groups[group];
            let mean = &mut self.means[j];
            let z = match q.get(j).copied().filter(|v| v.is_finite()) {
                Some(z) => z,
                None if determined => carried(&mean.x, dt)[0],
                None => self.raw[before * n + j],
            };
            self.raw[place * n + j] = z;
            let a = mean.advance(gains.step(), gains.information(), dt, z);
            if !waiting {
                continue;
            }
            self.newer.shift[len * n + j] = a;
            self.newer_shift[j] = if len == 0 {
                a
            } else {
                let c =
                    if all_steady { &self.powers.table[(len - 1) * g + group].c } else { &self.newer_back[group].c };
                shifted(&self.newer_shift[j], c, &a)
            };
        }
        if waiting {
            for group in 0..g {
                let back = self.groups[group].step().back;
                self.newer.back[len * g + group] = back;
                if !all_steady {
                    self.newer_back[group] = if len == 0 { back } else { composed(&self.newer_back[group], &back) };
                }
            }
            self.newer.len += 1;
        }
        self.steady_run = if steady { self.steady_run + 1 } else { 0 };
    }

    /// A new converged step: compositions that refer to the old one's powers are written out first.
    fn renew_powers(&mut self) {
        let version = self.groups.iter().map(Gains::steady_version).sum();
        if version == self.powers.version {
            return;
        }
        self.leave_powers();
        let g = self.groups.len();
        if self.older_steady {
            for i in 0..self.older.len * g {
                self.older.back[i] = self.powers.table[i];
            }
            self.older_steady = false;
        }
        for group in 0..g {
            self.powers.table[group] = self.groups[group].step().back;
        }
        self.powers.len = 1;
        self.powers.version = version;
        self.steady_run = 0;
        self.sd_of = 0;
    }

    /// Writes out the newer samples' composition if it was known as a power only.
    fn leave_powers(&mut self) {
        let len = self.newer.len;
        if len > 0 && self.steady_run >= len {
            self.extend_powers(len);
            let g = self.groups.len();
            self.newer_back[..g].copy_from_slice(&self.powers.table[(len - 1) * g..len * g]);
            self.steady_run = 0;
        }
    }

    /// Makes the compositions of up to `m` converged maps.
    fn extend_powers(&mut self, m: usize) {
        let g = self.groups.len();
        while self.powers.len < m {
            let len = self.powers.len;
            for group in 0..g {
                let next = composed(&self.powers.table[(len - 1) * g + group], &self.powers.table[group]);
                self.powers.table[len * g + group] = next;
            }
            self.powers.len += 1;
        }
    }

    /// Moves the newer samples to the older stack: suffix compositions, youngest first.
    fn flip(&mut self) {
        let (n, g, len) = (self.means.len(), self.groups.len(), self.newer.len);
        self.older_steady = self.steady_run >= len;
        if self.older_steady {
            self.extend_powers(len);
        }
        for i in 0..len {
            let from = len - 1 - i;
            if !self.older_steady {
                for group in 0..g {
                    let own = self.newer.back[from * g + group];
                    self.older.back[i * g + group] =
                        if i == 0 { own } else { composed(&own, &self.older.back[(i - 1) * g + group]) };
                }
            }
            for j in 0..n {
                let own = self.newer.shift[from * n + j];
                self.older.shift[i * n + j] = if i == 0 {
                    own
                } else {
                    let c = &self.newer.back[from * g + self.group_of[j]].c;
                    shifted(&own, c, &self.older.shift[(i - 1) * n + j])
                };
            }
        }
        self.older.len = len;
        self.newer.len = 0;
    }

    fn emit_oldest(&mut self, emit: &mut dyn FnMut(&LagEstimate<'_>)) {
        let later = self.count - 1;
        let sample = self.samples[self.first];
        if self.determined() {
            if self.older.len == 0 && self.newer.len > 0 {
                self.flip();
            }
            self.estimate(later);
        } else {
            let n = self.means.len();
            for (state, &q) in self.states.iter_mut().zip(&self.raw[self.first * n..]) {
                let [sd_qd, sd_qdd, _] = PRIOR_SD;
                *state = JointState { q, sd_qd, sd_qdd, ..JointState::default() };
            }
            for (state, sd) in self.states.iter_mut().zip(&self.measurement_sd) {
                state.sd_q = *sd;
            }
            self.sd_of = 0;
        }
        if self.older.len > 0 {
            self.older.len -= 1;
        } else {
            // Not determined: the maps were never used.
            self.newer.len = 0;
        }
        self.first = (self.first + 1) % self.samples.len();
        self.count -= 1;
        let newest_ns = self.newest_ns.unwrap_or(sample.stamp_ns);
        let waited = newest_ns.saturating_sub(sample.stamp_ns);
        emit(&LagEstimate {
            joints: &self.states,
            stamp_ns: sample.stamp_ns,
            newest_ns,
            start: sample.start,
            gap: sample.gap,
            short: later < self.wait.lag_samples && waited < self.wait.lag_ns,
            bridged: sample.bridged,
        });
    }

    /// State of the oldest waiting sample, which has `later` samples after it, into `states`.
    fn estimate(&mut self, later: usize) {
        let (n, g) = (self.means.len(), self.groups.len());
        let (older, newer) = (self.older.len, self.newer.len);
        let newer_steady = newer > 0 && self.steady_run >= newer;
        if newer_steady {
            self.extend_powers(newer);
        }
        let pick = |steady: bool, len: usize, stored: usize, group: usize, from: &[Back<N>], powers: &[Back<N>]| {
            if steady { powers[(len - 1) * g + group] } else { from[stored * g + group] }
        };
        let known = later > 0 && self.steady_run >= later && self.sd_of == later;
        for j in 0..n {
            let group = self.group_of[j];
            let mut x = self.means[j].x;
            if newer > 0 {
                let c = if newer_steady {
                    &self.powers.table[(newer - 1) * g + group].c
                } else {
                    &self.newer_back[group].c
                };
                x = shifted(&self.newer_shift[j], c, &x);
            }
            if older > 0 {
                let c = if self.older_steady {
                    &self.powers.table[(older - 1) * g + group].c
                } else {
                    &self.older.back[(older - 1) * g + group].c
                };
                x = shifted(&self.older.shift[(older - 1) * n + j], c, &x);
            }
            let state = &mut self.states[j];
            state.q = x[0];
            state.qd = x[1];
            state.qdd = x[2];
        }
        if known {
            return;
        }
        for group in 0..g {
            let Some(p) = self.groups[group].covariance() else { continue };
            let mut p = *p;
            if newer > 0 {
                let map = pick(newer_steady, newer, 0, group, &self.newer_back, &self.powers.table);
                p = congruence_plus(&map.c, &p, &map.a);
            }
            if older > 0 {
                let map = pick(self.older_steady, older, older - 1, group, &self.older.back, &self.powers.table);
                p = congruence_plus(&map.c, &p, &map.a);
            }
            let unit = deviations(&p);
            for j in (0..n).filter(|&j| self.group_of[j] == group) {
                let state = &mut self.states[j];
                let sd = self.measurement_sd[j];
                [state.sd_q, state.sd_qd, state.sd_qdd] = std::array::from_fn(|i| scaled(unit[i], i, sd));
            }
        }
        self.sd_of = if self.steady_run >= later { later } else { 0 };
    }
}
