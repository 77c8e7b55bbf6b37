//! Shapes of terms, refined by the evidence.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::search::{Search, State};

impl Search<'_> {
    /// Refines the shape of `atom`, which is not in the model, by golden sections, one parameter at a time.
    pub fn refine(&self, ctx: &Context<'_>, model: &Model, state: &State, atom: &Atom) -> Atom {
        let (spread, rounds) = if self.families[atom.family].driven { (1.12, 3) } else { (1.6, 2) };
        self.refine_within(ctx, model, state, atom, (spread, rounds)).0
    }

    /// As [`Search::refine`], within a factor of `spread` at first, in so many rounds; with what it gained [nats].
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
            Some(s) if family.admissible(ctx, &a.shape, &s.amplitude) => s.gain,
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
