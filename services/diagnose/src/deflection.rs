//! Elasticity seen directly: what the link-side encoder says against the motor's.
//!
//! e = θ − q_link = D θ̇ + τ_link / k + offset
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | D | lag of the link-side encoder's signal behind the motor's | s |
//! | k | stiffness between the encoders | Nm/rad |
//! | τ_link | torque that the gear passes to the link, by the model | Nm |
//!
//! Two encoders are seldom read at the same instant, and a lag of a millisecond at 1 rad/s is a milliradian: as
//! much as a gear winds up. Friction makes torque and velocity alike, so a fit without D takes the lag for a
//! soft gear. A joint is called elastic only if the load explains what the lag leaves, on folds left out.

use crate::families::Context;
use crate::findings::{Excluded, Finding, Parameter, Reduction};
use crate::scene::{Piece, Scene};
use lacuna_estimation::stats;
use nalgebra::{DMatrix, DVector};

/// Share of the root mean square that the load must take off what the lag leaves.
const LEAST_SHARE: f64 = 0.1;
/// Share of folds in which it must do so.
const LEAST_FOLDS: f64 = 0.7;

/// Which of lag and load are in the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Law {
    Lag,
    Load,
    Both,
}

impl Law {
    /// Columns of the fit: 0 is θ̇, 1 is τ_link.
    fn columns(self) -> &'static [usize] {
        match self {
            Self::Lag => &[0],
            Self::Load => &[1],
            Self::Both => &[0, 1],
        }
    }
}

/// Rows of one fold: deflection, velocity, load, each without its mean (the offset of the encoders).
#[derive(Debug, Clone, Default)]
struct Fold {
    deflection: Vec<f64>,
    columns: [Vec<f64>; 2],
}

/// A fit of one law.
#[derive(Debug, Clone)]
struct Fit {
    beta: Vec<f64>,
    /// Half width of the 95 % interval of each coefficient, by the jackknife over folds.
    half: Vec<f64>,
    /// Held-out sum of squares per fold.
    held_out: Vec<f64>,
}

/// What the second encoder of one joint says.
#[derive(Debug, Clone)]
struct Wound {
    before_rad: f64,
    lag: Fit,
    load: Fit,
    both: Fit,
    count: f64,
}

impl Wound {
    fn rms(&self, fit: &Fit) -> f64 {
        (fit.held_out.iter().sum::<f64>() / self.count.max(1.0)).sqrt()
    }

    /// Whether the load explains what the lag leaves.
    fn elastic(&self) -> bool {
        let (lag, both) = (&self.lag.held_out, &self.both.held_out);
        let better = lag.iter().zip(both).filter(|(a, b)| b < a).count() as f64;
        let known = self.both.beta.get(1).zip(self.both.half.get(1)).is_some_and(|(b, h)| *b > *h);
        known
            && better >= LEAST_FOLDS * lag.len() as f64
            && self.rms(&self.both) < (1.0 - LEAST_SHARE) * self.rms(&self.lag)
    }

    /// Stiffness and its interval.
    fn stiffness(&self) -> Option<(f64, [f64; 2])> {
        let (b, h) = (*self.both.beta.get(1)?, *self.both.half.get(1)?);
        (b > h).then(|| (1.0 / b, [1.0 / (b + h), 1.0 / (b - h)]))
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Coefficients of `law` over folds.
fn solve<'a>(law: Law, folds: impl Iterator<Item = &'a Fold>) -> Option<DVector<f64>> {
    let c = law.columns();
    let (mut normal, mut right) = (DMatrix::zeros(c.len(), c.len()), DVector::zeros(c.len()));
    for fold in folds {
        normal += DMatrix::from_fn(c.len(), c.len(), |i, k| dot(&fold.columns[c[i]], &fold.columns[c[k]]));
        right += DVector::from_fn(c.len(), |i, _| dot(&fold.columns[c[i]], &fold.deflection));
    }
    Some(normal.cholesky()?.solve(&right))
}

fn fit(law: Law, folds: &[Fold]) -> Option<Fit> {
    let beta = solve(law, folds.iter())?;
    let n = folds.len() as f64;
    let mut held_out = Vec::with_capacity(folds.len());
    let mut draws: Vec<Vec<f64>> = vec![Vec::new(); beta.len()];
    for (f, own) in folds.iter().enumerate() {
        let b = solve(law, folds.iter().enumerate().filter(|(i, _)| *i != f).map(|(_, x)| x))?;
        let rest = own.deflection.iter().enumerate().map(|(k, e)| {
            let model: f64 = law.columns().iter().zip(b.iter()).map(|(c, v)| own.columns[*c][k] * v).sum();
            (e - model).powi(2)
        });
        held_out.push(rest.sum());
        draws.iter_mut().zip(b.iter()).for_each(|(d, v)| d.push(*v));
    }
    let half = draws
        .iter()
        .map(|d| {
            let mean = stats::mean(d);
            let jackknife = ((n - 1.0) / n * d.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).sqrt();
            (1.96 + 2.4 / (n - 1.0).max(1.0)) * jackknife
        })
        .collect();
    Some(Fit { beta: beta.as_slice().to_vec(), half, held_out })
}

fn judge(folds: &[Fold]) -> Option<Wound> {
    let count: f64 = folds.iter().map(|f| f.deflection.len() as f64).sum();
    let power: f64 = folds.iter().map(|f| dot(&f.deflection, &f.deflection)).sum();
    Some(Wound {
        before_rad: (power / count.max(1.0)).sqrt(),
        lag: fit(Law::Lag, folds)?,
        load: fit(Law::Load, folds)?,
        both: fit(Law::Both, folds)?,
        count,
    })
}

/// Rows of joint `j` by folds; `None` where it has no second encoder.
fn rows(scene: &Scene, ctx: &Context<'_>, j: usize) -> Option<Vec<Fold>> {
    if scene.pieces.iter().any(|p| p.link_q.len() <= j) {
        return None;
    }
    let index = |p: &Piece| scene.pieces.iter().position(|q| q.rows == p.rows).unwrap_or(0);
    let mut deflection = scene.joint_column(j, |p, k| p.q[j][k] - p.link_q[j][k]);
    let mut speed = scene.joint_column(j, |p, k| p.qd[j][k]);
    let mut load = scene.joint_column(j, |p, k| ctx.link[index(p)][j][k]);
    let signals = [&mut deflection, &mut speed, &mut load].map(|c| std::mem::take(&mut c.part[j]));
    let folds = scene.folds.iter().map(|range| {
        let rows: Vec<usize> = range.clone().filter(|r| scene.mask[j][*r]).collect();
        let own = |s: &Vec<f64>| {
            let mut v: Vec<f64> = rows.iter().filter_map(|r| s.get(*r).copied()).collect();
            let mean = stats::mean(&v);
            v.iter_mut().for_each(|x| *x -= mean);
            v
        };
        Fold { deflection: own(&signals[0]), columns: [own(&signals[1]), own(&signals[2])] }
    });
    Some(folds.filter(|f| f.deflection.len() > 20).collect())
}

/// Elasticity of the joints with a second encoder: a finding for those that wind up under load, and a reason for
/// those that do not.
pub fn deflection(scene: &Scene, ctx: &Context<'_>) -> (Option<Finding>, Vec<Excluded>) {
    let mut soft: Vec<(usize, Wound)> = Vec::new();
    let mut excluded = Vec::new();
    for j in 0..scene.joints {
        let Some(wound) = rows(scene, ctx, j).filter(|f| f.len() > 2).and_then(|f| judge(&f)) else { continue };
        if wound.elastic() {
            soft.push((j, wound));
        } else {
            excluded.push(Excluded { effect: "elasticity".into(), reason: why_not(&scene.robot.joints[j], &wound) });
        }
    }
    (finding(scene, &soft), excluded)
}

/// Degrees with three digits.
fn degrees(rad: f64) -> String {
    let v = rad.to_degrees();
    let places = if v > 0.0 { (2 - v.log10().floor() as i32).clamp(0, 6) as usize } else { 1 };
    format!("{v:.places$}°")
}

fn why_not(joint: &str, w: &Wound) -> String {
    let lag = w.lag.beta.first().copied().unwrap_or(0.0);
    format!(
        "joint {joint}: the second encoder differs by {}, a lag of {:.2} ms leaves {}, load beside it {}; taken for \
         wind-up alone it would be {:.2e} Nm/rad and leave {}",
        degrees(w.before_rad),
        1e3 * lag,
        degrees(w.rms(&w.lag)),
        degrees(w.rms(&w.both)),
        1.0 / w.load.beta.first().copied().filter(|b| *b != 0.0).unwrap_or(f64::INFINITY),
        degrees(w.rms(&w.load)),
    )
}

fn finding(scene: &Scene, soft: &[(usize, Wound)]) -> Option<Finding> {
    let names: Vec<String> = soft.iter().map(|(j, _)| scene.robot.joints[*j].clone()).collect();
    let mut parameters = Vec::new();
    let mut parts = Vec::new();
    // The spring's torque that is not explained, before and after, over all these joints [Nm].
    let (mut before, mut after, mut count) = (0.0, 0.0, 0.0);
    let mut by_fold: Vec<[f64; 2]> = Vec::new();
    for ((j, w), name) in soft.iter().zip(&names) {
        let (k, ci95) = w.stiffness()?;
        let (lag, half) = (*w.both.beta.first()?, *w.both.half.first()?);
        parameters.push(Parameter {
            symbol: "k".into(),
            unit: "Nm/rad".into(),
            value: k,
            ci95,
            joint: Some(name.clone()),
        });
        parameters.push(Parameter {
            symbol: "D".into(),
            unit: "s".into(),
            value: lag,
            ci95: [lag - half, lag + half],
            joint: Some(scene.robot.joints[*j].clone()),
        });
        parts.push(format!("{name} {k:.2e} Nm/rad ({} to {})", degrees(w.rms(&w.lag)), degrees(w.rms(&w.both))));
        before += k * k * w.lag.held_out.iter().sum::<f64>();
        after += k * k * w.both.held_out.iter().sum::<f64>();
        count += w.count;
        by_fold.extend(w.lag.held_out.iter().zip(&w.both.held_out).map(|(a, b)| [k * k * a, k * k * b]));
    }
    let first = soft.first()?;
    let reduction = 1.0 - (after / f64::max(before, 1e-300)).sqrt();
    Some(Finding {
        effect: "elasticity".into(),
        joints: names,
        probability: 0.99,
        status: "named".into(),
        alternatives: Vec::new(),
        group: vec!["elasticity".into()],
        equation: "θ − q_link = D θ̇ + τ_link / k".into(),
        sentence: format!(
            "The second encoders show gears that wind up under load: {}; their signal lags by {:.2} ms, which is taken \
             out first (before it, {} of deflection).",
            parts.join(", "),
            1e3 * first.1.both.beta.first().copied().unwrap_or(0.0),
            degrees(first.1.before_rad)
        ),
        parameters,
        held_out: Reduction {
            before_rms_nm: (before / count).sqrt(),
            after_rms_nm: (after / count).sqrt(),
            reduction,
            ci95: jackknife_interval(reduction, &by_fold),
        },
        region: Vec::new(),
        in_region: None,
        stage: "torque".into(),
        intervals_s: Vec::new(),
    })
}

/// 95 % interval of a reduction of the root mean square, by leaving out folds.
fn jackknife_interval(centre: f64, by_fold: &[[f64; 2]]) -> [f64; 2] {
    let (a, b) = by_fold.iter().fold((0.0, 0.0), |s, f| (s.0 + f[0], s.1 + f[1]));
    let n = by_fold.len() as f64;
    let draws: Vec<f64> = by_fold.iter().map(|f| 1.0 - ((b - f[1]).max(0.0) / (a - f[0]).max(1e-300)).sqrt()).collect();
    let mean = stats::mean(&draws);
    let sd = ((n - 1.0) / n * draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>()).sqrt();
    [centre - 1.96 * sd, (centre + 1.96 * sd).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six folds of a motion with friction: torque follows speed, as in a real gear.
    fn folds(lag_s: f64, compliance: f64) -> Vec<Fold> {
        let mut random = 7u64;
        let mut noise = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (random >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        (0..6)
            .map(|f| {
                let phase = f64::from(f) * 1.7;
                let speed: Vec<f64> = (0..300).map(|k| 0.5 * (f64::from(k) * 0.05 + phase).sin()).collect();
                let load: Vec<f64> = (0..300)
                    .map(|k| {
                        1500.0 * (f64::from(k) * 0.05 + phase).sin()
                            + 800.0 * (f64::from(k) * 0.031 + 2.0 * phase).cos()
                    })
                    .collect();
                let deflection =
                    speed.iter().zip(&load).map(|(v, t)| lag_s * v + compliance * t + 2e-5 * noise()).collect();
                Fold { deflection, columns: [speed, load] }
            })
            .collect()
    }

    #[test]
    fn a_lag_is_not_a_soft_gear() {
        let w = judge(&folds(3e-3, 0.0)).unwrap();
        assert!(!w.elastic());
        assert!((w.lag.beta[0] / 3e-3 - 1.0).abs() < 0.01, "{:?}", w.lag);
        // Without the lag the load would have been believed.
        assert!(w.rms(&w.load) < 0.8 * w.before_rad && w.load.beta[0] > 0.0);
    }

    #[test]
    fn stiffness_and_lag_come_back_together() {
        let w = judge(&folds(1e-3, 1.0 / 2e6)).unwrap();
        assert!(w.elastic());
        let (k, [low, high]) = w.stiffness().unwrap();
        assert!((k / 2e6 - 1.0).abs() < 0.02 && low <= k && k <= high, "{k} {low} {high}");
        assert!((w.both.beta[0] / 1e-3 - 1.0).abs() < 0.02);
    }

    #[test]
    fn two_encoders_that_agree_say_nothing() {
        assert!(!judge(&folds(0.0, 0.0)).unwrap().elastic());
        let still = vec![Fold { deflection: vec![0.0; 30], columns: [vec![0.0; 30], vec![0.0; 30]] }; 3];
        assert!(judge(&still).is_none());
    }
}
