//! Torque ripple over the motor's angle: which orders a joint has.
//!
//! The residual is taken apart over the angle θ instead of over time. For every order h, with the motor angle
//! ϑ = N θ, the complex amplitude c of r ≈ Re(c e^{−ihϑ}) is fitted with each fold left out and judged on it;
//! the best order enters, all amplitudes are fitted anew, and so on. An order counts only if the folds agree in
//! the **complex** amplitude: a ripple that turns its phase from one recording to the next is none of the
//! angle.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | h | order per motor revolution (per joint revolution where the gear ratio is not known) | 1 |
//! | a(f) | gain of the filter on torque and columns, 1/(1 + (f/f_band)⁸), at f = h N θ̇ / 2π | 1 |
//!
//! Columns here are a(f) sin hϑ, a(f) cos hϑ: the filter at the frequency of the moment instead of a filtered
//! signal for every order. What is found is judged again with the exact columns.
//!
//! Nonuniform least-squares spectrum: Lomb 1976, Astrophys. Space Sci. 39, 447-462.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::rank::Ranked;
use crate::search::{Search, State};
use lacuna_physics::effects::catalogue::cogging::candidate_orders;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Most orders of one joint.
const MOST: usize = 12;
/// Most orders that are tried.
const TRIED: usize = 1200;
/// Fewest periods of an order within a joint's range: fewer are a spring.
const PERIODS: f64 = 3.0;
/// Part of the agreement in complex amplitude that folds must have: 1 if all are alike, about
/// 1/√folds if they are drawn at random.
const COHERENCE: f64 = 0.7;
/// Nats that an order must gain for its two amplitudes. One that neither motor nor gear suggests must gain the
/// logarithm of the number of orders tried on top: the largest of many is large by chance.
const ORDER_NATS: f64 = 12.0;

/// Rows of one joint as the spectrum needs them.
struct Rows {
    /// Motor angle [rad].
    angle: Vec<f64>,
    /// Frequency of order 1 over the band.
    rate: Vec<f64>,
    /// Residual [Nm].
    residual: Vec<f64>,
    /// Fold.
    fold: Vec<usize>,
    folds: usize,
}

/// Products of one order's sine and cosine with themselves and the residual, in one fold.
#[derive(Debug, Clone, Copy, Default)]
struct Products {
    ss: f64,
    sc: f64,
    cc: f64,
    sr: f64,
    cr: f64,
}

impl Products {
    fn add(&mut self, o: &Self, sign: f64) {
        self.ss += sign * o.ss;
        self.sc += sign * o.sc;
        self.cc += sign * o.cc;
        self.sr += sign * o.sr;
        self.cr += sign * o.cr;
    }

    /// Sine and cosine amplitudes.
    fn amplitude(&self) -> Option<[f64; 2]> {
        let det = self.ss * self.cc - self.sc * self.sc;
        (det > 1e-6 * self.ss * self.cc && det > 0.0)
            .then(|| [(self.sr * self.cc - self.cr * self.sc) / det, (self.cr * self.ss - self.sr * self.sc) / det])
    }

    /// Sum of squares that amplitudes take off.
    fn taken(&self, [a, b]: [f64; 2]) -> f64 {
        2.0 * (a * self.sr + b * self.cr) - (a * a * self.ss + 2.0 * a * b * self.sc + b * b * self.cc)
    }
}

/// An order and what it takes off rows it was not fitted to.
#[derive(Debug, Clone, Copy)]
struct Line {
    order: f64,
    taken: f64,
    coherence: f64,
}

impl Rows {
    /// Sine and cosine of an order at row `k`, through the filter.
    fn at(&self, order: f64, k: usize) -> (f64, f64) {
        let f8 = (order * self.rate[k]).powi(2).powi(4);
        let gain = 1.0 / (1.0 + f8);
        let (sin, cos) = (order * self.angle[k]).sin_cos();
        (gain * sin, gain * cos)
    }

    fn products(&self, order: f64) -> Vec<Products> {
        let mut out = vec![Products::default(); self.folds];
        for k in 0..self.angle.len() {
            let (s, c) = self.at(order, k);
            let r = self.residual[k];
            out[self.fold[k]].add(&Products { ss: s * s, sc: s * c, cc: c * c, sr: s * r, cr: c * r }, 1.0);
        }
        out
    }

    /// What an order takes off folds left out, and how well they agree.
    fn line(&self, order: f64) -> Option<Line> {
        let own = self.products(order);
        let mut total = Products::default();
        own.iter().for_each(|p| total.add(p, 1.0));
        // Hardly passed by the filter anywhere: nothing can be said.
        if total.ss + total.cc < 0.02 * self.angle.len() as f64 {
            return None;
        }
        let (mut taken, mut re, mut im, mut size) = (0.0, 0.0, 0.0, 0.0);
        for p in &own {
            let mut rest = total;
            rest.add(p, -1.0);
            taken += p.taken(rest.amplitude()?);
            // A fold without motion at this order has no say.
            if let Some([a, b]) = p.amplitude() {
                let weight = p.ss + p.cc;
                re += weight * a;
                im += weight * b;
                size += weight * a.hypot(b);
            }
        }
        Some(Line { order, taken, coherence: re.hypot(im) / size.max(1e-300) })
    }

    /// Residual with all these orders fitted at once.
    fn without(&self, orders: &[f64], target: &[f64]) -> Option<Vec<f64>> {
        let (n, m) = (self.angle.len(), 2 * orders.len());
        let columns: Vec<Vec<f64>> = orders
            .iter()
            .flat_map(|h| {
                let (s, c): (Vec<f64>, Vec<f64>) = (0..n).map(|k| self.at(*h, k)).unzip();
                [s, c]
            })
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let normal =
            DMatrix::from_fn(m, m, |i, k| dot(&columns[i], &columns[k]) + if i == k { 1e-9 * n as f64 } else { 0.0 });
        let right = DVector::from_fn(m, |i, _| dot(&columns[i], target));
        let beta = normal.cholesky()?.solve(&right);
        let mut out = target.to_vec();
        for (c, b) in columns.iter().zip(beta.iter()) {
            out.iter_mut().zip(c).for_each(|(r, x)| *r -= b * x);
        }
        Some(out)
    }
}

impl Search<'_> {
    /// One candidate per joint: all orders of torque ripple in its residual together.
    ///
    /// Joints in `banned` (family, joint) are left out.
    pub fn ripple(&self, ctx: &Context<'_>, model: &Model, state: &State, banned: &[(usize, usize)]) -> Vec<Ranked> {
        let Some(family) = self.families.iter().position(|f| f.id() == "cogging") else { return Vec::new() };
        let joints: Vec<usize> = (0..self.scene.joints).filter(|j| !banned.contains(&(family, *j))).collect();
        let sets: Vec<Vec<Atom>> = joints
            .par_iter()
            .map(|j| {
                let orders = self.ripple_orders(ctx, model, state, *j);
                orders.iter().map(|h| self.atom(ctx, family, *j, &[*h])).collect()
            })
            .collect();
        let rank = |atoms: Vec<Atom>| {
            let joint = atoms.first()?.joint;
            let mut ranked = self.rank(ctx, model, state, atoms)?;
            // That the joint ripples is settled by its first orders; further ones pay for their columns alone.
            if model.atoms.iter().any(|a| a.family == family && a.joint == joint) {
                ranked.merit += self.limits.entry[family];
            }
            Some(ranked)
        };
        sets.into_iter().filter_map(rank).collect()
    }

    /// Orders of torque ripple in the residual of joint `j`, largest first. Those that the model has already are
    /// not among them.
    pub fn ripple_orders(&self, ctx: &Context<'_>, model: &Model, state: &State, j: usize) -> Vec<f64> {
        let residual = self.residual(model, state);
        let Some(mut rows) = self.rows(ctx, &residual.part[j], j) else { return Vec::new() };
        let had: Vec<f64> = model
            .atoms
            .iter()
            .filter(|a| a.joint == j && self.families[a.family].id() == "cogging")
            .filter_map(|a| a.shape.first().copied())
            .collect();
        let tried: Vec<f64> = self.orders(ctx, j).into_iter().filter(|h| !had.contains(h)).collect();
        let suggested = candidate_orders(&self.scene.robot, j);
        let target = rows.residual.clone();
        let count = rows.angle.len() as f64;
        // The level is judged by what is left after each order: a large ripple hides the next.
        let mut independent = state.independent[j];
        let mut found: Vec<f64> = Vec::new();
        while found.len() < MOST {
            let power: f64 = rows.residual.iter().map(|r| r * r).sum();
            let lines = tried.par_iter().filter(|h| !found.contains(h)).filter_map(|h| rows.line(*h));
            let worth = |l: &Line| {
                let nats = 0.5 * count * independent * (power / (power - l.taken).max(1e-9 * power)).ln();
                let price = if suggested.contains(&l.order) { 0.0 } else { (tried.len() as f64).ln() };
                nats - price - ORDER_NATS
            };
            let best = lines
                .filter(|l| l.coherence > COHERENCE && worth(l) > 0.0)
                .reduce_with(|a, b| if (b.taken, -b.order) > (a.taken, -a.order) { b } else { a });
            let Some(best) = best else { break };
            if (best.taken.max(0.0) / count).sqrt() < 0.5 * self.limits.floor_nm[j] {
                break;
            }
            found.push(best.order);
            match rows.without(&found, &target) {
                Some(rest) => rows.residual = rest,
                None => break,
            }
            independent = self.independent_of(&rows, j);
        }
        found
    }

    /// Share of independent rows of what is left.
    fn independent_of(&self, rows: &Rows, j: usize) -> f64 {
        let mut all = vec![0.0; self.scene.rows];
        let masked = (0..self.scene.rows).filter(|r| self.scene.mask[j][*r]);
        for (row, r) in masked.zip(&rows.residual) {
            all[row] = *r;
        }
        self.independent_share(&all, j)
    }

    fn rows(&self, ctx: &Context<'_>, residual: &[f64], j: usize) -> Option<Rows> {
        let scene = self.scene;
        if residual.is_empty() {
            return None;
        }
        let gear = gear(ctx, j);
        let angle = scene.at_rows(|p, k| gear * p.q[j][k]);
        let rate = scene.at_rows(|p, k| (gear * p.qd[j][k]).abs() / (TAU * scene.band_hz));
        let keep: Vec<usize> = (0..scene.rows).filter(|r| scene.mask[j][*r]).collect();
        let fold = |row: usize| scene.folds.iter().position(|f| f.contains(&row)).unwrap_or(0);
        Some(Rows {
            angle: keep.iter().map(|r| angle[*r]).collect(),
            rate: keep.iter().map(|r| rate[*r]).collect(),
            residual: keep.iter().map(|r| residual[*r]).collect(),
            fold: keep.iter().map(|r| fold(*r)).collect(),
            folds: scene.folds.len(),
        })
    }

    /// Orders to try at joint `j`, per motor revolution: what motor and gear suggest and all whole ones; where the
    /// gear ratio is not known, as fine as the range of motion tells apart.
    fn orders(&self, ctx: &Context<'_>, j: usize) -> Vec<f64> {
        let scene = self.scene;
        let gear = gear(ctx, j).abs();
        let turns = (ctx.range[j].1 - ctx.range[j].0) / TAU * gear;
        let slow = (2.0 * scene.slow_rad_s[j]).max(0.1 * ctx.speed[j]) * gear;
        let (least, most) = (PERIODS / turns.max(1e-9), TAU * scene.band_hz / slow.max(1e-9));
        let known = scene.robot.drive.gear_ratio.is_some();
        let step = if known { 1.0 } else { (0.5 / turns.max(1e-9)).min(1.0) };
        let mut out: Vec<f64> = (1..=TRIED).map(|i| i as f64 * step).collect();
        out.extend(candidate_orders(&scene.robot, j));
        out.retain(|h| *h > least && *h < most);
        out.sort_by(f64::total_cmp);
        out.dedup();
        out
    }
}

/// Motor turns per joint turn; 1 where it is not known.
fn gear(ctx: &Context<'_>, j: usize) -> f64 {
    ctx.scene.robot.drive.gear_ratio.as_ref().and_then(|g| g.get(j)).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two orders over an uneven motion with noise; `turn` is the phase by which the ripple turns from fold to fold.
    fn rows(turn: f64) -> Rows {
        let mut random = 1u64;
        let mut noise = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (random >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let n = 4000;
        let angle: Vec<f64> =
            (0..n).map(|k| 6.0 * (k as f64 * 0.003).sin() + 2.0 * (k as f64 * 0.0071).cos()).collect();
        let fold: Vec<usize> = (0..n).map(|k| k * 5 / n).collect();
        let residual = (0..n)
            .map(|k| {
                let phase = turn * fold[k] as f64;
                0.3 * (7.0 * angle[k] + phase).sin() + 0.1 * (12.0 * angle[k] + 1.0 + phase).cos() + 0.2 * noise()
            })
            .collect();
        Rows { angle, rate: vec![0.0; n], residual, fold, folds: 5 }
    }

    #[test]
    fn a_line_is_where_the_order_is_and_amplitudes_come_back() {
        let mut rows = rows(0.0);
        let best = |rows: &Rows| {
            (3..40).filter_map(|h| rows.line(f64::from(h))).max_by(|a, b| a.taken.total_cmp(&b.taken)).unwrap()
        };
        let first = best(&rows);
        assert!(first.order == 7.0 && first.coherence > 0.95, "{first:?}");
        // Half the squared amplitude is what a sine takes off every row.
        let expected = 0.5 * 0.3f64.powi(2) * rows.angle.len() as f64;
        assert!((first.taken / expected - 1.0).abs() < 0.1, "{} against {expected}", first.taken);
        let target = rows.residual.clone();
        rows.residual = rows.without(&[7.0], &target).unwrap();
        assert_eq!(best(&rows).order, 12.0);
        rows.residual = rows.without(&[7.0, 12.0], &target).unwrap();
        let rms = (rows.residual.iter().map(|r| r * r).sum::<f64>() / rows.angle.len() as f64).sqrt();
        assert!((rms / (0.2 / 12f64.sqrt()) - 1.0).abs() < 0.05, "{rms}");
    }

    #[test]
    fn a_ripple_that_turns_from_fold_to_fold_is_none() {
        let line = rows(1.3).line(7.0).unwrap();
        assert!(line.coherence < COHERENCE && line.taken < 0.0, "{line:?}");
    }

    #[test]
    fn what_the_filter_stops_is_not_judged() {
        let mut rows = rows(0.0);
        rows.rate = vec![1.0; rows.angle.len()];
        assert!(rows.line(12.0).is_none());
        assert!(rows.line(0.5).is_some());
    }
}
