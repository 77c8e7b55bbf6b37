//! A small expression for a torque that no effect of the catalogue explains.
//!
//! Candidates are products of at most one factor each of
//!
//! | factor | unit |
//! |---|---|
//! | 1, s = sgn θ̇ | 1 |
//! | \|θ̇\|^p, p = ½, 1, 2 | (rad/s)^p |
//! | \|τ_link\|, τ_link | Nm |
//! | sin nθ, cos nθ, n = 1, 2; \|sin θ\|, \|cos θ\| | 1 |
//! | T − T̄ | K |
//! | θ̇ of a neighbour | rad/s |
//!
//! so every expression has a unit and its coefficient the unit that makes it a torque. One is chosen by half of
//! the folds, the whole base fitted beside it, and believed only if the other half, which had no part in the
//! choice, agrees; then the same with the halves exchanged must choose no contradiction: the coefficient keeps
//! its sign in every fold left out.

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::scene::{Piece, Raw};
use crate::search::{Score, Search, State};
use rayon::prelude::*;

/// Share that an expression must take off the residual on folds that had no part in its choice.
const LEAST: f64 = 0.05;
/// Share of the fresh folds that must gain.
const MOST_FOLDS: f64 = 0.7;

/// One factor: its name, its unit as exponents of (rad/s, Nm, K), its signal.
struct Factor {
    name: String,
    unit: [f64; 3],
    signal: Vec<Vec<f64>>,
}

/// An expression that survived.
#[derive(Debug, Clone, PartialEq)]
pub struct Expression {
    /// With its coefficient and unit.
    pub text: String,
    /// Share of the residual that it takes off fresh folds.
    pub share: f64,
}

impl Search<'_> {
    /// The best small expression for the residual of joint `j`, if one survives.
    pub fn expression(&self, ctx: &Context<'_>, model: &Model, state: &State, j: usize) -> Option<Expression> {
        let groups = self.factors(ctx, j);
        let mut products: Vec<Vec<(usize, usize)>> = vec![Vec::new()];
        for (g, group) in groups.iter().enumerate() {
            let with = products.iter().flat_map(|p| {
                (0..group.len()).map(move |f| {
                    let mut next = p.clone();
                    next.push((g, f));
                    next
                })
            });
            let with: Vec<_> = with.collect();
            products.extend(with);
        }
        // Three factors are the most that are small.
        products.retain(|p| (1..=3).contains(&p.len()));
        let scored: Vec<(usize, Score)> = products
            .par_iter()
            .enumerate()
            .filter_map(|(i, p)| {
                let factors: Vec<&Factor> = p.iter().map(|(g, f)| &groups[*g][*f]).collect();
                Some((i, self.judge(model, state, j, &factors)?))
            })
            .collect();
        // Each half chooses, the other judges; the better survivor is told.
        let mut best: Option<(f64, usize, &Score)> = None;
        for half in [0, 1] {
            let mean = |s: &Score, which: usize| {
                let own: Vec<f64> =
                    s.by_fold.iter().enumerate().filter(|(f, _)| f % 2 == which).map(|(_, v)| *v).collect();
                (own.iter().sum::<f64>() / own.len().max(1) as f64, own)
            };
            // A factor more must pay for itself.
            let choice = scored.iter().max_by(|a, b| {
                let worth = |x: &(usize, Score)| mean(&x.1, half).0 - 0.01 * products[x.0].len() as f64;
                worth(a).total_cmp(&worth(b))
            });
            let Some((i, score)) = choice else { continue };
            let (share, fresh) = mean(score, 1 - half);
            let gaining = fresh.iter().filter(|v| **v > 0.0).count() as f64;
            if share > LEAST && gaining >= MOST_FOLDS * fresh.len() as f64 && best.is_none_or(|b| share > b.0) {
                best = Some((share, *i, score));
            }
        }
        let (share, i, score) = best?;
        let factors: Vec<&Factor> = products[i].iter().map(|(g, f)| &groups[*g][*f]).collect();
        Some(Expression { text: self.text(*score.amplitude.first()?, &factors), share })
    }

    fn judge(&self, model: &Model, state: &State, j: usize, factors: &[&Factor]) -> Option<Score> {
        let raw: Raw = self
            .scene
            .pieces
            .iter()
            .enumerate()
            .map(|(p, piece)| {
                let mut out = vec![Vec::new(); self.scene.joints];
                out[j] = (0..piece.len()).map(|k| factors.iter().map(|f| f.signal[p][k]).product()).collect();
                out
            })
            .collect();
        let columns = vec![self.scene.column(raw)];
        // Only the columns count; the family is that of no drive term.
        let family = self.families.iter().position(|f| f.id() == "cogging")?;
        let atom = Atom {
            family,
            joint: j,
            shape: Vec::new(),
            raws: Vec::new(),
            columns,
            fixed: false,
            carries: Vec::new(),
            amplitude: Vec::new(),
        };
        let score = self.score(model, state, &[&atom])?;
        (score.gain > 0.0).then_some(score)
    }

    /// Coefficient, unit and factors.
    fn text(&self, coefficient: f64, factors: &[&Factor]) -> String {
        let torque = self.scene.robot.torque_unit.symbol();
        let names: Vec<&str> = factors.iter().map(|f| f.name.as_str()).collect();
        let mut exponents = [0.0; 3];
        for f in factors {
            exponents.iter_mut().zip(f.unit).for_each(|(e, u)| *e -= u);
        }
        format!("{coefficient:.4} {} · {}", unit(torque, exponents), names.join(" · "))
    }

    /// Factors in groups; an expression takes at most one of each.
    fn factors(&self, ctx: &Context<'_>, j: usize) -> Vec<Vec<Factor>> {
        let scene = self.scene;
        let index = |p: &Piece| scene.pieces.iter().position(|q| q.rows == p.rows).unwrap_or(0);
        let factor = |name: &str, unit: [f64; 3], f: &dyn Fn(&Piece, usize) -> f64| Factor {
            name: name.to_owned(),
            unit,
            signal: scene.pieces.iter().map(|p| (0..p.len()).map(|k| f(p, k)).collect()).collect(),
        };
        let speed = |p: f64| move |piece: &Piece, k: usize| piece.qd[j][k].abs().powf(p);
        let load = |p: &Piece, k: usize| ctx.link[index(p)][j][k];
        let angle = |f: fn(f64) -> f64| move |p: &Piece, k: usize| f(p.q[j][k]);
        let mut out = vec![
            vec![factor("sgn θ̇", [0.0; 3], &|p, k| ctx.stick[index(p)][j][k])],
            vec![
                factor("|θ̇|^½", [0.5, 0.0, 0.0], &speed(0.5)),
                factor("|θ̇|", [1.0, 0.0, 0.0], &speed(1.0)),
                factor("θ̇²", [2.0, 0.0, 0.0], &speed(2.0)),
            ],
            vec![
                factor("|τ_link|", [0.0, 1.0, 0.0], &|p, k| load(p, k).abs()),
                factor("τ_link", [0.0, 1.0, 0.0], &load),
            ],
            vec![
                factor("sin θ", [0.0; 3], &angle(f64::sin)),
                factor("cos θ", [0.0; 3], &angle(f64::cos)),
                factor("sin 2θ", [0.0; 3], &angle(|x| (2.0 * x).sin())),
                factor("cos 2θ", [0.0; 3], &angle(|x| (2.0 * x).cos())),
                factor("|sin θ|", [0.0; 3], &angle(|x| x.sin().abs())),
                factor("|cos θ|", [0.0; 3], &angle(|x| x.cos().abs())),
            ],
        ];
        if scene.pieces.iter().all(|p| p.temperature.len() > j) {
            let all: Vec<f64> =
                scene.pieces.iter().flat_map(|p| p.temperature[j].iter().step_by(50).copied()).collect();
            let mean = lacuna_estimation::stats::mean(&all);
            out.push(vec![factor("(T − T̄)", [0.0, 0.0, 1.0], &|p, k| p.temperature[j][k] - mean)]);
        }
        let neighbours = (0..scene.joints).filter(|i| *i != j && i.abs_diff(j) == 1);
        let others: Vec<Factor> = neighbours
            .map(|i| factor(&format!("θ̇({})", scene.robot.joints[i]), [1.0, 0.0, 0.0], &|p, k| p.qd[i][k]))
            .collect();
        if !others.is_empty() {
            out.push(others);
        }
        out
    }
}

/// Unit of a coefficient: the torque's, times powers of rad/s, Nm and K.
fn unit(torque: &str, [speed, load, kelvin]: [f64; 3]) -> String {
    let mut out = String::new();
    // The load is in the torque's own unit: one power of it cancels.
    let own = 1.0 + load;
    let mut push = |name: &str, e: f64| {
        if e == 0.0 {
            return;
        }
        if !out.is_empty() {
            out.push(' ');
        }
        out.push_str(&if e == 1.0 { name.to_owned() } else { format!("{name}^{e}") });
    };
    push(torque, own);
    push("(rad/s)", speed);
    push("K", kelvin);
    if out.is_empty() { "1".to_owned() } else { out }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_make_a_torque() {
        assert_eq!(unit("Nm", [0.0; 3]), "Nm");
        assert_eq!(unit("Nm", [-2.0, 0.0, 0.0]), "Nm (rad/s)^-2");
        assert_eq!(unit("Nm", [0.0, -1.0, 0.0]), "1");
        assert_eq!(unit("A", [-0.5, -1.0, -1.0]), "(rad/s)^-0.5 K^-1");
    }
}
