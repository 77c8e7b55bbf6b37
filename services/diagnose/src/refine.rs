//! Shapes of terms, refined by the evidence.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::search::{Search, State, subtract};
use rayon::prelude::*;

/// Log step at which a simulated column is differentiated.
const DIFFERENCE: f64 = 0.004;
/// Steps of Gauss and Newton at most.
const NEWTON_STEPS: usize = 3;

impl Search<'_> {
    /// Refines the shape of `atom`, which is not in the model.
    pub fn refine(&self, ctx: &Context<'_>, model: &Model, state: &State, atom: &Atom) -> Atom {
        if self.families[atom.family].driven
            && let Some(better) = self.newton(ctx, model, state, atom, 1.12)
        {
            return better.0;
        }
        let (spread, rounds) = if self.families[atom.family].driven { (1.12, 3) } else { (1.6, 2) };
        self.refine_within(ctx, model, state, atom, (spread, rounds)).0
    }

    /// The shape of a simulated term by Gauss and Newton on the logarithms of its parameters, within a factor of
    /// `spread` a step, and what that gained [nats]; `None` where the first step leads nowhere.
    pub(crate) fn newton(
        &self,
        ctx: &Context<'_>,
        model: &Model,
        state: &State,
        atom: &Atom,
        spread: f64,
    ) -> Option<(Atom, f64)> {
        let family = &self.families[atom.family];
        let bounds: Vec<(f64, f64)> =
            family.shapes(ctx, atom.joint)?.into_iter().map(|s| s.bounds).collect::<Option<_>>()?;
        let value = |a: &Atom| self.score(model, state, &[a]).map(|s| s.gain);
        let (mut best, start) = (atom.clone(), value(atom)?);
        let mut best_value = start;
        for round in 0..NEWTON_STEPS {
            let slopes: Vec<Atom> = (0..bounds.len())
                .into_par_iter()
                .map(|i| {
                    let mut shape = best.shape.clone();
                    shape[i] *= DIFFERENCE.exp();
                    self.slope(&best, &self.atom(ctx, atom.family, atom.joint, &shape))
                })
                .collect();
            let with: Vec<&Atom> = std::iter::once(&best).chain(&slopes).collect();
            let steps = self.score(model, state, &with)?.amplitude;
            let largest = steps.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            let mut share = (spread.ln() / largest.max(1e-12)).min(1.0);
            let mut moved = false;
            for _ in 0..3 {
                let at = |i: usize| (best.shape[i] * (share * steps[i]).exp()).clamp(bounds[i].0, bounds[i].1);
                let shape: Vec<f64> = (0..bounds.len()).map(at).collect();
                let next = self.atom(ctx, atom.family, atom.joint, &shape);
                if let Some(v) = value(&next).filter(|v| *v > best_value) {
                    (best, best_value, moved) = (next, v, true);
                    break;
                }
                share *= 0.3;
            }
            if !moved {
                // At the start it may be the wrong well; later it is the bottom of the right one.
                return (round > 0 || largest < 2.0 * DIFFERENCE).then_some((best, best_value - start));
            }
            if share * largest < DIFFERENCE {
                break;
            }
        }
        Some((best, best_value - start))
    }

    /// The difference of two simulated columns as a term of its own, with the logarithm of the shape as its amplitude.
    fn slope(&self, from: &Atom, to: &Atom) -> Atom {
        let mut columns = to.columns.clone();
        for (column, old) in columns.iter_mut().zip(&from.columns) {
            subtract(column, old, 1.0);
            column.scale(1.0 / DIFFERENCE);
        }
        Atom { columns, fixed: false, raws: Vec::new(), ..to.clone() }
    }

    /// Refines the shape of `atom`, which is not in the model, by golden sections, one parameter at a time, within a
    /// factor of `spread` at first, in so many rounds; with what it gained [nats].
    pub fn refine_within(
        &self,
        ctx: &Context<'_>,
        model: &Model,
        state: &State,
        atom: &Atom,
        (mut spread, rounds): (f64, usize),
    ) -> (Atom, f64) {
        let family = &self.families[atom.family];
        let bounds: Vec<Option<(f64, f64)>> =
            family.shapes(ctx, atom.joint).unwrap_or_default().into_iter().map(|s| s.bounds).collect();
        let mut best = atom.clone();
        let value = |a: &Atom| match self.score(model, state, &[a]) {
            Some(s) if family.admissible(ctx, a.joint, &a.shape, &s.amplitude) => s.gain,
            _ => f64::NEG_INFINITY,
        };
        let mut best_value = value(&best);
        let start = best_value;
        for _ in 0..rounds {
            for (i, bound) in bounds.iter().enumerate() {
                let Some((low, high)) = bound else { continue };
                // Bounds of one sign are searched in ratios, others in differences.
                let ratio = *low > 0.0;
                let at = |x: f64, t: f64| {
                    let v = if ratio { x * spread.powf(t) } else { x + t * 0.15 * spread * (high - low) };
                    v.clamp(*low, *high)
                };
                let centre = best.shape[i];
                let (mut a, mut b) = (-1.0, 1.0);
                let golden = 0.381_966;
                let mut probe = |t: f64| {
                    let mut shape = best.shape.clone();
                    shape[i] = at(centre, t);
                    let candidate = self.atom(ctx, atom.family, atom.joint, &shape);
                    let v = value(&candidate);
                    if v > best_value {
                        best_value = v;
                        best = candidate;
                    }
                    v
                };
                let (mut x1, mut x2) = (a + golden * (b - a), b - golden * (b - a));
                let (mut f1, mut f2) = (probe(x1), probe(x2));
                for _ in 0..5 {
                    if f1 > f2 {
                        (b, x2, f2) = (x2, x1, f1);
                        x1 = a + golden * (b - a);
                        f1 = probe(x1);
                    } else {
                        (a, x1, f1) = (x1, x2, f2);
                        x2 = b - golden * (b - a);
                        f2 = probe(x2);
                    }
                }
            }
            spread = spread.sqrt();
        }
        let gain = if start.is_finite() { best_value - start } else { 0.0 };
        (best, gain)
    }
}
