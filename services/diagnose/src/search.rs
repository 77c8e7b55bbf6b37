//! Which effects are missing: forward selection, swaps and pruning on recordings left out.
//!
//! The base is the robot file's mechanics with viscous and Coulomb friction; the file's own tolerances may
//! move (nuisance columns with a prior and a hard limit), and a delay below half a sample. A candidate is
//! judged by the gain in log predictive density on folds left out,
//! Σ_j ½ n_eff,j ln(RSS_without / RSS_with), where n_eff counts independent samples of the present residual:
//! while the misfit is large and slow, few samples are independent and evidence is worth less. Where what is left
//! stays coloured, the same is counted once more on whitened residuals (see [`crate::whiten`]).

use crate::families::{Context, Family};
use crate::gram::{Fit, Gram, Layout};
use crate::model::{Atom, BaseRole, Model};
use crate::scene::{Column, Scene};
use crate::tolerance::DELAY;
use crate::whiten::Whitening;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// A model with its fit.
pub struct State {
    /// Products.
    pub gram: Gram,
    /// Coefficients and held-out errors.
    pub fit: Fit,
    /// 1/σ² n_eff/n per joint.
    pub weights: Vec<f64>,
    /// Share of independent rows per joint.
    pub independent: Vec<f64>,
    /// Both of the whitened residual: what columns are fitted with and evidence is counted from.
    pub white: Sharpness,
    /// Target less clamped tolerances.
    pub target: Column,
    /// Prior precision per column.
    pub precision: Vec<f64>,
    /// Products with the held tolerances free again; none if none is held.
    pub soft: Option<Soft>,
}

/// How much a row says.
#[derive(Debug, Clone, Default)]
pub struct Sharpness {
    /// 1/σ² n_eff/n per joint.
    pub weights: Vec<f64>,
    /// Share of independent rows per joint.
    pub independent: Vec<f64>,
}

/// Products and target with all tolerances free.
pub struct Soft {
    gram: Gram,
    target: Column,
}

/// How a candidate changes the model.
#[derive(Debug, Clone)]
pub struct Score {
    /// Gain on folds left out [nats].
    pub gain: f64,
    /// Its amplitudes.
    pub amplitude: Vec<f64>,
    /// What it takes off the held-out residual per joint [Nm].
    pub size_nm: Vec<f64>,
    /// Share of folds that gain, weighed by nothing.
    pub folds: f64,
    /// What it takes off the residual of each fold, all joints by their weights [share of the root mean square].
    pub by_fold: Vec<f64>,
}

/// The search over one scene.
pub struct Search<'a> {
    /// Recordings.
    pub scene: &'a Scene,
    /// Registry.
    pub families: &'a [Family],
    /// Blocks.
    pub layout: Layout,
    /// Torque to be explained.
    pub target: Column,
    /// Thresholds.
    pub limits: Limits,
    /// Held-out residual of the base alone, per joint [Nm]; set when the search begins.
    pub base_rms_nm: OnceLock<Vec<f64>>,
}

/// What decides.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Entry threshold per family [nats].
    pub entry: Vec<f64>,
    /// Price of a column [nats].
    pub column: f64,
    /// Smallest contribution that counts, per joint [Nm].
    pub floor_nm: Vec<f64>,
    /// What noise leaves in the band, per joint [Nm].
    pub noise_nm: Vec<f64>,
    /// Most terms.
    pub most: usize,
    /// Families that are not tried: an earlier run found them and could not keep them.
    pub banned: Vec<usize>,
    /// Whether the search may end early to begin anew with other travels of the friction states.
    pub renew_widths: bool,
    /// Whether it must go to its end, whatever it finds on the way.
    pub last: bool,
}

/// Most rounds of holding columns at their limits.
const CLAMP_ROUNDS: usize = 8;
/// Share of what is explained that a further effect must add: no law holds to the last per cent.
const LAW_ERROR: f64 = 0.035;
/// Share of what is left at a joint that an effect must have if it was found on whitened residuals.
const LEAST_OF_REST: f64 = 0.2;
/// The same for what comes and goes at times of its own.
const LEAST_OF_REST_EVENT: f64 = 0.4;
/// Share of a joint's residual power that a plain effect takes, see [`Search::over_floor`].
const PLAIN_SHARE: f64 = 0.3;
/// How large it must be beside the noise.
const PLAIN_NOISE: f64 = 0.5;
/// How large it must be beside what counts otherwise.
const PLAIN_LEAST: f64 = 0.1;
/// Share of the residual that it takes on every fold.
const PLAIN_FOLD: f64 = 0.05;
/// Least share of independent rows: a large slow misfit may blunt the evidence, but only so far.
const LEAST_INDEPENDENT: f64 = 0.05;
/// Share of the prior's limit at which a tolerance is taken to be one standard deviation.
const TOLERANCE_SD: f64 = 0.5;

impl<'a> Search<'a> {
    /// Blocks and target of `scene`.
    pub fn new(scene: &'a Scene, families: &'a [Family], target: Column, limits: Limits) -> Self {
        let count = scene
            .folds
            .iter()
            .map(|f| {
                (0..scene.joints).map(|j| scene.mask[j][f.clone()].iter().filter(|m| **m).count() as f64).collect()
            })
            .collect();
        let layout = Layout { folds: scene.folds.clone(), joints: scene.joints, count, whitening: None };
        Self { scene, families, layout, target, limits, base_rms_nm: OnceLock::new() }
    }

    /// The same search with the base's residual of an earlier one.
    #[must_use]
    pub fn with_base_rms(mut self, rms_nm: Option<Vec<f64>>) -> Self {
        self.base_rms_nm = rms_nm.map(OnceLock::from).unwrap_or_default();
        self
    }

    /// The same search with evidence counted on whitened residuals.
    #[must_use]
    pub fn whitened(mut self, whitening: Whitening) -> Self {
        self.layout.whitening = Some(whitening);
        self
    }

    /// Whether evidence is counted on whitened residuals.
    pub(crate) fn is_whitened(&self) -> bool {
        self.layout.whitening.is_some()
    }

    /// Fits a model; tolerances that run out of their limits are held there, friction that would drive is held at 0.
    pub fn fit(&self, model: &mut Model) -> Option<State> {
        model.clamped.clear();
        let target = self.free_target(model);
        let gram = Gram::new(&self.layout, &target, &model.all_columns());
        let mut state = self.fit_once(model, &gram, &target)?;
        for _ in 0..CLAMP_ROUNDS {
            if !model.clamp(&state.fit.beta) {
                break;
            }
            state = self.fit_once(model, &gram, &target)?;
        }
        if !model.clamped.is_empty() {
            state.soft = Some(Soft { gram, target });
        }
        Some(state)
    }

    /// Fit of the model without some of its terms, at the same weights. Tolerances are held at their limits here
    /// too: else they would take the place of what is taken away.
    pub fn fit_without(&self, model: &Model, state: &State, gone: &[usize]) -> Option<Fit> {
        self.model_without(model, state, gone).map(|(_, fit)| fit)
    }

    /// As [`Self::fit_without`], with the model that was fitted: what it holds at its limits may differ.
    pub fn model_without(&self, model: &Model, state: &State, gone: &[usize]) -> Option<(Model, Fit)> {
        let mut rest = model.without(gone);
        let taken: Vec<&Atom> = gone.iter().filter_map(|i| model.atoms.get(*i)).collect();
        let gram = if taken.iter().any(|a| a.fixed) || (state.soft.is_none() && !model.clamped.is_empty()) {
            Gram::new(&self.layout, &self.free_target(&rest), &rest.all_columns())
        } else {
            let all = state.soft.as_ref().map_or(&state.gram, |s| &s.gram);
            let mut keep: Vec<usize> = (0..model.base.len()).collect();
            for i in (0..model.atoms.len()).filter(|i| !gone.contains(i)) {
                keep.extend(model.slots(i).map(|s| s + model.clamped.len()));
            }
            all.subset(&keep)
        };
        rest.clamped.clear();
        let mut fit = None;
        for _ in 0..=CLAMP_ROUNDS {
            // A delay that is taken away must not come back as a tolerance.
            let precision = self.precision(&rest, &taken);
            let new = gram.held(&rest.clamped).fit(&self.layout, &state.white.weights, &precision)?;
            let again = rest.clamp(&new.beta);
            fit = Some(Fit { prior_nats: new.prior_nats + self.held_nats(&rest), ..new });
            if !again {
                break;
            }
        }
        Some((rest, fit?))
    }

    /// Target less the terms that act in full.
    fn free_target(&self, model: &Model) -> Column {
        let mut target = self.target.clone();
        for column in model.atoms.iter().filter(|a| a.fixed).flat_map(|a| &a.columns) {
            subtract(&mut target, column, 1.0);
        }
        target
    }

    /// What the prior says of the held tolerances [nats].
    fn held_nats(&self, model: &Model) -> f64 {
        model.clamped.iter().map(|(_, v)| 0.5 * (v / TOLERANCE_SD).powi(2)).sum()
    }

    /// Prior precision of the columns of `model`.
    pub(crate) fn precision(&self, model: &Model, more: &[&Atom]) -> Vec<f64> {
        self.precision_of(model, &model.free_base(), more)
    }

    /// Prior precision with these base columns free.
    fn precision_of(&self, model: &Model, base: &[usize], more: &[&Atom]) -> Vec<f64> {
        let late = |a: &Atom| self.families[a.family].id() == "torque_delay";
        let delayed = model.atoms.iter().any(late) || more.iter().any(|a| late(a));
        let mut out: Vec<f64> = base
            .iter()
            .map(|i| match &model.base[*i].role {
                // One delay at a time: beside the effect the half sample of tolerance would fit differences of both.
                BaseRole::Tolerance(name) if name == DELAY && delayed => 1e12,
                BaseRole::Tolerance(_) => TOLERANCE_SD.powi(-2),
                _ => model.base[*i].precision,
            })
            .collect();
        out.extend(model.atoms.iter().flat_map(|a| vec![0.0; a.width()]));
        out
    }

    fn fit_once(&self, model: &Model, all: &Gram, free_target: &Column) -> Option<State> {
        let mut target = free_target.clone();
        for (i, value) in &model.clamped {
            subtract(&mut target, &model.base[*i].column, *value);
        }
        let columns = model.columns();
        let gram = all.held(&model.clamped);
        let precision = self.precision(model, &[]);
        let n = self.scene.joints;
        let whitening = self.layout.whitening.as_ref();
        let starting = |part: &[Vec<f64>], j: usize| {
            let sum: f64 = part[j].iter().map(|v| v * v).sum();
            self.layout.joint_count(j) / sum.max(1e-30)
        };
        let first = whitening.map_or(target.part.as_slice(), |w| target.white(w));
        let mut white = Sharpness { weights: (0..n).map(|j| starting(first, j)).collect(), independent: vec![0.3; n] };
        let mut plain = white.clone();
        let mut fit = gram.fit(&self.layout, &white.weights, &precision)?;
        for _ in 0..2 {
            let residual = residual(&target, &columns, &fit.beta);
            plain = self.sharpness(&residual.part, |j| fit.held_out_joint(j));
            white = match whitening {
                Some(w) => self.sharpness(residual.white(w), |j| fit.held_out_white_joint(j)),
                None => plain.clone(),
            };
            fit = gram.fit(&self.layout, &white.weights, &precision)?;
        }
        fit.prior_nats += self.held_nats(model);
        let Sharpness { weights, independent } = plain;
        Some(State { gram, fit, weights, independent, white, target, precision, soft: None })
    }

    /// Of a residual with this sum of squares on the folds left out.
    fn sharpness(&self, residual: &[Vec<f64>], held_out: impl Fn(usize) -> f64) -> Sharpness {
        let independent: Vec<f64> = residual.iter().enumerate().map(|(j, r)| self.independent_share(r, j)).collect();
        let weight = |(j, share): (usize, &f64)| share * self.layout.joint_count(j).max(1.0) / held_out(j).max(1e-30);
        Sharpness { weights: independent.iter().enumerate().map(weight).collect(), independent }
    }

    /// Share of rows that are independent, from the autocorrelation of the residual.
    pub(crate) fn independent_share(&self, r: &[f64], j: usize) -> f64 {
        if r.is_empty() {
            return 0.3;
        }
        let mask = &self.scene.mask[j];
        let power: f64 = r.iter().map(|v| v * v).sum::<f64>() / self.layout.joint_count(j).max(1.0);
        let mut time = 1.0;
        for lag in 1..60 {
            let (mut sum, mut count) = (0.0, 0.0f64);
            for fold in &self.scene.folds {
                for k in fold.start..fold.end.saturating_sub(lag) {
                    if mask[k] && mask[k + lag] {
                        sum += r[k] * r[k + lag];
                        count += 1.0;
                    }
                }
            }
            let rho = sum / count.max(1.0) / power.max(1e-30);
            if rho < 0.05 {
                break;
            }
            time += 2.0 * rho;
        }
        (1.0 / time).max(LEAST_INDEPENDENT)
    }

    /// What `atoms` would add to the fitted model.
    ///
    /// Tolerances that were held at their limit may go back within it beside the candidate, each on its own: what
    /// pushed them there may be what the candidate explains.
    pub fn score(&self, model: &Model, state: &State, atoms: &[&Atom]) -> Option<Score> {
        let own = atoms.iter().map(|a| a.width()).sum::<usize>();
        let (gram, target) = state.soft.as_ref().map_or((&state.gram, &state.target), |s| (&s.gram, &s.target));
        let mut have = vec![target];
        have.extend(model.all_columns());
        let free: Vec<&Column> = atoms.iter().filter(|a| !a.fixed).flat_map(|a| &a.columns).collect();
        let fixed: Vec<&Column> = atoms.iter().filter(|a| a.fixed).flat_map(|a| &a.columns).collect();
        let mut more = free.clone();
        more.extend(&fixed);
        let size = have.len() - 1 + more.len();
        let acting: Vec<(usize, f64)> = (size - fixed.len()..size).map(|slot| (slot, 1.0)).collect();
        let gram = gram.extended(&self.layout, &have, &more).held(&acting);
        let mut trial = Model { base: Arc::clone(&model.base), clamped: Vec::new(), atoms: Vec::new() };
        let precision = |trial: &Model| {
            let mut out = self.precision_of(model, &trial.free_base(), atoms);
            out.extend(free.iter().map(|_| 0.0));
            out
        };
        if state.soft.is_some() {
            for _ in 0..CLAMP_ROUNDS {
                let held = gram.held(&trial.clamped);
                let beta = held.coefficients(&self.layout, &state.white.weights, &precision(&trial))?;
                if !trial.clamp(&beta) {
                    break;
                }
            }
        }
        let mut fit = gram.held(&trial.clamped).fit(&self.layout, &state.white.weights, &precision(&trial))?;
        fit.prior_nats += self.held_nats(&trial);
        let amplitude = fit.beta[fit.beta.len() - own..].to_vec();
        Some(self.compare(state, &state.fit, &fit, amplitude))
    }

    /// Gain of `new` over `old`.
    pub fn compare(&self, state: &State, old: &Fit, new: &Fit, amplitude: Vec<f64>) -> Score {
        let n = self.scene.joints;
        let mut gain = 0.0;
        let mut size_nm = vec![0.0; n];
        for j in 0..n {
            let count = self.layout.joint_count(j);
            let (a, b) = (old.held_out_white_joint(j).max(1e-30), new.held_out_white_joint(j).max(1e-30));
            gain += 0.5 * count * state.white.independent[j] * (a / b).ln();
            let (a, b) = (old.held_out_joint(j).max(1e-30), new.held_out_joint(j).max(1e-30));
            size_nm[j] = ((a - b) / count.max(1.0)).max(0.0).sqrt();
        }
        gain += old.prior_nats - new.prior_nats;
        // Joints that it does nothing to would only dilute what it does.
        let most = (0..n).map(|j| state.weights[j] * size_nm[j].powi(2)).fold(0.0, f64::max);
        let sum = |fold: &[f64]| -> f64 {
            let acts = |j: &usize| state.weights[*j] * size_nm[*j].powi(2) >= 0.1 * most;
            (0..n).filter(acts).map(|j| state.white.weights[j] * fold[j]).sum()
        };
        let by_fold: Vec<f64> = old
            .held_out_white
            .iter()
            .zip(&new.held_out_white)
            .map(|(a, b)| 1.0 - (sum(b) / sum(a).max(1e-300)).max(0.0).sqrt())
            .collect();
        let folds = by_fold.iter().filter(|s| **s > 0.0).count() as f64 / by_fold.len().max(1) as f64;
        Score { gain, amplitude, size_nm, folds, by_fold }
    }

    /// How large what `score` says of `atoms` is against what counts: noise, and the few per cent to which laws hold of
    /// what the model explains already. Friction near reversals acts in a few rows only: it is small over all of
    /// them and still plain where it acts. What takes a good part of a residual on every fold is plain, however small
    /// it is beside the torque.
    ///
    /// `without` is the fit that the score compares with, `state` the one whose residual is there.
    pub fn over_floor(&self, state: &State, without: &Fit, score: &Score, atoms: &[Atom]) -> f64 {
        let size_nm = &score.size_nm;
        let left = self.held_out_rms(state);
        let steady = score.by_fold.iter().all(|s| *s > PLAIN_FOLD);
        let plain = |j: usize| {
            let rest = without.held_out_joint(j) / self.layout.joint_count(j).max(1.0);
            steady && size_nm[j].powi(2) > PLAIN_SHARE * rest
        };
        let law = self.law_nm(&left);
        let near_reversals = |a: &&Atom| matches!(self.families[a.family].id(), "stribeck" | "presliding");
        let local = |j: usize| {
            let columns = atoms.iter().filter(near_reversals).flat_map(|a| &a.columns);
            columns.map(|c| locality(&c.part[j])).fold(1.0, f64::max)
        };
        // Whitened, the least is evident: what is too small to matter to anybody must not be said.
        let of_rest = if self.is_whitened() { LEAST_OF_REST } else { 0.0 };
        let least = |j: usize| {
            let least = self.limits.floor_nm[j].max(of_rest * left[j]);
            let noise = PLAIN_NOISE * self.limits.noise_nm[j];
            // Simulated recordings may have no noise: what rounding leaves is not plain.
            if plain(j) { least.min(noise.max(PLAIN_LEAST * least)) } else { least }
        };
        let floor = |j: usize| (least(j) / local(j)).max(law[j]);
        (0..size_nm.len()).map(|j| size_nm[j] / floor(j)).fold(0.0, f64::max)
    }

    /// What the laws that leave `left_nm` per joint, held out, may miss of what they explain [Nm].
    pub fn law_nm(&self, left_nm: &[f64]) -> Vec<f64> {
        let error = |(j, left): (usize, &f64)| {
            let base = self.base_rms_nm.get().and_then(|b| b.get(j)).copied().unwrap_or(0.0);
            LAW_ERROR * (base * base - left * left).max(0.0).sqrt()
        };
        left_nm.iter().enumerate().map(error).collect()
    }

    /// How large `size_nm` per joint of something that comes and goes is against what counts.
    pub fn event_over_floor(&self, state: &State, size_nm: &[f64]) -> f64 {
        let left = self.held_out_rms(state);
        let least = |j: usize| if self.is_whitened() { LEAST_OF_REST_EVENT * left[j] } else { 0.0 };
        (0..size_nm.len()).map(|j| size_nm[j] / self.limits.floor_nm[j].max(least(j))).fold(0.0, f64::max)
    }

    /// Residual of the fitted model at the rows.
    pub fn residual(&self, model: &Model, state: &State) -> Column {
        residual(&state.target, &model.columns(), &state.fit.beta)
    }

    /// Makes a term.
    pub fn atom(&self, ctx: &Context<'_>, family: usize, joint: usize, shape: &[f64]) -> Atom {
        let raws = self.families[family].raws(ctx, joint, shape);
        let columns = raws.iter().map(|r| self.scene.column(r.clone())).collect();
        let fixed = self.families[family].fixed();
        Atom { family, joint, shape: shape.to_vec(), raws, columns, fixed, amplitude: Vec::new(), carries: Vec::new() }
    }

    /// Candidates at all shapes, as `(family, joints, shape)`.
    pub fn candidates(&self, ctx: &Context<'_>, wanted: impl Fn(&Family) -> bool) -> Vec<(usize, usize, Vec<f64>)> {
        let mut out = Vec::new();
        for (f, family) in self.families.iter().enumerate().filter(|(_, f)| !f.event && wanted(f)) {
            let joints = if family.per_joint() { self.scene.joints } else { 1 };
            for j in 0..joints {
                out.extend(family.grid(ctx, j).into_iter().map(|shape| (f, j, shape)));
            }
        }
        out
    }

    /// Builds candidates in parallel; order is kept.
    pub fn build(&self, ctx: &Context<'_>, list: Vec<(usize, usize, Vec<f64>)>) -> Vec<Atom> {
        list.into_par_iter().map(|(f, j, shape)| Atom { raws: Vec::new(), ..self.atom(ctx, f, j, &shape) }).collect()
    }
}

/// Share of the rows from which on a term that acts in them is not local.
const LOCAL_SHARE: f64 = 0.33;
/// Most that a term gains by being local.
const MOST_LOCAL: f64 = 3.0;

/// By how much the root mean square of a column over the rows in which it acts exceeds that over a third of all rows;
/// 1 if it acts in more.
fn locality(column: &[f64]) -> f64 {
    let count = column.iter().filter(|v| **v != 0.0).count();
    let (second, fourth) = column.iter().fold((0.0, 0.0), |(second, fourth), v| (second + v * v, fourth + v.powi(4)));
    if count == 0 || fourth <= 0.0 {
        return 1.0;
    }
    let acting = second * second / fourth;
    (LOCAL_SHARE * count as f64 / acting).sqrt().clamp(1.0, MOST_LOCAL)
}

/// `a` −= factor · `b`.
pub fn subtract(a: &mut Column, b: &Column, factor: f64) {
    for (x, y) in a.rows_mut().iter_mut().zip(&b.part) {
        if y.is_empty() {
            continue;
        }
        if x.is_empty() {
            *x = vec![0.0; y.len()];
        }
        for (x, y) in x.iter_mut().zip(y) {
            *x -= factor * y;
        }
    }
}

fn residual(target: &Column, columns: &[&Column], beta: &[f64]) -> Column {
    let mut out = target.clone();
    for (c, b) in columns.iter().zip(beta) {
        subtract(&mut out, c, *b);
    }
    out
}
