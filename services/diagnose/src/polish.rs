//! The end of the search: all shapes once more beside each other, what that makes superfluous goes, and a soft
//! joint may stand for what was named in its place.
//!
//! A term enters at the shape that is best while other terms are missing. What it leaves at that shape looks like
//! further effects; with all shapes refined beside each other these are worth nothing any more.

use crate::base::Base;
use crate::context::context;
use crate::model::{Atom, Model};
use crate::search::{Search, State};

/// Evidence up to which an effect is tried without, all else refined anew [nats].
const DOUBTFUL_NATS: f64 = 150.0;
/// Residual over noise above which a joint with several effects is tried as a soft one.
const UNSETTLED: f64 = 1.6;
/// How much a round of refinement must gain for another one [nats].
const WORTH_NATS: f64 = 1.0;

/// How thoroughly shapes are refined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Polish {
    /// Rounds over all terms.
    pub rounds: usize,
    /// Simulated terms too, in the first round: they are dear.
    pub driven: bool,
}

impl Search<'_> {
    /// Refines the shapes of all terms beside each other, round after round, and makes terms that depend on the
    /// model's torque anew.
    pub(crate) fn polish(&self, base: &Base, model: &mut Model, state: &mut State, how: Polish) -> Option<()> {
        for round in 0..how.rounds {
            let mut gained = 0.0;
            for i in 0..model.atoms.len() {
                gained += self.polish_one(base, model, state, i, how.driven && round == 0)?;
            }
            *state = self.fit(model)?;
            if gained < WORTH_NATS {
                break;
            }
        }
        Some(())
    }

    /// Refines term `i` beside the others; what it gained [nats].
    fn polish_one(&self, base: &Base, model: &mut Model, state: &State, i: usize, driven: bool) -> Option<f64> {
        let atom = model.atoms[i].clone();
        let family = &self.families[atom.family];
        if family.event || (family.driven && !driven) {
            return Some(0.0);
        }
        let ctx = context(self.scene, base, self, model, Some(state));
        let sharp = family.refinable(&ctx, atom.joint);
        if !sharp && !family.dynamic {
            return Some(0.0);
        }
        let anew = if family.dynamic { self.atom(&ctx, atom.family, atom.joint, &atom.shape) } else { atom };
        if !sharp {
            model.atoms[i] = anew;
            return Some(0.0);
        }
        let mut without = model.without(&[i]);
        let rest = self.fit(&mut without)?;
        let reach = if family.driven { (1.05, 1) } else { (1.25, 2) };
        let simulated = if family.driven { self.newton(&ctx, &without, &rest, &anew, reach.0) } else { None };
        let (better, gain) = simulated.unwrap_or_else(|| self.refine_within(&ctx, &without, &rest, &anew, reach));
        model.atoms[i] = better;
        Some(gain)
    }

    /// Evidence for `new` over `old` [nats], each less the price of its terms, at the independent rows of the one
    /// that leaves less.
    pub(crate) fn better(&self, old: (&Model, &State), new: (&Model, &State)) -> f64 {
        let rest = |s: &State| (0..self.scene.joints).map(|j| s.weights[j].ln()).sum::<f64>();
        let judge = if rest(new.1) > rest(old.1) { new.1 } else { old.1 };
        self.compare(judge, &old.1.fit, &new.1.fit, Vec::new()).gain - self.price(new.0) + self.price(old.0)
    }

    /// What the terms of a model cost [nats]: each effect its entry, each number its price.
    pub(crate) fn price(&self, model: &Model) -> f64 {
        let mut seen: Vec<&str> = Vec::new();
        let mut sum = 0.0;
        for atom in model.atoms.iter().filter(|a| !self.families[a.family].event) {
            let family = &self.families[atom.family];
            if !seen.contains(&family.id()) {
                seen.push(family.id());
                sum += self.limits.entry[atom.family];
            }
            sum += self.limits.column * (atom.width() + usize::from(family.driven) * atom.shape.len()) as f64;
        }
        sum
    }

    /// Takes out effects that the others, refined anew, do not need.
    pub(crate) fn settle(
        &self,
        base: &Base,
        model: &mut Model,
        state: &mut State,
        progress: &mut dyn FnMut(f64, &str),
    ) -> Option<()> {
        let mut kept: Vec<&'static str> = Vec::new();
        loop {
            let weakest = self.weakest(model, state, &kept)?;
            let Some((id, nats)) = weakest.filter(|w| w.1 < DOUBTFUL_NATS) else { return Some(()) };
            let gone: Vec<usize> = (0..model.atoms.len()).filter(|i| self.effect_of(&model.atoms[*i]) == id).collect();
            let mut trial = model.without(&gone);
            let mut trial_state = self.fit(&mut trial)?;
            self.polish(base, &mut trial, &mut trial_state, Polish { rounds: 2, driven: false })?;
            if self.better((model, state), (&trial, &trial_state)) > 0.0 {
                progress(0.78, &format!("- {id}: {nats:.0} nats, none beside the others refined"));
                (*model, *state) = (trial, trial_state);
                self.prune(model, state, progress)?;
            } else {
                kept.push(id);
            }
        }
    }

    /// Whether an inertia of a joint is the part that a coupled motor has at that joint by itself: the catalogue's
    /// law of coupled axes leaves it to the joint's own inertia.
    pub(crate) fn is_part_of_coupling(&self, model: &Model, atom: &Atom) -> bool {
        let coupled = |a: &Atom| self.effect_of(a) == "axis_coupling" && (a.joint..=a.joint + 1).contains(&atom.joint);
        self.effect_of(atom) == "rotor_inertia" && model.atoms.iter().any(coupled)
    }

    pub(crate) fn effect_of(&self, atom: &Atom) -> &'static str {
        self.families[atom.family].id()
    }

    /// The effect whose loss costs least, of those not `kept`, with that cost [nats].
    fn weakest(&self, model: &Model, state: &State, kept: &[&str]) -> Option<Option<(&'static str, f64)>> {
        let mut out: Option<(&'static str, f64)> = None;
        for atom in &model.atoms {
            let id = self.effect_of(atom);
            if self.families[atom.family].event || kept.contains(&id) {
                continue;
            }
            let own: Vec<usize> = (0..model.atoms.len()).filter(|i| self.effect_of(&model.atoms[*i]) == id).collect();
            let without = self.fit_without(model, state, &own)?;
            let score = self.compare(state, &without, &state.fit, Vec::new());
            // Short recordings give few nats; what is there in every part of them is no stand-in.
            if self.steady(&without, &score) {
                continue;
            }
            let loss = score.gain;
            if out.is_none_or(|o| loss < o.1) {
                out = Some((id, loss));
            }
        }
        Some(out)
    }

    /// Whether a soft joint or one with play explains better what was named at its joint.
    pub(crate) fn soften(
        &self,
        base: &Base,
        model: &mut Model,
        state: &mut State,
        progress: &mut dyn FnMut(f64, &str),
    ) -> Option<()> {
        if self.is_driven(model) {
            return Some(());
        }
        let rms = self.held_out_rms(state);
        let over: Vec<f64> = (0..rms.len()).map(|j| rms[j] / self.limits.noise_nm[j].max(1e-30)).collect();
        let own = |j: usize| -> Vec<usize> {
            let at = |a: &Atom| self.families[a.family].per_joint() && a.joint == j && !self.families[a.family].event;
            (0..model.atoms.len()).filter(|i| at(&model.atoms[*i])).collect()
        };
        let mut joints: Vec<usize> = (0..rms.len()).filter(|j| over[*j] > UNSETTLED && !own(*j).is_empty()).collect();
        joints.sort_by(|a, b| over[*b].total_cmp(&over[*a]));
        for j in joints.into_iter().take(2) {
            let gone = own(j);
            let mut trial = model.without(&gone);
            let mut rest = self.fit(&mut trial)?;
            let ctx = context(self.scene, base, self, &trial, Some(&rest));
            let pool = self.driven_at(&ctx, &trial, &rest, &[j]);
            let ranked = self.round(&ctx, &trial, &rest, &pool);
            let Some(best) = ranked.first().filter(|r| r.merit > 0.0) else { continue };
            let best = self.refined(&ctx, &trial, &rest, best);
            trial.atoms.extend(best.atoms.iter().cloned());
            rest = self.fit(&mut trial)?;
            // What was named there may be there as well.
            for i in gone {
                let atom = model.atoms[i].clone();
                let ctx = context(self.scene, base, self, &trial, Some(&rest));
                if let Some(again) = self.rank(&ctx, &trial, &rest, vec![atom]).filter(|r| self.counts(&rest, r)) {
                    trial.atoms.extend(again.atoms);
                    rest = self.fit(&mut trial)?;
                }
            }
            self.polish(base, &mut trial, &mut rest, Polish { rounds: 1, driven: true })?;
            self.prune(&mut trial, &mut rest, progress)?;
            let nats = self.better((model, state), (&trial, &rest));
            progress(0.76, &format!("{} in place of what is at joint {}: {nats:.0} nats", self.label(&best), j + 1));
            if nats > 0.0 && self.is_driven(&trial) {
                (*model, *state) = (trial, rest);
                return Some(());
            }
        }
        Some(())
    }
}
