//! The order of the search: enter, refine, swap, prune.

use crate::base::Base;
use crate::context::context;
use crate::events::held_at;
use crate::families::Context;
use crate::model::{Atom, BaseRole, Model};
use crate::polish::Polish;
use crate::rank::Ranked;
use crate::search::{Search, State};
use crate::swap::Rivals;
use rayon::prelude::*;

/// The selected model with what was seen on the way.
pub struct Selection {
    /// Base and terms.
    pub model: Model,
    /// Its fit.
    pub state: State,
    /// Rivals of each effect in the model, with the effect's own merit first.
    pub rivals: Vec<Rivals>,
    /// Stretches whose rows must not count because of what was found: the search is to be run again.
    pub blank: Vec<(f64, f64)>,
    /// Travels of the friction states that fit better beside what was found [rad]: the search is to be run again.
    pub width: Option<Vec<f64>>,
    /// Families of carried seeds that did not hold: what was left out for them should count again.
    pub fallen: Vec<usize>,
    /// Candidates of the last round that were not taken, best first, one per family.
    pub excluded: Vec<Ranked>,
}

/// How long a link may swing on after the beginning of a recording [s].
const SWING_S: f64 = 0.4;

/// Evidence for another travel of a friction state from which on the search begins anew with it [nats].
const WIDTH_NATS: f64 = 10.0;

/// Index of the largest value.
fn largest(values: &[f64]) -> usize {
    (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0)
}

/// A term that an earlier run found.
#[derive(Debug, Clone)]
pub struct Seed {
    /// Family.
    pub family: usize,
    /// Joint.
    pub joint: usize,
    /// Shape.
    pub shape: Vec<f64>,
    /// Times in which it acts.
    pub carries: Vec<(f64, f64)>,
    /// Its amplitudes, if they were held; otherwise they are fitted.
    pub held: Option<Vec<f64>>,
}

impl Search<'_> {
    /// Puts terms that an earlier run found into the model.
    fn plant(
        &self,
        ctx: &Context<'_>,
        base: &Base,
        seeds: &[Seed],
        model: &mut Model,
        state: &mut State,
    ) -> Option<()> {
        for seed in seeds {
            let mut atom = self.atom(ctx, seed.family, seed.joint, &seed.shape);
            if !seed.carries.is_empty() {
                atom = self.carry_atom(&atom, &seed.carries);
            }
            if let Some(amplitude) = &seed.held {
                atom = held_at(&atom, amplitude.clone());
            }
            model.atoms.push(atom);
        }
        if seeds.is_empty() {
            return Some(());
        }
        *state = self.fit(model)?;
        for _ in 0..2 {
            let ctx = context(self.scene, base, self, model, Some(state));
            self.refresh(&ctx, model, state)?;
            for i in 0..model.atoms.len() {
                let atom = model.atoms[i].clone();
                if !self.families[atom.family].driven {
                    continue;
                }
                model.atoms.remove(i);
                let without = self.fit(model)?;
                let better = self.refine(&ctx, model, &without, &atom);
                model.atoms.insert(i, better);
                *state = self.fit(model)?;
            }
        }
        Some(())
    }

    /// Stretches that stop counting because of terms that were not among the `seeds`: where a payload is
    /// picked or placed, and the beginning of recordings of a soft robot that is moving already, whose swing
    /// at that time is not known.
    fn blanks(&self, model: &Model, seeds: &[Seed]) -> Vec<(f64, f64)> {
        let mut out = Vec::new();
        for atom in &model.atoms {
            let family = &self.families[atom.family];
            if seeds.iter().any(|s| s.family == atom.family) {
                continue;
            }
            out.extend(atom.carries.iter().flat_map(|(a, b)| [*a, *b]).map(|t| (t - 0.07, t + 0.07)));
            if family.driven {
                out.extend(self.scene.pieces.iter().map(|p| (p.global_s, p.global_s + SWING_S)));
            }
        }
        out
    }

    /// Held-out residual per joint [Nm].
    pub fn held_out_rms(&self, state: &State) -> Vec<f64> {
        (0..self.scene.joints)
            .map(|j| (state.fit.held_out_joint(j) / self.layout.joint_count(j).max(1.0)).sqrt())
            .collect()
    }

    /// The whole search.
    pub fn select(&self, base: &Base, seeds: &[Seed], progress: &mut dyn FnMut(f64, &str)) -> Option<Selection> {
        let model = Model::new(&base.columns);
        self.select_from(base, model, seeds, progress)
    }

    /// The search from `model` on.
    pub(crate) fn select_from(
        &self,
        base: &Base,
        mut model: Model,
        seeds: &[Seed],
        progress: &mut dyn FnMut(f64, &str),
    ) -> Option<Selection> {
        let mut state = self.fit(&mut model)?;
        // A second run, with stretches left out, has a base of its own.
        let _ = self.base_rms_nm.set(self.held_out_rms(&state));
        self.tell(&model, &state, progress);
        let start = context(self.scene, base, self, &model, Some(&state));
        self.plant(&start, base, seeds, &mut model, &mut state)?;
        // Contacts and swings were looked for before, on the residual as it is.
        let events = !self.is_whitened();
        if !seeds.is_empty() {
            self.tell(&model, &state, progress);
        }
        progress(0.2, "building candidates");
        let fixed = self.build(&start, self.candidates(&start, |f| !f.dynamic));
        let mut excluded = Vec::new();
        let mut ctx = context(self.scene, base, self, &model, Some(&state));
        let mut banned: Vec<(usize, usize)> = Vec::new();
        let mut searched = 0;
        // Whether the shapes of simulated terms were refined beside all that the model holds.
        let mut fresh = false;
        for step in 0..self.limits.most {
            let mut pool = fixed.clone();
            pool.extend(self.build(&ctx, self.candidates(&ctx, |f| f.dynamic && !f.driven)));
            pool.retain(|a| !banned.contains(&(a.family, a.joint)));
            let carries = self.carries(&ctx, &model, &state);
            let settled = carries.as_ref().is_some_and(|c| self.explains(&state, c));
            let mut ranked = if settled { Vec::new() } else { self.round(&ctx, &model, &state, &pool) };
            // Soft joints are dear to simulate: only where nothing plain explains most of it.
            let driven = self.is_driven(&model);
            let idle = !ranked.iter().any(|r| self.counts(&state, r));
            let due = step == 0 || (idle && searched < 2);
            if due && !settled && !driven && !ranked.iter().any(|r| self.explains(&state, r)) {
                searched += 1;
                let pool = self.driven(&ctx, &model, &state);
                ranked.extend(self.round(&ctx, &model, &state, &pool));
                ranked.sort_by(|a, b| b.merit.total_cmp(&a.merit));
            }
            // Shapes are refined before the choice: a sharp law judged off its shape loses to a blunt one.
            let mut top: Vec<Ranked> = Vec::new();
            for r in &ranked {
                let key = |r: &Ranked| (r.atoms[0].family, r.atoms.len(), r.atoms[0].joint);
                if top.len() < 8 && !top.iter().any(|t| key(t) == key(r)) {
                    top.push(r.clone());
                }
            }
            let mut top: Vec<Ranked> = top.par_iter().map(|r| self.refined(&ctx, &model, &state, r)).collect();
            top.extend(carries);
            if events {
                top.extend(self.swung(&ctx, &model, &state));
                top.extend(self.contact(&ctx, &model, &state));
            }
            top.extend(self.ripple(&ctx, &model, &state, &banned));
            top.sort_by(|a, b| b.merit.total_cmp(&a.merit));
            for t in &top {
                progress(
                    0.3 + 0.4 * step as f64 / self.limits.most as f64,
                    &format!("  ? {} {}", self.label(t), self.numbers(t)),
                );
            }
            let Some(best) = self.simplest(&state, top.clone()) else {
                excluded = std::mem::take(&mut ranked);
                excluded.extend(top);
                excluded.sort_by(|a, b| b.merit.total_cmp(&a.merit));
                break;
            };
            // What a soft joint's shape leaves at one time, fitted while another effect was missing, looks like a contact.
            if driven && !fresh && model.atoms.len() > 1 && self.is_event(&best) {
                fresh = true;
                self.polish(base, &mut model, &mut state, Polish { rounds: 1, driven: true })?;
                ctx = context(self.scene, base, self, &model, Some(&state));
                self.tell(&model, &state, progress);
                continue;
            }
            fresh = false;
            progress(0.3 + 0.4 * step as f64 / self.limits.most as f64, &format!("+ {}", self.label(&best)));
            let mut next = model.clone();
            next.atoms.extend(best.atoms.iter().cloned());
            let mut next_state = self.fit(&mut next)?;
            let next_ctx = context(self.scene, base, self, &next, Some(&next_state));
            self.refresh(&next_ctx, &mut next, &mut next_state)?;
            // What looked good in passing must be good once all else is fitted beside it.
            let (old, mut new) = (self.held_out_rms(&state), self.held_out_rms(&next_state));
            // At the joint of its largest torque; or much, where its share is largest: the largest torque may be what it
            // spills over to a strong joint.
            let shares: Vec<f64> = best.score.size_nm.iter().zip(&old).map(|(s, o)| s / o.max(1e-30)).collect();
            let (aim, sharp) = (largest(&best.score.size_nm), largest(&shares));
            let worse = |rms: &[f64]| rms[aim] > 0.98 * old[aim] && rms[sharp] > 0.9 * old[sharp];
            if !self.families[best.atoms[0].family].event && worse(&new) && self.renew(base, &mut next)? {
                next_state = self.fit(&mut next)?;
                new = self.held_out_rms(&next_state);
            }
            if !self.families[best.atoms[0].family].event && worse(&new) {
                progress(0.3, &format!("  taken back: {:.4} Nm at joint {} become {:.4}", old[aim], aim + 1, new[aim]));
                banned.extend(best.atoms.iter().map(|a| (a.family, a.joint)));
                continue;
            }
            let last: Vec<Atom> = std::mem::replace(&mut model, next).atoms;
            state = next_state;
            if model.atoms.len() > 1 {
                self.polish(base, &mut model, &mut state, Polish { rounds: 1, driven: false })?;
            }
            self.prune(&mut model, &mut state, progress)?;
            let alike = |x: &Atom, y: &Atom| {
                let polished = self.families[x.family].refinable(&ctx, x.joint);
                (x.family, x.joint) == (y.family, y.joint) && (polished || x.shape == y.shape)
            };
            if last.len() == model.atoms.len() && last.iter().all(|x| model.atoms.iter().any(|y| alike(x, y))) {
                // It went as it came: it would come for ever.
                banned.extend(best.atoms.iter().map(|a| (a.family, a.joint)));
            }
            let entered = best.atoms.iter().map(|a| (a.family, a.joint));
            banned.extend(entered.filter(|e| !model.atoms.iter().any(|a| (a.family, a.joint) == *e)));
            ctx = context(self.scene, base, self, &model, Some(&state));
            self.tell(&model, &state, progress);
            let blank = self.blanks(&model, seeds);
            let width = if events && self.limits.renew_widths { self.widths(base, &model, &state) } else { None };
            if events && !self.limits.last && !(blank.is_empty() && width.is_none()) {
                let (rivals, fallen) = (Vec::new(), Vec::new());
                return Some(Selection { model, state, rivals, blank, width, fallen, excluded });
            }
        }
        self.polish(base, &mut model, &mut state, Polish { rounds: 2, driven: true })?;
        self.prune(&mut model, &mut state, progress)?;
        progress(0.75, "trying what else could explain it");
        self.soften(base, &mut model, &mut state, progress)?;
        self.settle(base, &mut model, &mut state, progress)?;
        let rivals = self.swap(base, &fixed, &mut model, &mut state, progress)?;
        // A soft joint may have become one with play: its swing at the beginning stays unknown.
        let mut fallen: Vec<usize> = seeds.iter().filter(|s| !s.carries.is_empty()).map(|s| s.family).collect();
        fallen.retain(|f| !model.atoms.iter().any(|a| a.family == *f));
        Some(Selection { model, state, rivals, blank: Vec::new(), width: None, fallen, excluded })
    }

    /// Travels of the friction states that fit better beside `model`. They were fitted before what is missing was known,
    /// and the wrong travel leaves a residual at every reversal that looks like friction which builds up.
    fn widths(&self, base: &Base, model: &Model, state: &State) -> Option<Vec<f64>> {
        let free = model.free_base();
        let coulomb = |j| free.iter().position(|i| model.base[*i].role == BaseRole::Coulomb(j));
        let own: Vec<Option<usize>> = (0..self.scene.joints).map(coulomb).collect();
        let least = |j: usize| 2.0 * WIDTH_NATS / state.independent.get(j).copied().unwrap_or(1.0);
        base.better_widths(self.scene, (&model.columns(), &own), &state.target, &least)
    }

    /// Tells the residual and what the tolerances took.
    fn tell(&self, model: &Model, state: &State, progress: &mut dyn FnMut(f64, &str)) {
        let rms = self.held_out_rms(state);
        let mut values: Vec<String> = Vec::new();
        for (slot, i) in model.free_base().into_iter().enumerate() {
            if let BaseRole::Tolerance(name) = &model.base[i].role {
                values.push(format!("{name} {:.2}", state.fit.beta[slot]));
            }
        }
        for (i, v) in &model.clamped {
            values.push(format!("{:?} held at {v}", model.base[*i].role));
        }
        progress(
            0.15,
            &format!(
                "band {:.1} Hz, slow {:.3?}, residual {rms:.4?} Nm, independent {:.3?}; {}",
                self.scene.band_hz,
                self.scene.slow_rad_s,
                state.independent,
                values.join(", ")
            ),
        );
    }

    /// Dynamic terms are made anew with the present model's torque; all shapes are refined once more.
    fn refresh(&self, ctx: &Context<'_>, model: &mut Model, state: &mut State) -> Option<()> {
        for i in 0..model.atoms.len() {
            let family = &self.families[model.atoms[i].family];
            if !family.dynamic {
                continue;
            }
            let (joint, shape) = (model.atoms[i].joint, model.atoms[i].shape.clone());
            model.atoms[i] = self.atom(ctx, model.atoms[i].family, joint, &shape);
        }
        *state = self.fit(model)?;
        Some(())
    }

    /// Fits the shapes of delays anew, or takes them out where none helps: one that entered before may have stood
    /// in for what has come since. False if there is none.
    fn renew(&self, base: &Base, model: &mut Model) -> Option<bool> {
        let delay = |a: &Atom| a.fixed && self.families[a.family].dynamic && !self.families[a.family].driven;
        let Some(at) = model.atoms.iter().position(delay) else { return Some(false) };
        let old = model.atoms.remove(at);
        let state = self.fit(model)?;
        let ctx = context(self.scene, base, self, model, Some(&state));
        let mut best = self.rank(&ctx, model, &state, vec![self.refine(&ctx, model, &state, &old)]);
        for shape in self.families[old.family].grid(&ctx, old.joint) {
            let atom = self.atom(&ctx, old.family, old.joint, &shape);
            let ranked = self.rank(&ctx, model, &state, vec![atom]);
            if ranked.as_ref().map(|r| r.merit) > best.as_ref().map(|r| r.merit) {
                best = ranked;
            }
        }
        if let Some(ranked) = best.filter(|r| self.counts(&state, r)) {
            let shaped = self.refined(&ctx, model, &state, &ranked);
            model.atoms.extend(shaped.atoms);
        }
        Some(true)
    }

    /// A candidate in words.
    pub fn label(&self, r: &Ranked) -> String {
        let a = &r.atoms[0];
        let joints: Vec<String> = r.atoms.iter().map(|a| (a.joint + 1).to_string()).collect();
        format!("{} [{}] {:.4?}", self.families[a.family].id(), joints.join(","), a.shape)
    }

    fn numbers(&self, r: &Ranked) -> String {
        format!(
            "merit {:.1} gain {:.1} nm {:.3?} folds {:.2} amp {:.4?}",
            r.merit, r.score.gain, r.score.size_nm, r.score.folds, r.score.amplitude
        )
    }
}
