//! What enters may have to go again: pruning, and swapping effects for better ones.

use crate::base::Base;
use crate::context::context;
use crate::model::{Atom, BaseRole, Model};
use crate::polish::Polish;
use crate::rank::Ranked;
use crate::search::{Search, State};
use rayon::prelude::*;

/// How much better a rival must be to take an effect's place [nats].
const SWAP_NATS: f64 = 8.0;
/// Share of one of a joint's friction coefficients that must be left beside a power of its speed.
const FRICTION_LEFT: f64 = 0.3;

/// What else could explain what one effect explains.
#[derive(Debug, Clone)]
pub struct Rivals {
    /// Effect in the model.
    pub effect: &'static str,
    /// Its merit [nats].
    pub merit: f64,
    /// Other effects and their merits, best first.
    pub others: Vec<(&'static str, f64)>,
}

impl Search<'_> {
    /// Replaces effects by better ones and tells what else there was.
    pub(crate) fn swap(
        &self,
        base: &Base,
        fixed: &[Atom],
        model: &mut Model,
        state: &mut State,
        progress: &mut dyn FnMut(f64, &str),
    ) -> Option<Vec<Rivals>> {
        let mut out: Vec<Rivals> = Vec::new();
        let mut swaps = 0;
        let mut effects: Vec<&'static str> = Vec::new();
        for a in &model.atoms {
            let id = self.families[a.family].id();
            if !effects.contains(&id) && !self.families[a.family].event {
                effects.push(id);
            }
        }
        for id in effects {
            let mut without = model.clone();
            let own: Vec<Atom> = model.atoms.iter().filter(|a| self.families[a.family].id() == id).cloned().collect();
            without.atoms.retain(|a| self.families[a.family].id() != id);
            if own.is_empty() {
                continue;
            }
            let rest = self.fit(&mut without)?;
            let ctx = context(self.scene, base, self, &without, Some(&rest));
            let mut pool: Vec<Atom> = fixed.iter().filter(|a| self.families[a.family].id() != id).cloned().collect();
            let dynamic = self.candidates(&ctx, |f| f.dynamic && !f.driven && f.id() != id);
            pool.extend(self.build(&ctx, dynamic));
            let own = self.rank(&ctx, &without, &rest, own);
            let merit = own.as_ref().map_or(0.0, |o| o.merit);
            let mut ranked = self.round(&ctx, &without, &rest, &pool);
            let mut top: Vec<Ranked> = Vec::new();
            for r in &ranked {
                let key = |r: &Ranked| (r.atoms[0].family, r.atoms.len());
                if top.len() < 3 && !top.iter().any(|t| key(t) == key(r)) {
                    top.push(r.clone());
                }
            }
            let top: Vec<Ranked> = top.par_iter().map(|r| self.refined(&ctx, &without, &rest, r)).collect();
            ranked.extend(top.iter().cloned());
            ranked.sort_by(|a, b| b.merit.total_cmp(&a.merit));
            if let Some(best) = ranked.first()
                && best.merit > merit + SWAP_NATS
                && self.counts(&rest, best)
                && swaps < 3
            {
                let better = self.refined(&ctx, &without, &rest, best);
                progress(0.8, &format!("{id} -> {}", self.label(&better)));
                swaps += 1;
                let mut trial = without.clone();
                trial.atoms.extend(better.atoms);
                let mut trial_state = self.fit(&mut trial)?;
                self.polish(base, &mut trial, &mut trial_state, Polish { rounds: 1, driven: false })?;
                // Judged beside each other at the same weights: those without either are blunt.
                if self.better((model, state), (&trial, &trial_state)) > 0.0 {
                    // What comes in its place must stay: pruned, it may leave less than there was.
                    self.prune(&mut trial, &mut trial_state, progress)?;
                    if self.better((model, state), (&trial, &trial_state)) > 0.0 {
                        (*model, *state) = (trial, trial_state);
                        continue;
                    }
                    progress(0.8, &format!("  {id} stays: pruned, its rival explains less"));
                }
            }
            let mut others: Vec<(&'static str, f64)> = Vec::new();
            for r in &ranked {
                let other = self.families[r.atoms[0].family].id();
                if other != id && !others.iter().any(|o| o.0 == other) && others.len() < 4 {
                    others.push((other, r.merit));
                }
            }
            out.push(Rivals { effect: id, merit, others });
        }
        Some(out)
    }

    /// Whether a power of the speed only stands in the place of its joint's viscous and Coulomb friction: between a
    /// constant and a line a power law can be both, and then says nothing that they do not.
    fn is_own_friction(&self, atom: &Atom, with: (&Model, &[f64]), without: (&Model, &[f64])) -> bool {
        let of = |(model, beta): (&Model, &[f64]), role: &BaseRole| {
            model.base_values(beta).find(|(i, _)| model.base[*i].role == *role).map_or(0.0, |(_, v)| v)
        };
        let falls = |role: &BaseRole| of(with, role) < FRICTION_LEFT * of(without, role);
        self.effect_of(atom) == "viscous_power"
            && falls(&BaseRole::Viscous(atom.joint))
            && falls(&BaseRole::Coulomb(atom.joint))
    }

    /// Takes out terms that are no longer worth their columns.
    pub(crate) fn prune(
        &self,
        model: &mut Model,
        state: &mut State,
        progress: &mut dyn FnMut(f64, &str),
    ) -> Option<()> {
        loop {
            let mut worst: Option<(usize, f64)> = None;
            for i in 0..model.atoms.len() {
                let atom = &model.atoms[i];
                let (rest, fit) = self.model_without(model, state, &[i])?;
                let loss = self.compare(state, &fit, &state.fit, Vec::new());
                let size = self.over_floor(state, &fit, &loss, std::slice::from_ref(atom));
                // Orders of one ripple share the doubt whether there is a ripple.
                let alone =
                    !model.atoms.iter().enumerate().any(|(k, a)| {
                        k != i && a.family == atom.family && a.joint == atom.joint && a.carries.is_empty()
                    });
                let doubt = if alone { 0.5 * self.limits.entry[atom.family] } else { 0.0 };
                let merit = loss.gain - self.limits.column * atom.width() as f64 - doubt;
                let small = size < 0.8 && !self.families[atom.family].event;
                let idle = small || self.is_own_friction(atom, (model, &state.fit.beta), (&rest, &fit.beta));
                let merit = if idle { merit.min(-1.0) } else { merit };
                if merit < 0.0 && worst.is_none_or(|(_, w)| merit < w) {
                    worst = Some((i, merit));
                }
            }
            let Some((i, _)) = worst else { return Some(()) };
            let gone = model.atoms.remove(i);
            progress(0.7, &format!("- {} joint {}", self.families[gone.family].id(), gone.joint + 1));
            *state = self.fit(model)?;
        }
    }
}
