//! What is kept of every row of a joint, so that its regressor and torque can be chosen afterwards.
//!
//! ```text
//! z = [ x₁ … x_w | c₁ … c_B | 1 | τ(t − 3h) … τ(t + 3h) | ζ₁ … ζ_w ]
//! ```
//!
//! | part | meaning |
//! |---|---|
//! | x | active base columns of the joint, Coulomb friction by the sign of the velocity |
//! | c | Coulomb friction by a bristle, one column per width (joints with a Coulomb column) |
//! | τ | torque at seven working samples around the row, from which the torque at any small delay is interpolated |
//! | ζ | x at the instrumental motion; only where instruments are made |

use crate::base::Structure;
use crate::columns::Term;
use crate::condition::{BRISTLE_WIDTHS_RAD, Plan};
use lacuna_estimation::filter::stencil_weights;
use lacuna_estimation::least_squares::Mixture;

/// Torques kept on each side of a row.
pub(crate) const REACH: usize = 3;
/// Torques kept per row.
pub(crate) const TORQUES: usize = 2 * REACH + 1;

/// Places of a joint's columns in its rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    /// Active base columns, as in [`Structure::active`].
    pub(crate) active: Vec<usize>,
    /// Place of the Coulomb column among them.
    pub(crate) coulomb: Option<usize>,
    /// Number of bristle columns.
    pub(crate) bristles: usize,
}

impl Layout {
    /// Of every joint.
    pub(crate) fn all(structure: &Structure, plan: &Plan) -> Vec<Self> {
        let of = |(j, active): (usize, &Vec<usize>)| {
            let coulomb =
                active.iter().position(|b| structure.columns[structure.base[*b].column].term == Term::Coulomb(j));
            let bristles = if plan.bristle && coulomb.is_some() { BRISTLE_WIDTHS_RAD.len() } else { 0 };
            Self { active: active.clone(), coulomb, bristles }
        };
        structure.active.iter().enumerate().map(of).collect()
    }

    /// Number of active columns w.
    pub(crate) fn width(&self) -> usize {
        self.active.len()
    }

    /// Place of the constant 1.
    pub(crate) fn one(&self) -> usize {
        self.width() + self.bristles
    }

    /// Place of the first torque.
    pub(crate) fn torque(&self) -> usize {
        self.one() + 1
    }

    /// Entries of a row without instruments.
    pub(crate) fn len(&self) -> usize {
        self.torque() + TORQUES
    }

    /// Place of active column `slot` where the Coulomb column is that of `bristle`.
    pub(crate) fn place(&self, slot: usize, bristle: Option<usize>) -> usize {
        match bristle {
            Some(width) if self.coulomb == Some(slot) => self.width() + width,
            _ => slot,
        }
    }
}

/// A choice among the columns of a joint's rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chosen {
    /// Width of the Coulomb column; `None`: sign of the velocity.
    pub(crate) bristle: Option<usize>,
    /// Weights of the torques kept.
    pub(crate) torque: [f64; TORQUES],
}

/// Weights that interpolate the torque, or a derivative of it by working samples, `at` working samples later.
pub(crate) fn torque_at(at: f64, derivative: usize) -> [f64; TORQUES] {
    let places: Vec<f64> = (0..TORQUES).map(|m| m as f64 - REACH as f64).collect();
    let weights = stencil_weights(&places, at, derivative);
    std::array::from_fn(|m| weights.get(m).copied().unwrap_or(0.0))
}

impl Chosen {
    /// Sign of the velocity, torque as it stands.
    pub(crate) fn plain() -> Self {
        Self { bristle: None, torque: torque_at(0.0, 0) }
    }

    /// Mixture of the torque, as (place, factor).
    pub(crate) fn y(&self, layout: &Layout) -> Vec<(usize, f64)> {
        let torques = self.torque.iter().enumerate().filter(|(_, f)| **f != 0.0);
        torques.map(|(m, f)| (layout.torque() + m, *f)).collect()
    }

    /// Mixture of the residual y − x β.
    pub(crate) fn residual(&self, layout: &Layout, beta: &[f64]) -> Vec<(usize, f64)> {
        let model = layout.active.iter().enumerate().filter(|(_, b)| beta[**b] != 0.0);
        let model = model.map(|(slot, b)| (layout.place(slot, self.bristle), -beta[*b]));
        self.y(layout).into_iter().chain(model).collect()
    }

    /// \[X y\] over the base columns: column p is the torque.
    pub(crate) fn pooled(&self, layout: &Layout, p: usize) -> Vec<Mixture> {
        let x = layout.active.iter().enumerate().map(|(slot, &b)| (layout.place(slot, self.bristle), b, 1.0));
        x.chain(self.y(layout).into_iter().map(|(z, f)| (z, p, f))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_between_samples_is_that_of_the_polynomial() {
        let f = |t: f64| 1.0 + t - 0.3 * t * t + 0.02 * t.powi(5);
        let sum = |w: [f64; TORQUES]| (0..TORQUES).map(|m| w[m] * f(m as f64 - 3.0)).sum::<f64>();
        assert!((sum(torque_at(0.4, 0)) - f(0.4)).abs() < 1e-12);
        assert!((sum(torque_at(0.4, 1)) - (1.0 - 0.24 + 0.1 * 0.4f64.powi(4))).abs() < 1e-12);
        assert_eq!(torque_at(0.0, 0), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    }
}
