//! The order of the search: enter, refine, swap, prune.

use crate::base::Base;
use crate::families::Context;
use crate::gram::{Fit, Gram};
use crate::scene::{Raw, Scene};
use crate::search::{Atom, BaseRole, Model, Score, Search, State, subtract};
use lacuna_estimation::stats;
use lacuna_physics::effects::Side;
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
    /// Candidates of the last round that were not taken, best first, one per family.
    pub excluded: Vec<Ranked>,
}

/// How much better a rival must be to take an effect's place [nats].
const SWAP_NATS: f64 = 8.0;
/// What share of the best candidate's gain, less a few nats, is nearly as good.
const NEARLY: f64 = 0.9;
/// See [`NEARLY`].
const NEARLY_NATS: f64 = 12.0;
/// How long a link may swing on after the beginning of a recording [s].
const SWING_S: f64 = 0.4;

/// Root of the sum of squares.
fn rms_of(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

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
}

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

/// Facts about the recordings that candidates need, with the present model's torque.
pub fn context<'a>(
    scene: &'a Scene,
    base: &Base,
    search: &Search<'_>,
    model: &Model,
    state: Option<&State>,
) -> Context<'a> {
    let mut predicted = base.nominal.clone();
    let mut link = base.nominal.clone();
    if let Some(state) = state {
        let free = model.free_base();
        for (slot, i) in free.iter().enumerate() {
            let column = &model.base[*i];
            let beta = state.fit.beta[slot];
            add(&mut predicted, &column.raw, beta);
            if matches!(column.role, BaseRole::Parameter(_) | BaseRole::Tolerance(_)) {
                add(&mut link, &column.raw, beta);
            }
        }
        if !base.nominal_base {
            let rigid = scene.rigid_raw(scene.body.as_ref(), &free_parameters(scene, model, state));
            add(&mut predicted, &rigid, 1.0);
            add(&mut link, &rigid, 1.0);
        }
        for (i, value) in &model.clamped {
            add(&mut predicted, &model.base[*i].raw, *value);
            add(&mut link, &model.base[*i].raw, *value);
        }
        for (a, atom) in model.atoms.iter().enumerate() {
            let family = &search.families[atom.family];
            let slots = model.slots(a);
            for (c, raw) in atom.raws.iter().enumerate() {
                let factor = if atom.fixed { 1.0 } else { state.fit.beta[slots.start + c] };
                if family.effect.side != Side::Drive {
                    add(&mut predicted, raw, factor);
                }
                if family.effect.side == Side::Link {
                    add(&mut link, raw, factor);
                }
            }
        }
    }
    let rotor = rotor_inertia(scene);
    let inertia = crate::families::link_inertia(scene, &rotor);
    for (piece, signals) in scene.pieces.iter().zip(&mut link) {
        for (j, signal) in signals.iter_mut().enumerate() {
            for (v, a) in signal.iter_mut().zip(&piece.qdd[j]) {
                *v -= rotor[j] * a;
            }
        }
    }
    let quantile = |f: &dyn Fn(&crate::scene::Piece) -> &Vec<f64>, p: f64, abs: bool| {
        let mut all: Vec<f64> = scene
            .pieces
            .iter()
            .flat_map(|piece| f(piece).iter().step_by(scene.stride).map(|v| if abs { v.abs() } else { *v }))
            .collect();
        stats::quantile_in_place(&mut all, p)
    };
    Context {
        scene,
        stick: base.stick.clone(),
        predicted,
        link,
        nominal_base: base.nominal_base,
        speed: (0..scene.joints).map(|j| quantile(&|p| &p.qd[j], 0.75, true).max(1e-3)).collect(),
        range: (0..scene.joints)
            .map(|j| (quantile(&|p| &p.q[j], 0.0, false), quantile(&|p| &p.q[j], 1.0, false)))
            .collect(),
        inertia,
        rotor,
    }
}

/// Dynamic parameters of a freely fitted base; those that were not fitted are 0.
fn free_parameters(scene: &Scene, model: &Model, state: &State) -> Vec<f64> {
    let mut pi = vec![0.0; scene.pi.len()];
    for (slot, i) in model.free_base().into_iter().enumerate() {
        if let BaseRole::Parameter(symbol) = &model.base[i].role
            && let Some(at) = scene.body.parameters().iter().position(|p| &p.symbol == symbol)
        {
            pi[at] = state.fit.beta[slot];
        }
    }
    pi
}

fn rotor_inertia(scene: &Scene) -> Vec<f64> {
    if let Some(m) = &scene.robot.mass {
        return vec![m.rotor_inertia; scene.joints];
    }
    let parameters = scene.body.parameters();
    (0..scene.joints)
        .map(|j| {
            let symbol = format!("Ia{}", j + 1);
            parameters.iter().position(|p| p.symbol == symbol).map_or(0.0, |i| scene.pi[i])
        })
        .collect()
}

fn add(to: &mut Raw, from: &Raw, factor: f64) {
    for (a, b) in to.iter_mut().zip(from) {
        for (x, y) in a.iter_mut().zip(b) {
            if y.is_empty() {
                continue;
            }
            for (x, y) in x.iter_mut().zip(y) {
                *x += factor * y;
            }
        }
    }
}

impl Search<'_> {
    /// Whether a score is large enough to count, in evidence, in Nm and in folds.
    fn counts(&self, ranked: &Ranked) -> bool {
        let size = ranked.score.size_nm.iter().zip(&self.limits.floor_nm).map(|(s, f)| s / f).fold(0.0, f64::max);
        ranked.merit > 0.0 && size > 1.0 && ranked.score.folds > 0.5
    }

    fn rank(&self, ctx: &Context<'_>, model: &Model, state: &State, atoms: Vec<Atom>) -> Option<Ranked> {
        let score = self.score(model, state, &atoms.iter().collect::<Vec<_>>())?;
        let mut at = 0;
        for atom in &atoms {
            let own = &score.amplitude[at..at + atom.width()];
            at += atom.width();
            if !self.families[atom.family].admissible(ctx, &atom.shape, own) {
                return None;
            }
        }
        let entry = atoms.first().map_or(0.0, |a| self.limits.entry[a.family]);
        let merit = score.gain - self.limits.column * at as f64 - entry;
        Some(Ranked { atoms, score, merit })
    }

    /// All candidates of one round, best first.
    fn round(&self, ctx: &Context<'_>, model: &Model, state: &State, pool: &[Atom]) -> Vec<Ranked> {
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
    fn whole_robot(
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

    /// Of the candidates that count, the one with the fewest amplitudes among those that explain nearly as much
    /// as the best: a tilted base is two numbers, not six springs.
    fn simplest(&self, ranked: Vec<Ranked>) -> Option<Ranked> {
        let width = |r: &Ranked| r.atoms.iter().map(|a| a.width().max(1)).sum::<usize>();
        let ranked: Vec<Ranked> = ranked.into_iter().filter(|r| self.counts(r)).collect();
        let best = ranked.first()?;
        let (enough, amount) = (NEARLY * best.score.gain - NEARLY_NATS, rms_of(&best.score.size_nm));
        let near = |r: &&Ranked| r.score.gain > enough && rms_of(&r.score.size_nm) > 0.98 * amount;
        ranked.iter().filter(near).min_by_key(|r| width(r)).or(Some(best)).cloned()
    }

    /// Whether a candidate takes most of the residual where it is largest.
    fn explains(&self, state: &State, r: &Ranked) -> bool {
        let rms = self.held_out_rms(state);
        let over = |j: usize| rms[j] / self.limits.noise_nm[j].max(1e-30);
        let worst = (0..rms.len()).max_by(|a, b| over(*a).total_cmp(&over(*b))).unwrap_or(0);
        r.merit > 0.0 && r.score.size_nm[worst] > 0.9 * rms[worst]
    }

    /// Replaces effects by better ones and tells what else there was.
    fn swap(
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
                && self.counts(best)
                && swaps < 3
            {
                let better = self.refined(&ctx, &without, &rest, best);
                progress(0.8, &format!("{id} -> {}", self.label(&better)));
                swaps += 1;
                without.atoms.extend(better.atoms);
                *model = without;
                *state = self.fit(model)?;
                self.prune(model, state, progress)?;
                continue;
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

    /// Fit of the model without some of its terms, at the same weights.
    pub fn fit_without(&self, model: &Model, state: &State, gone: &[usize]) -> Option<Fit> {
        let mut target = state.target.clone();
        let mut rest = model.clone();
        for i in gone.iter().rev() {
            let atom = rest.atoms.remove(*i);
            for column in atom.columns.iter().filter(|_| atom.fixed) {
                subtract(&mut target, column, -1.0);
            }
        }
        // A delay that is taken away must not come back as a tolerance.
        let taken: Vec<&Atom> = gone.iter().filter_map(|i| model.atoms.get(*i)).collect();
        let precision = self.precision(&rest, &taken);
        Gram::new(&self.layout, &target, &rest.columns()).fit(&self.layout, &state.weights, &precision)
    }

    /// Elastic joints and backlash, where a residual is large enough to be one: they are dear to simulate.
    fn driven(&self, ctx: &Context<'_>, model: &Model, state: &State) -> Vec<Atom> {
        let n = self.scene.joints;
        let rms = self.held_out_rms(state);
        let most = rms.iter().copied().fold(0.0, f64::max);
        let mut joints: Vec<usize> =
            (0..n).filter(|j| rms[*j] > 2.5 * self.limits.noise_nm[*j] && rms[*j] > 0.75 * most).collect();
        // A soft joint shakes itself most.
        joints.sort_by(|a, b| rms[*b].total_cmp(&rms[*a]));
        joints.truncate(2);
        let mut list = Vec::new();
        let residual = self.residual(model, state);
        for (f, family) in self.families.iter().enumerate().filter(|(_, f)| f.driven) {
            for j in &joints {
                let shapes = match family.id() {
                    "backlash" if ctx.inertia[*j] > 0.0 && ctx.nominal_base => self.screen_backlash(ctx, &residual, *j),
                    "backlash" => Vec::new(),
                    _ => family.grid(ctx, *j),
                };
                list.extend(shapes.into_iter().map(|s| (f, *j, s)));
            }
        }
        self.build(ctx, list)
    }

    /// Held-out residual per joint [Nm].
    pub fn held_out_rms(&self, state: &State) -> Vec<f64> {
        (0..self.scene.joints)
            .map(|j| (state.fit.held_out_joint(j) / self.layout.joint_count(j).max(1.0)).sqrt())
            .collect()
    }

    /// Refines the shapes of a candidate one term after the other.
    fn refined(&self, ctx: &Context<'_>, model: &Model, state: &State, ranked: &Ranked) -> Ranked {
        let mut atoms = Vec::new();
        for atom in &ranked.atoms {
            let atom = self.atom(ctx, atom.family, atom.joint, &atom.shape);
            let sharp = self.families[atom.family].refinable(ctx, atom.joint);
            atoms.push(if sharp { self.refine(ctx, model, state, &atom) } else { atom });
        }
        let whole = self.rank(ctx, model, state, atoms.clone());
        whole.unwrap_or(Ranked { atoms, ..ranked.clone() })
    }

    /// The whole search.
    pub fn select(&self, base: &Base, seeds: &[Seed], progress: &mut dyn FnMut(f64, &str)) -> Option<Selection> {
        let mut model = Model { base: base.columns.clone(), clamped: Vec::new(), atoms: Vec::new() };
        let mut state = self.fit(&mut model)?;
        self.tell(&model, &state, progress);
        let start = context(self.scene, base, self, &model, Some(&state));
        self.plant(&start, base, seeds, &mut model, &mut state)?;
        if !seeds.is_empty() {
            self.tell(&model, &state, progress);
        }
        progress(0.2, "building candidates");
        let fixed = self.build(&start, self.candidates(&start, |f| !f.dynamic));
        let mut excluded = Vec::new();
        let mut ctx = context(self.scene, base, self, &model, Some(&state));
        let mut banned: Vec<(usize, usize)> = Vec::new();
        let mut searched = 0;
        for step in 0..self.limits.most {
            let mut pool = fixed.clone();
            pool.extend(self.build(&ctx, self.candidates(&ctx, |f| f.dynamic && !f.driven)));
            pool.retain(|a| !banned.contains(&(a.family, a.joint)));
            let carries = self.carries(&ctx, &model, &state);
            let settled = carries.as_ref().is_some_and(|c| self.explains(&state, c));
            let mut ranked = if settled { Vec::new() } else { self.round(&ctx, &model, &state, &pool) };
            // Soft joints are dear to simulate: only where nothing plain explains most of it.
            let driven = model.atoms.iter().any(|a| self.families[a.family].driven);
            let idle = !ranked.iter().any(|r| self.counts(r));
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
            top.extend(self.contact(&ctx, &model, &state));
            top.sort_by(|a, b| b.merit.total_cmp(&a.merit));
            for t in &top {
                progress(
                    0.3 + 0.4 * step as f64 / self.limits.most as f64,
                    &format!("  ? {} {}", self.label(t), self.numbers(t)),
                );
            }
            let Some(best) = self.simplest(top) else {
                excluded = std::mem::take(&mut ranked);
                break;
            };
            progress(0.3 + 0.4 * step as f64 / self.limits.most as f64, &format!("+ {}", self.label(&best)));
            let mut next = model.clone();
            next.atoms.extend(best.atoms.iter().cloned());
            let mut next_state = self.fit(&mut next)?;
            let next_ctx = context(self.scene, base, self, &next, Some(&next_state));
            self.refresh(&next_ctx, &mut next, &mut next_state)?;
            // What looked good in passing must be good once all else is fitted beside it.
            let (old, new) = (self.held_out_rms(&state), self.held_out_rms(&next_state));
            let aim = largest(&best.score.size_nm);
            if !self.families[best.atoms[0].family].event && new[aim] > 0.98 * old[aim] {
                progress(0.3, &format!("  taken back: {:.4} Nm at joint {} become {:.4}", old[aim], aim + 1, new[aim]));
                banned.extend(best.atoms.iter().map(|a| (a.family, a.joint)));
                continue;
            }
            (model, state) = (next, next_state);
            self.prune(&mut model, &mut state, progress)?;
            let entered = best.atoms.iter().map(|a| (a.family, a.joint));
            banned.extend(entered.filter(|e| !model.atoms.iter().any(|a| (a.family, a.joint) == *e)));
            ctx = context(self.scene, base, self, &model, Some(&state));
            self.tell(&model, &state, progress);
            let blank = self.blanks(&model, seeds);
            if !blank.is_empty() {
                return Some(Selection { model, state, rivals: Vec::new(), blank, excluded });
            }
        }
        self.prune(&mut model, &mut state, progress)?;
        progress(0.75, "trying what else could explain it");
        let rivals = self.swap(base, &fixed, &mut model, &mut state, progress)?;
        Some(Selection { model, state, rivals, blank: Vec::new(), excluded })
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

    /// Takes out terms that are no longer worth their columns.
    fn prune(&self, model: &mut Model, state: &mut State, progress: &mut dyn FnMut(f64, &str)) -> Option<()> {
        loop {
            let mut worst: Option<(usize, f64)> = None;
            for i in 0..model.atoms.len() {
                let atom = &model.atoms[i];
                let fit = self.fit_without(model, state, &[i])?;
                let loss = self.compare(state, &fit, &state.fit, Vec::new());
                let size = loss.size_nm.iter().zip(&self.limits.floor_nm).map(|(s, f)| s / f).fold(0.0, f64::max);
                let merit = loss.gain - self.limits.column * atom.width() as f64 - 0.5 * self.limits.entry[atom.family];
                let merit = if size < 0.8 && !self.families[atom.family].event { merit.min(-1.0) } else { merit };
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
