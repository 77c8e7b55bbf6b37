//! What comes and goes: payload carried between pick and place, and short contacts.
//!
//! Payload: along the rows, r = m φ z + noise with φ = ∂τ/∂m_p and z 0 or 1; z by Viterbi with a price per
//! switch, m by least squares, in turn. Contact: the half-sine force that takes most off the residual in a
//! short window, over all places and durations.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::rank::Ranked;
use crate::scene::Column;
use crate::search::{Search, State};
use lacuna_estimation::stats;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Price of a switch [nats].
const SWITCH_NATS: f64 = 8.0;
/// Durations of contacts that are tried [s].
const CONTACT_S: [f64; 5] = [0.015, 0.025, 0.04, 0.065, 0.1];
/// Price of a contact: three force components, time, duration, and the many places tried [nats].
const CONTACT_NATS: f64 = 30.0;
/// How much more a contact must explain than a window of its length does at the better places elsewhere: what a
/// misfit leaves comes again and again.
const CONTACT_OVER: f64 = 4.0;
/// Share of the local residual power that a contact must explain.
const CONTACT_SHARE: f64 = 0.8;
/// Share of what a term explains at the time of a contact that the contact must be: laws hold to a few per cent on the
/// average, and where they hold worst it looks like one.
const CONTACT_LAW: f64 = 0.1;
/// The same of terms that are the first order of their law.
const CONTACT_FIRST_ORDER: f64 = 0.25;
/// Share of the rows from which on a payload is carried all the time.
const ALWAYS: f64 = 0.9;
/// Gain that a contact must have at a second joint: a force on the tip is felt at all of them, the rest of a
/// joint's own friction only at that joint [nats].
const CONTACT_SECOND_NATS: f64 = 6.0;

/// A term whose amplitudes are given and not fitted any more.
pub(crate) fn held_at(atom: &Atom, amplitude: Vec<f64>) -> Atom {
    let mut out = atom.clone();
    for (i, a) in amplitude.iter().enumerate() {
        for signal in out.raws[i].iter_mut().flatten() {
            signal.iter_mut().for_each(|v| *v *= a);
        }
        for part in out.columns[i].rows_mut() {
            part.iter_mut().for_each(|v| *v *= a);
        }
    }
    out.fixed = true;
    out.amplitude = amplitude;
    out
}

impl Search<'_> {
    /// The best explanation by payload carries, if there is any.
    pub fn carries(&self, ctx: &Context<'_>, model: &Model, state: &State) -> Option<Ranked> {
        let family = self.families.iter().position(|f| f.event && f.id() == "payload")?;
        let taken = model.atoms.iter().any(|a| a.family == family) || self.limits.banned.contains(&family);
        if taken || ctx.measured_load {
            return None;
        }
        let whole = self.atom(ctx, family, 0, &[]);
        let phi = whole.columns.first()?.clone();
        let residual = self.residual(model, state);
        let scale = self.local_masses(&residual, &phi);
        // The base has taken its share of a payload; light and heavy starts are tried, also of one that is carried for a hundredth of
        // the time.
        let mut best: Option<Ranked> = None;
        for start in [0.99, 0.95, 0.8, 0.6] {
            let m = stats::quantile(&scale, start) - stats::quantile(&scale, 0.1);
            if m <= 0.0 {
                continue;
            }
            if let Some(r) = self.carry_from(model, state, &whole, &phi, m)
                && best.as_ref().is_none_or(|b| r.merit > b.merit)
            {
                best = Some(r);
            }
        }
        best
    }

    /// Mass that fits the residual of each quarter second best [kg].
    fn local_masses(&self, residual: &Column, phi: &Column) -> Vec<f64> {
        let window = (0.25 * self.scene.row_rate_hz()).round().max(1.0) as usize;
        let mut out = Vec::new();
        for piece in &self.scene.pieces {
            for start in (piece.rows.start..piece.rows.end).step_by(window) {
                let end = (start + window).min(piece.rows.end);
                let (mut up, mut down) = (0.0, 0.0);
                for j in 0..self.scene.joints {
                    for row in start..end {
                        let f = at(phi, j, row);
                        up += f * at(residual, j, row);
                        down += f * f;
                    }
                }
                if down > 0.0 {
                    out.push(up / down);
                }
            }
        }
        out
    }

    fn carry_from(&self, model: &Model, state: &State, whole: &Atom, phi: &Column, start: f64) -> Option<Ranked> {
        let mut residual = self.residual(model, state);
        let mut mass = start;
        // As many independent rows as noise has: the misfit that blunts the evidence is the payload's own.
        let sharp =
            |s: &State| -> Vec<f64> { s.weights.iter().zip(&s.independent).map(|(w, i)| w / i * i.max(0.3)).collect() };
        let mut weights = sharp(state);
        let mut carried = vec![false; self.scene.rows];
        let mut atom = None;
        for _ in 0..6 {
            let next = self.viterbi(&residual, phi, mass, &weights);
            let same = next == carried;
            carried = next;
            // What is carried all the time is part of the robot: masses are looked for elsewhere.
            if self.always(&carried) {
                return None;
            }
            if same || !carried.iter().any(|c| *c) {
                break;
            }
            let carries = self.carry_times(&carried);
            let candidate = self.carry_atom(whole, &carries);
            let mut trial = model.clone();
            trial.atoms.push(candidate.clone());
            let fitted = self.fit(&mut trial)?;
            mass = *fitted.fit.beta.last()?;
            if mass <= 0.0 {
                return None;
            }
            // A payload in a single fold cannot be learnt from the others: it is weighed on all, then held.
            let (kept, fitted, trial) = if self.in_one_fold(&carried) {
                let kept = held_at(&candidate, vec![mass]);
                let mut trial = model.clone();
                trial.atoms.push(kept.clone());
                (kept, self.fit(&mut trial)?, trial)
            } else {
                (candidate.clone(), fitted, trial)
            };
            weights = sharp(&fitted);
            // What would be left without the payload, all else as fitted.
            residual = self.residual(&trial, &fitted);
            for column in &candidate.columns {
                crate::search::subtract(&mut residual, column, -mass);
            }
            atom = Some((kept, fitted));
        }
        let (atom, fitted) = atom?;
        // At the weights of the fitted model: those of the model without are blunted by the payload itself.
        let mut score = self.compare(state, &state.fit, &fitted.fit, vec![mass]);
        score.folds = 1.0;
        // What hangs on a Delta's platform hangs on all of its legs; the rest of a joint's own friction does not, nor does
        // what a law found there misses.
        if self.scene.body.as_delta().is_some() {
            let law = self.law_nm(&self.held_out_rms(state));
            let beyond = score.size_nm.iter().zip(law).filter(|(size, law)| *size > law).count();
            let acting = if atom.fixed { atom.clone() } else { held_at(&atom, vec![mass]) };
            if beyond < 2 || !self.felt_elsewhere(&fitted, &residual, &acting) {
                return None;
            }
        }
        let switches = atom.carries.len() as f64;
        let merit = score.gain - 2.0 * SWITCH_NATS * switches - self.limits.column - self.limits.entry[whole.family];
        Some(Ranked { atoms: vec![atom], score, merit })
    }

    /// Whether these are all rows that count but for beginnings and ends.
    fn always(&self, rows: &[bool]) -> bool {
        let counts = |row: &usize| self.scene.mask.iter().any(|m| m[*row]);
        let (mut on, mut all) = (0usize, 0usize);
        for row in (0..self.scene.rows).filter(counts) {
            all += 1;
            on += usize::from(rows.get(row).copied().unwrap_or(false));
        }
        on as f64 > ALWAYS * all as f64
    }

    /// Whether all these rows are in the same fold.
    fn in_one_fold(&self, rows: &[bool]) -> bool {
        let any = |fold: &&std::ops::Range<usize>| rows.get((*fold).clone()).is_some_and(|r| r.iter().any(|c| *c));
        self.layout.folds.iter().filter(any).count() == 1
    }

    /// Rows in which the payload is carried.
    pub(crate) fn viterbi(&self, residual: &Column, phi: &Column, mass: f64, weights: &[f64]) -> Vec<bool> {
        let mut out = vec![false; self.scene.rows];
        for piece in &self.scene.pieces {
            let rows = piece.rows.clone();
            let mut value = [0.0f64, -SWITCH_NATS];
            let mut from = Vec::with_capacity(rows.len());
            for row in rows.clone() {
                let mut gain = 0.0;
                for j in 0..self.scene.joints {
                    let (f, r) = (at(phi, j, row), at(residual, j, row));
                    gain += weights[j] * (mass * f * r - 0.5 * (mass * f).powi(2));
                }
                let stay = value;
                let off = if stay[0] >= stay[1] - SWITCH_NATS { (stay[0], 0) } else { (stay[1] - SWITCH_NATS, 1) };
                let on = if stay[1] >= stay[0] - SWITCH_NATS { (stay[1], 1) } else { (stay[0] - SWITCH_NATS, 0) };
                value = [off.0, on.0 + gain];
                from.push([off.1, on.1]);
            }
            let mut s = usize::from(value[1] > value[0]);
            for (row, back) in rows.rev().zip(from.iter().rev()) {
                out[row] = s == 1;
                s = back[s];
            }
        }
        out
    }

    /// From and to of the rows in which the payload is carried, since switch-on [s].
    pub(crate) fn carry_times(&self, carried: &[bool]) -> Vec<(f64, f64)> {
        let scene = self.scene;
        let step = scene.stride as f64 / scene.rate_hz;
        let mut out = Vec::new();
        for piece in &scene.pieces {
            let mut begin = None;
            for (i, row) in piece.rows.clone().enumerate() {
                let t = piece.global_s + (i as f64 - 0.5) * step;
                match (begin, carried.get(row).copied().unwrap_or(false)) {
                    (None, true) => begin = Some(t),
                    (Some(b), false) => {
                        out.push((b, t));
                        begin = None;
                    }
                    _ => {}
                }
            }
            if let Some(b) = begin {
                out.push((b, piece.global_s + piece.len() as f64 / scene.rate_hz));
            }
        }
        out
    }

    /// A payload that is carried at these times only.
    pub fn carry_atom(&self, whole: &Atom, carries: &[(f64, f64)]) -> Atom {
        let scene = self.scene;
        let mut raws = whole.raws.clone();
        for raw in &mut raws {
            for (piece, signals) in scene.pieces.iter().zip(raw) {
                let on: Vec<bool> = (0..piece.len())
                    .map(|k| {
                        let t = piece.global_s + k as f64 / scene.rate_hz;
                        carries.iter().any(|(a, b)| (*a..*b).contains(&t))
                    })
                    .collect();
                for signal in signals.iter_mut() {
                    signal.iter_mut().zip(&on).filter(|(_, on)| !**on).for_each(|(v, _)| *v = 0.0);
                }
            }
        }
        let columns = raws.iter().map(|r| scene.column(r.clone())).collect();
        Atom { raws, columns, carries: carries.to_vec(), ..whole.clone() }
    }

    /// The contact that explains most, if any explains its surroundings.
    pub fn contact(&self, ctx: &Context<'_>, model: &Model, state: &State) -> Option<Ranked> {
        let family = self.families.iter().position(|f| f.event && f.id() == "collision")?;
        if ctx.measured_load {
            return None;
        }
        let residual = self.residual(model, state);
        let jacobians = self.jacobian_rows();
        let places: Vec<(usize, f64)> =
            CONTACT_S.iter().flat_map(|t| (0..self.scene.pieces.len()).map(move |p| (p, *t))).collect();
        let best = places
            .into_par_iter()
            .filter_map(|(p, duration)| self.best_window(p, duration, &residual, &jacobians, &state.weights))
            .reduce_with(|a, b| if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a })?;
        let (gain, t_0, duration) = best;
        if gain < CONTACT_NATS
            || gain < CONTACT_OVER * self.usual_window(duration, &residual, &jacobians, &state.weights)
        {
            return None;
        }
        let atom = self.atom(ctx, family, 0, &[t_0, duration]);
        let atom = self.refine_inside(ctx, model, state, &atom);
        let frozen = self.frozen(model, state, &atom)?;
        let score = self.score(model, state, &[&frozen])?;
        let share = self.local_share(&residual, &frozen);
        // Where one contact is established another one, felt at a single joint, is no surprise.
        let another = model.atoms.iter().any(|a| a.family == family);
        let felt = another || self.felt_elsewhere(state, &residual, &frozen);
        // The shortest pulse there is, beside a soft joint or play: a blow of the link against its own gear.
        let own_blow = self.is_driven(model) && frozen.shape[1] < CONTACT_S[0];
        let merit = if own_blow || share < CONTACT_SHARE || !felt || !self.over_law(model, state, &frozen) {
            -1.0
        } else {
            score.gain - CONTACT_NATS - self.limits.entry[family]
        };
        let score = crate::search::Score { folds: 1.0, size_nm: self.local_size(&frozen), ..score };
        Some(Ranked { atoms: vec![frozen], score, merit })
    }

    /// Force of a term fitted to all recordings, then held: an event is in one recording and cannot be
    /// learnt from the others.
    pub fn frozen(&self, model: &Model, state: &State, atom: &Atom) -> Option<Atom> {
        Some(held_at(atom, self.score(model, state, &[atom])?.amplitude))
    }

    /// Time and duration refined by the fit to all recordings.
    fn refine_inside(&self, ctx: &Context<'_>, model: &Model, state: &State, atom: &Atom) -> Atom {
        let mut best = atom.clone();
        let value = |a: &Atom| {
            self.frozen(model, state, a)
                .and_then(|f| self.score(model, state, &[&f]))
                .map_or(f64::NEG_INFINITY, |s| s.gain)
        };
        let mut top = value(&best);
        let mut step = [0.006, 1.25];
        for _ in 0..4 {
            for i in 0..2 {
                for way in [-1.0, 1.0] {
                    let mut shape = best.shape.clone();
                    // The middle of the pulse stays where it is while its duration changes.
                    if i == 0 {
                        shape[0] += way * step[0];
                    } else {
                        let longer = shape[1] * f64::powf(step[1], way);
                        shape[0] -= 0.5 * (longer - shape[1]);
                        shape[1] = longer;
                    }
                    let next = self.atom(ctx, atom.family, 0, &shape);
                    let v = value(&next);
                    if v > top {
                        (top, best) = (v, next);
                    }
                }
            }
            step = [0.5 * step[0], step[1].sqrt()];
        }
        best
    }

    /// Transposed Jacobian at every row: `[row][joint]` is the torque per unit force.
    pub(crate) fn jacobian_rows(&self) -> Vec<Vec<Vector3<f64>>> {
        let n = self.scene.joints;
        let mut out = vec![vec![Vector3::zeros(); n]; self.scene.rows];
        for piece in &self.scene.pieces {
            for (i, row) in piece.rows.clone().enumerate() {
                let k = i * self.scene.stride;
                let q: Vec<f64> = (0..n).map(|j| piece.q[j][k]).collect();
                let mut jacobian = vec![0.0; 3 * n];
                if self.scene.body.jacobian(&q, &mut jacobian).is_ok() {
                    for j in 0..n {
                        out[row][j] = -Vector3::new(jacobian[j], jacobian[n + j], jacobian[2 * n + j]);
                    }
                }
            }
        }
        out
    }

    /// Gain, start (global time) and duration of the best window in piece `p`.
    fn best_window(
        &self,
        p: usize,
        duration: f64,
        residual: &Column,
        jacobians: &[Vec<Vector3<f64>>],
        weights: &[f64],
    ) -> Option<(f64, f64, f64)> {
        let piece = &self.scene.pieces[p];
        let mut best = (0.0, 0.0, duration);
        for (centre, gain) in self.windows(p, duration, 1, (residual, jacobians, weights)) {
            if gain > best.0 {
                let middle = piece.global_s + (centre - piece.rows.start) as f64 / self.scene.row_rate_hz();
                best = (gain, middle - 0.5 * duration, duration);
            }
        }
        (best.0 > 0.0).then_some(best)
    }

    /// Gain that a window of this duration has at the better places of recordings without contacts: the best of
    /// each quarter second, of which one in five is better.
    fn usual_window(&self, duration: f64, residual: &Column, jacobians: &[Vec<Vector3<f64>>], weights: &[f64]) -> f64 {
        let bin = (0.25 * self.scene.row_rate_hz()).round().max(1.0) as usize;
        let mut best: Vec<f64> = (0..self.scene.pieces.len())
            .into_par_iter()
            .flat_map_iter(|p| {
                let start = self.scene.pieces[p].rows.start;
                let mut own = vec![0.0f64; self.scene.pieces[p].rows.len().div_ceil(bin)];
                for (centre, gain) in self.windows(p, duration, 2, (residual, jacobians, weights)) {
                    if let Some(v) = own.get_mut((centre - start) / bin) {
                        *v = v.max(gain);
                    }
                }
                own
            })
            .collect();
        stats::quantile_in_place(&mut best, 0.8)
    }

    /// Gain of a half-sine force of this duration about every `step`-th row of piece `p`.
    fn windows(
        &self,
        p: usize,
        duration: f64,
        step: usize,
        (residual, jacobians, weights): (&Column, &[Vec<Vector3<f64>>], &[f64]),
    ) -> Vec<(usize, f64)> {
        let scene = self.scene;
        let piece = &scene.pieces[p];
        let rate = scene.row_rate_hz();
        // The pulse as the filter leaves it: about the half sine, widened by the band.
        let width = duration.hypot(0.35 / scene.band_hz);
        let half = (0.5 * width * rate).ceil() as usize + 1;
        let mut out = Vec::new();
        for centre in (piece.rows.start + half..piece.rows.end.saturating_sub(half)).step_by(step) {
            if !scene.quiet[centre] {
                continue;
            }
            let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
            for row in centre - half..=centre + half {
                let phase = (row as f64 - centre as f64) / rate / width;
                if phase.abs() >= 0.5 {
                    continue;
                }
                let shape = (std::f64::consts::PI * phase).cos();
                for j in 0..scene.joints {
                    if scene.mask[j][row] {
                        let column = jacobians[row][j] * shape;
                        a += weights[j] * column * column.transpose();
                        b += weights[j] * column * at(residual, j, row);
                    }
                }
            }
            let ridge = 1e-6 * a.trace() + 1e-30;
            if let Some(inverse) = (a + Matrix3::identity() * ridge).try_inverse() {
                out.push((centre, 0.5 * b.dot(&(inverse * b))));
            }
        }
        out
    }

    /// Rows in which a frozen event acts with at least a tenth of its largest torque.
    fn event_rows(&self, atom: &Atom) -> Vec<usize> {
        let size = |row: usize| {
            (0..self.scene.joints)
                .map(|j| atom.columns.iter().map(|c| at(c, j, row)).sum::<f64>().abs())
                .fold(0.0, f64::max)
        };
        let top = (0..self.scene.rows).map(size).fold(0.0, f64::max);
        (0..self.scene.rows).filter(|r| top > 0.0 && size(*r) > 0.1 * top).collect()
    }

    fn local_share(&self, residual: &Column, atom: &Atom) -> f64 {
        let rows = self.event_rows(atom);
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return 0.0 };
        let margin = (0.02 * self.scene.row_rate_hz()).round() as usize;
        let (mut before, mut after) = (0.0, 0.0);
        for row in first.saturating_sub(margin)..(last + margin + 1).min(self.scene.rows) {
            for j in 0..self.scene.joints {
                let r = at(residual, j, row);
                before += r * r;
                after += (r - atom.columns.iter().map(|c| at(c, j, row)).sum::<f64>()).powi(2);
            }
        }
        1.0 - after / f64::max(before, 1e-30)
    }

    /// Whether at least two joints feel a contact or a payload (one, if there is but one).
    fn felt_elsewhere(&self, state: &State, residual: &Column, atom: &Atom) -> bool {
        let rows = self.event_rows(atom);
        let felt = (0..self.scene.joints)
            .filter(|j| {
                let gain: f64 = rows
                    .iter()
                    .map(|row| {
                        let (r, c) =
                            (at(residual, *j, *row), atom.columns.iter().map(|c| at(c, *j, *row)).sum::<f64>());
                        0.5 * state.weights[*j] * (r * r - (r - c) * (r - c))
                    })
                    .sum();
                gain > CONTACT_SECOND_NATS
            })
            .count();
        felt >= self.scene.joints.min(2)
    }

    /// Whether a contact is more than what the terms found so far may be wrong by while it acts.
    fn over_law(&self, model: &Model, state: &State, atom: &Atom) -> bool {
        let rows = self.event_rows(atom);
        let doubt = |j: usize, row: usize| -> f64 {
            let of = |i: usize| -> f64 {
                let term = &model.atoms[i];
                let share = if self.families[term.family].first_order() { CONTACT_FIRST_ORDER } else { CONTACT_LAW };
                let factors = state.fit.beta.get(model.slots(i)).unwrap_or_default();
                let factor = |c: usize| if term.fixed { 1.0 } else { factors.get(c).copied().unwrap_or(0.0) };
                share * term.columns.iter().enumerate().map(|(c, column)| factor(c) * at(column, j, row)).sum::<f64>()
            };
            (0..model.atoms.len()).map(of).sum()
        };
        let own = self.local_size(atom);
        let law = |j: usize| {
            let sum: f64 = rows.iter().map(|row| doubt(j, *row).powi(2)).sum();
            (sum / rows.len().max(1) as f64).sqrt()
        };
        (0..self.scene.joints).any(|j| own[j] > law(j))
    }

    fn local_size(&self, atom: &Atom) -> Vec<f64> {
        let rows = self.event_rows(atom);
        (0..self.scene.joints)
            .map(|j| {
                let sum: f64 =
                    rows.iter().map(|r| atom.columns.iter().map(|c| at(c, j, *r)).sum::<f64>().powi(2)).sum();
                (sum / rows.len().max(1) as f64).sqrt()
            })
            .collect()
    }
}

/// Value of a column; 0 where it is empty.
fn at(column: &Column, j: usize, row: usize) -> f64 {
    column.part[j].get(row).copied().unwrap_or(0.0)
}
