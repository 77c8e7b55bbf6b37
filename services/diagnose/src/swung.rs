//! A payload beside the axis of a wrist that turns: the platform must hold the mass swung round.
//!
//! On an arm the wrist is a joint and the two moments are those of the last link, the same in every carry. On a Delta,
//! along each carry, r = −Jᵀ R(ω t) (m_x, m_y) ω²: for every rate ω two moments per carry by least squares, since
//! nobody says how the wrist stood when a recording began. ω is one for all carries.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::rank::Ranked;
use crate::scene::Column;
use crate::search::{Search, State};
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;

/// Largest rate that is looked for [rad/s].
const MOST_RAD_S: f64 = 30.0;
/// Step of the rates [rad/s]: a carry of two seconds turns by a quarter more or less.
const STEP_RAD_S: f64 = 0.5;

impl Search<'_> {
    /// The best explanation by an off-axis payload on top of a payload that comes and goes.
    pub fn swung(&self, ctx: &Context<'_>, model: &Model, state: &State) -> Option<Ranked> {
        let family = self.families.iter().position(|f| f.event && f.id() == "payload_ecc")?;
        if model.atoms.iter().any(|a| a.family == family) {
            return None;
        }
        let carried = model.atoms.iter().find(|a| !a.carries.is_empty())?.carries.clone();
        if self.scene.body.as_delta().is_none() {
            let atom = self.carry_atom(&self.atom(ctx, family, 0, &[]), &carried);
            return self.rank(ctx, model, state, vec![atom]);
        }
        let residual = self.residual(model, state);
        let arms = self.jacobian_rows();
        let gain = |rate: f64| -> f64 {
            carried.iter().map(|c| self.swing_gain(*c, rate, &residual, &arms, &state.weights)).sum()
        };
        let steps = (MOST_RAD_S / STEP_RAD_S) as i32;
        let rates: Vec<f64> = (-steps..=steps).filter(|i| i.abs() > 3).map(|i| f64::from(i) * STEP_RAD_S).collect();
        let (_, mut rate) = rates
            .into_par_iter()
            .map(|r| (gain(r), r))
            .reduce_with(|a, b| if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a })?;
        let mut step = 0.5 * STEP_RAD_S;
        while step > 0.01 {
            let way = [rate - step, rate, rate + step].map(|r| (gain(r), r));
            rate = way.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(rate, |b| b.1);
            step *= 0.6;
        }
        let whole = self.atom(ctx, family, 0, &[rate]);
        let atoms: Option<Vec<Atom>> =
            carried.iter().map(|c| self.frozen(model, state, &self.carry_atom(&whole, &[*c]))).collect();
        let atoms = atoms?;
        let mut score = self.score(model, state, &atoms.iter().collect::<Vec<_>>())?;
        score.folds = 1.0;
        let numbers = (2 * atoms.len() + 1) as f64;
        let merit = score.gain - self.limits.column * numbers - self.limits.entry[family];
        Some(Ranked { atoms, score, merit })
    }

    /// What a mass swung round at `rate` takes off the residual in one carry [nats].
    fn swing_gain(
        &self,
        (from, to): (f64, f64),
        rate: f64,
        residual: &Column,
        arms: &[Vec<Vector3<f64>>],
        weights: &[f64],
    ) -> f64 {
        let scene = self.scene;
        let (mut a, mut b) = (Matrix2::zeros(), Vector2::zeros());
        for piece in &scene.pieces {
            for (i, row) in piece.rows.clone().enumerate() {
                let t = piece.global_s + (i * scene.stride) as f64 / scene.rate_hz;
                if !(from..to).contains(&t) {
                    continue;
                }
                let (sin, cos) = (rate * t).sin_cos();
                for j in (0..scene.joints).filter(|j| scene.mask[*j][row]) {
                    let arm = arms[row][j];
                    let column = Vector2::new(cos * arm.x + sin * arm.y, cos * arm.y - sin * arm.x);
                    let r = residual.part[j].get(row).copied().unwrap_or(0.0);
                    a += weights[j] * column * column.transpose();
                    b += weights[j] * column * r;
                }
            }
        }
        let ridge = 1e-9 * a.trace() + 1e-30;
        (a + Matrix2::identity() * ridge).try_inverse().map_or(0.0, |inverse| 0.5 * b.dot(&(inverse * b)))
    }
}
