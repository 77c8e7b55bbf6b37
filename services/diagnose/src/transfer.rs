//! A fitted model on recordings it was not fitted to: the same columns built anew there, with the coefficients as they
//! are. Nothing is fitted but the times at which a payload of known mass is carried.

use crate::base::Base;
use crate::context::{add, context};
use crate::families::Family;
use crate::model::{Atom, BaseRole, Model};
use crate::scene::{Column, Raw, Scene};
use crate::search::{Limits, Search, State, subtract};
use lacuna_physics::effects::Side;

/// What a search ended with.
#[derive(Clone, Copy)]
pub struct Fitted<'a> {
    /// Base columns and friction states.
    pub base: &'a Base,
    /// Base and terms.
    pub model: &'a Model,
    /// Coefficients.
    pub state: &'a State,
}

/// The model on other recordings.
pub struct Transferred<'a> {
    /// Rows and columns there.
    pub search: Search<'a>,
    /// The base there.
    pub base: Base,
    /// The model there: columns of these recordings, in the order of the coefficients.
    pub model: Model,
}

/// How long a link may swing on after the beginning of a recording [s].
const SWING_S: f64 = 0.4;
/// Time around a pick or place that does not count [s].
const SWITCH_S: f64 = 0.07;
/// Terms that hang on the model's torque, and terms on one another's, are built this often.
const ROUNDS: usize = 3;

impl<'a> Transferred<'a> {
    /// Builds the columns of `fitted` on `scene`.
    pub fn new(scene: &'a Scene, families: &'a [Family], limits: &Limits, fitted: Fitted<'_>) -> Self {
        let base = fitted.base.on(scene);
        let search = Search::new(scene, families, base.target.clone(), limits.clone());
        let mut model = Model { clamped: fitted.model.clamped.clone(), ..Model::new(&base.columns) };
        let dynamic = fitted.model.atoms.iter().any(|a| families[a.family].dynamic);
        for _ in 0..if dynamic { ROUNDS } else { 1 } {
            let ctx = context(scene, &base, &search, &model, Some(fitted.state));
            let atom = |a: &Atom| {
                let built = Atom { fixed: a.fixed, ..search.atom(&ctx, a.family, a.joint, &a.shape) };
                match families[a.family].event {
                    true if a.fixed || a.carries.is_empty() => nothing(built),
                    true => search.carry_atom(&built, &a.carries),
                    false => built,
                }
            };
            model.atoms = fitted.model.atoms.iter().map(atom).collect();
        }
        let mut out = Self { search, base, model };
        out.find_carries(fitted);
        out
    }

    /// Times are no property of a robot: a payload keeps its mass, and is carried here when this recording says so.
    fn find_carries(&mut self, fitted: Fitted<'_>) {
        for i in 0..self.model.atoms.len() {
            if self.model.atoms[i].carries.is_empty() || self.model.atoms[i].fixed {
                continue;
            }
            let slots = self.model.slots(i);
            let Some(mass) = fitted.state.fit.beta.get(slots.start).copied() else { continue };
            let own = &fitted.model.atoms[i];
            let ctx = context(self.search.scene, &self.base, &self.search, &self.model, Some(fitted.state));
            let whole = self.search.atom(&ctx, own.family, own.joint, &own.shape);
            let Some(phi) = whole.columns.first() else { continue };
            let mut residual = self.residual(&self.model, &fitted.state.fit.beta);
            for column in &self.model.atoms[i].columns {
                subtract(&mut residual, column, -mass);
            }
            let sharp: Vec<f64> =
                fitted.state.weights.iter().zip(&fitted.state.independent).map(|(w, i)| w / i * i.max(0.3)).collect();
            let carried = self.search.viterbi(&residual, phi, mass, &sharp);
            let carries = self.search.carry_times(&carried);
            self.model.atoms[i] = self.search.carry_atom(&whole, &carries);
        }
    }

    /// `model`, which has the same kinds of base columns or some of them, with the columns of these recordings and the
    /// terms `keep` of this one.
    pub fn of(&self, model: &Model, keep: &[usize]) -> Model {
        let here = |role: &BaseRole| self.model.base.iter().find(|b| b.role == *role).cloned();
        Model {
            base: model.base.iter().filter_map(|b| here(&b.role)).collect::<Vec<_>>().into(),
            clamped: model.clamped.clone(),
            atoms: keep.iter().filter_map(|i| self.model.atoms.get(*i)).cloned().collect(),
        }
    }

    /// What `model` (this one, or it without some of its terms) leaves at the rows with coefficients `beta`.
    pub fn residual(&self, model: &Model, beta: &[f64]) -> Column {
        let mut out = self.base.target.clone();
        for (i, value) in &model.clamped {
            if let Some(b) = model.base.get(*i) {
                subtract(&mut out, &b.column, *value);
            }
        }
        for column in model.atoms.iter().filter(|a| a.fixed).flat_map(|a| &a.columns) {
            subtract(&mut out, column, 1.0);
        }
        for (column, b) in model.columns().into_iter().zip(beta) {
            subtract(&mut out, column, *b);
        }
        out
    }

    /// The model's whole torque at the full rate, terms of the drive included.
    pub fn torque(&self, state: &State) -> Raw {
        let ctx = context(self.search.scene, &self.base, &self.search, &self.model, Some(state));
        let mut out = ctx.predicted;
        for (a, atom) in self.model.atoms.iter().enumerate() {
            if self.search.families[atom.family].effect.side != Side::Drive {
                continue;
            }
            let slots = self.model.slots(a);
            for (c, raw) in atom.raws.iter().enumerate() {
                let factor = if atom.fixed { 1.0 } else { state.fit.beta.get(slots.start + c).copied().unwrap_or(0.0) };
                add(&mut out, raw, factor);
            }
        }
        out
    }
}

/// A contact does not repeat itself, and how an off-axis payload stands is anew every time.
fn nothing(mut atom: Atom) -> Atom {
    for column in &mut atom.columns {
        column.rows_mut().iter_mut().for_each(Vec::clear);
    }
    for raw in &mut atom.raws {
        raw.iter_mut().flatten().for_each(Vec::clear);
    }
    atom
}

/// Takes out of `scene` what no model of this kind can predict: the swing of a soft joint that was moving already when
/// a recording began, and the moments of pick and place.
pub fn blank(scene: &mut Scene, families: &[Family], limits: &Limits, fitted: Fitted<'_>) {
    let mut out: Vec<(f64, f64)> = Vec::new();
    let atoms = &fitted.model.atoms;
    if atoms.iter().any(|a| families[a.family].driven) {
        out.extend(scene.pieces.iter().map(|p| (p.global_s, p.global_s + SWING_S)));
    }
    if atoms.iter().any(|a| !a.carries.is_empty()) {
        let there = Transferred::new(scene, families, limits, fitted);
        let switches = there.model.atoms.iter().flat_map(|a| a.carries.iter().flat_map(|(on, off)| [*on, *off]));
        out.extend(switches.map(|t| (t - SWITCH_S, t + SWITCH_S)));
    }
    scene.blank(&out);
}
