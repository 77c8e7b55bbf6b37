//! One round of candidates: what each would add, and which of them is to be taken.

use crate::families::Context;
use crate::gram::Fit;
use crate::model::{Atom, Model};
use crate::search::{Score, Search, State};
use crate::select::Selection;
use rayon::prelude::*;

/// A candidate and its score.
#[derive(Debug, Clone)]
pub struct Ranked {
    /// Terms that would enter together: one, or one per joint.
    pub atoms: Vec<Atom>,
    /// Score of all together.
    pub score: Score,
    /// Gain less the price of its columns and its family's entry threshold.
    pub merit: f64,
}

/// What share of the best candidate's gain, less a few nats, is nearly as good.
const NEARLY: f64 = 0.9;
/// Larger amplitudes than any robot has, in any unit.
const MOST_AMPLITUDE: f64 = 1e6;
/// Residual over noise from which a joint may be a soft one.
const SHAKEN: f64 = 2.0;
/// See [`NEARLY`].
const NEARLY_NATS: f64 = 12.0;
/// Evidence below which it is scarce: it may say that something is there, and hardly what.
const SCARCE_NATS: f64 = 100.0;
/// Share of the entry threshold for what is steady, see [`Search::steady`].
const STEADY: f64 = 0.4;
/// Share of a joint's residual that must go for an effect to be steady.
const STEADY_SHARE: f64 = 0.15;

/// Root of the sum of squares.
fn rms_of(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Search<'_> {
    /// Whether a score is large enough to count, in evidence, in Nm and in folds.
    pub(crate) fn counts(&self, state: &State, ranked: &Ranked) -> bool {
        self.counts_at(state, ranked, ranked.merit)
    }

    /// The same at another merit.
    fn counts_at(&self, state: &State, ranked: &Ranked, merit: f64) -> bool {
        let size = if self.is_event(ranked) {
            self.event_over_floor(state, &ranked.score.size_nm)
        } else {
            self.over_floor(state, &state.fit, &ranked.score, &ranked.atoms)
        };
        // A delay that counts is longer than the half sample of tolerance, which has taken most of its torque already.
        let late = ranked.atoms.iter().any(|a| self.families[a.family].id() == "torque_delay");
        merit > 0.0 && (size > 1.0 || late) && ranked.score.folds > 0.5
    }

    /// Whether a candidate comes and goes at times of its own.
    pub(crate) fn is_event(&self, ranked: &Ranked) -> bool {
        ranked.atoms.iter().any(|a| self.families[a.family].event)
    }

    /// Whether a model holds a soft joint or play, whose torque is simulated.
    pub(crate) fn is_driven(&self, model: &Model) -> bool {
        model.atoms.iter().any(|a| self.families[a.family].driven)
    }

    /// Whether an effect takes a good part of a joint's residual, and does so on every single fold: a short
    /// recording with a slow residual has few independent samples, but this is not what chance does.
    pub(crate) fn steady(&self, without: &Fit, score: &Score) -> bool {
        let count = |j: usize| self.layout.joint_count(j).max(1.0);
        let rms: Vec<f64> = (0..self.scene.joints).map(|j| (without.held_out_joint(j) / count(j)).sqrt()).collect();
        let taken = |j: usize| 1.0 - (1.0 - (score.size_nm[j] / rms[j].max(1e-30)).powi(2)).max(0.0).sqrt();
        let most = (0..rms.len()).map(taken).fold(0.0, f64::max);
        most > STEADY_SHARE && score.by_fold.iter().all(|s| *s > 0.02)
    }

    pub(crate) fn rank(&self, ctx: &Context<'_>, model: &Model, state: &State, atoms: Vec<Atom>) -> Option<Ranked> {
        let score = self.score(model, state, &atoms.iter().collect::<Vec<_>>())?;
        if score.amplitude.iter().any(|a| !(a.abs() < MOST_AMPLITUDE)) {
            // A column that is zero but for rounding.
            return None;
        }
        let mut at = 0;
        for atom in &atoms {
            let own = &score.amplitude[at..at + atom.width()];
            at += atom.width();
            if !self.families[atom.family].admissible(ctx, atom.joint, &atom.shape, own) {
                return None;
            }
        }
        let entry = atoms.first().map_or(0.0, |a| self.limits.entry[a.family]);
        let entry = if self.steady(&state.fit, &score) { STEADY * entry } else { entry };
        // A term that acts in full has no amplitude but a shape that was fitted: that is paid for as well.
        let numbers: usize = atoms.iter().map(|a| a.width().max(1)).sum();
        let merit = score.gain - self.limits.column * numbers as f64 - entry;
        Some(Ranked { atoms, score, merit })
    }

    /// All candidates of one round, best first.
    pub(crate) fn round(&self, ctx: &Context<'_>, model: &Model, state: &State, pool: &[Atom]) -> Vec<Ranked> {
        let taken = |a: &Atom| {
            model.atoms.iter().any(|m| {
                let family = &self.families[m.family];
                m.family == a.family
                    && (m.joint == a.joint || !family.per_joint())
                    && (m.shape == a.shape || family.refinable(ctx, m.joint) || m.shape.is_empty())
            })
        };
        let single: Vec<Ranked> = pool
            .par_iter()
            .filter(|a| !taken(a))
            .filter_map(|a| self.rank(ctx, model, state, vec![a.clone()]))
            .collect();
        let mut all = single;
        if self.scene.joints > 1 {
            all.extend(self.whole_robot(ctx, model, state, &all, &taken));
        }
        all.sort_by(|a, b| b.merit.total_cmp(&a.merit));
        all
    }

    /// One candidate per family for all joints at once, each joint at its own best shape.
    pub(crate) fn whole_robot(
        &self,
        ctx: &Context<'_>,
        model: &Model,
        state: &State,
        single: &[Ranked],
        taken: &dyn Fn(&Atom) -> bool,
    ) -> Vec<Ranked> {
        let mut out = Vec::new();
        for (f, family) in self.families.iter().enumerate() {
            if !family.whole_robot {
                continue;
            }
            let best: Vec<Atom> = (0..self.scene.joints)
                .filter_map(|j| {
                    single
                        .iter()
                        .filter(|r| r.atoms[0].family == f && r.atoms[0].joint == j)
                        .max_by(|a, b| a.merit.total_cmp(&b.merit))
                        .map(|r| r.atoms[0].clone())
                })
                .filter(|a| !taken(a))
                .collect();
            if best.len() > 1 {
                out.extend(self.rank(ctx, model, state, best));
            }
        }
        out
    }

    /// Of the candidates that count, the one with the fewest amplitudes among those that explain nearly as much
    /// as the best: a tilted base is two numbers, not six springs.
    pub(crate) fn simplest(&self, state: &State, ranked: Vec<Ranked>) -> Option<Ranked> {
        let best = ranked.iter().find(|r| self.counts(state, r))?.clone();
        let scarce = self.is_whitened() || best.score.gain < SCARCE_NATS;
        // Times of pick and place are numbers too, where evidence is too scarce to tell them from a lucky choice.
        let times = |a: &Atom| if scarce { 2 * a.carries.len() } else { 0 };
        let width = |r: &Ranked| r.atoms.iter().map(|a| a.width().max(1) + times(a)).sum::<usize>();
        let (enough, amount) = (NEARLY * best.score.gain - NEARLY_NATS, rms_of(&best.score.size_nm));
        let near = |r: &Ranked| r.score.gain > enough && rms_of(&r.score.size_nm) > 0.98 * amount;
        // An entry threshold says whether there is anything. Where evidence is scarce it must not say which: of near
        // equals each is judged at the entry of the best.
        let common = best.score.gain - best.merit;
        let price = |r: &Ranked| {
            let numbers: usize = r.atoms.iter().map(|a| a.width() + a.shape.len() + times(a)).sum();
            self.limits.column * numbers as f64
        };
        // What comes and goes has conditions of its own, which its merit stands for.
        let judged =
            |r: &Ranked| if scarce && !self.is_event(r) { r.merit.max(r.score.gain - common) } else { r.merit };
        let merit = |r: &Ranked| if scarce { r.score.gain - price(r) } else { r.merit };
        let rivals = ranked.into_iter().filter(|r| near(r) && self.counts_at(state, r, judged(r)));
        let simpler = |a: &Ranked, b: &Ranked| width(a).cmp(&width(b)).then(merit(b).total_cmp(&merit(a)));
        rivals.min_by(simpler).or(Some(best))
    }

    /// Whether a candidate takes most of the residual where it is largest.
    pub(crate) fn explains(&self, state: &State, r: &Ranked) -> bool {
        let rms = self.held_out_rms(state);
        let over = |j: usize| rms[j] / self.limits.noise_nm[j].max(1e-30);
        let worst = (0..rms.len()).max_by(|a, b| over(*a).total_cmp(&over(*b))).unwrap_or(0);
        r.merit > 0.0 && r.score.size_nm[worst] > 0.9 * rms[worst]
    }

    /// Elastic joints and backlash, where a residual is large enough to be one: they are dear to simulate.
    pub(crate) fn driven(&self, ctx: &Context<'_>, model: &Model, state: &State) -> Vec<Atom> {
        let rms = self.held_out_rms(state);
        let over: Vec<f64> = (0..rms.len()).map(|j| rms[j] / self.limits.noise_nm[j].max(1e-30)).collect();
        let most = over.iter().copied().fold(0.0, f64::max);
        let mut joints: Vec<usize> = (0..rms.len()).filter(|j| over[*j] > SHAKEN.max(0.4 * most)).collect();
        // A soft joint shakes itself most.
        joints.sort_by(|a, b| over[*b].total_cmp(&over[*a]));
        joints.truncate(2);
        self.driven_at(ctx, model, state, &joints)
    }

    /// Elastic joints and backlash at these joints.
    pub(crate) fn driven_at(&self, ctx: &Context<'_>, model: &Model, state: &State, joints: &[usize]) -> Vec<Atom> {
        let mut list = Vec::new();
        let residual = self.residual(model, state);
        for (f, family) in self.families.iter().enumerate().filter(|(_, f)| f.driven) {
            for j in joints {
                let shapes = match family.id() {
                    "backlash" if ctx.inertia[*j] > 0.0 && ctx.nominal_base => self.screen_backlash(ctx, &residual, *j),
                    "elasticity" if ctx.inertia[*j] > 0.0 => {
                        let mut all = self.screen_elasticity(ctx, &residual, *j);
                        all.extend(family.grid(ctx, *j));
                        all
                    }
                    _ => Vec::new(),
                };
                list.extend(shapes.into_iter().map(|s| (f, *j, s)));
            }
        }
        self.build(ctx, list)
    }

    /// Families that were not taken, with the gain of their best candidate of the last round, less the price of its
    /// numbers [nats].
    pub fn nulls(&self, selection: &Selection) -> Vec<(String, f64)> {
        let mut best: Vec<Option<f64>> = vec![None; self.families.len()];
        for r in selection.excluded.iter().filter(|r| r.atoms.len() == 1) {
            let atom = &r.atoms[0];
            let v = r.score.gain - self.limits.column * atom.width() as f64;
            best[atom.family] = Some(best[atom.family].map_or(v, |b: f64| b.max(v)));
        }
        best.into_iter().zip(self.families).filter_map(|(v, f)| Some((f.key(), v?))).collect()
    }

    /// Refines the shapes of a candidate one term after the other.
    pub(crate) fn refined(&self, ctx: &Context<'_>, model: &Model, state: &State, ranked: &Ranked) -> Ranked {
        let mut atoms = Vec::new();
        for atom in &ranked.atoms {
            let atom = self.atom(ctx, atom.family, atom.joint, &atom.shape);
            let sharp = self.families[atom.family].refinable(ctx, atom.joint);
            atoms.push(if sharp { self.refine(ctx, model, state, &atom) } else { atom });
        }
        let whole = self.rank(ctx, model, state, atoms.clone());
        whole.unwrap_or(Ranked { atoms, ..ranked.clone() })
    }
}
