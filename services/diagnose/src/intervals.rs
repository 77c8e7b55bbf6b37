//! How well the numbers of a finding are known.

use crate::families::Context;
use crate::findings::Parameter;
use crate::report::Material;
use lacuna_estimation::stats;

/// Parameters of term `i` with intervals: amplitudes from the spread over folds left out (jackknife), shapes
/// from the curvature of the evidence.
pub fn parameters(m: &Material<'_>, ctx: &Context<'_>, i: usize, several: bool) -> Vec<Parameter> {
    let (model, fit) = (&m.selection.model, &m.selection.state.fit);
    let atom = &model.atoms[i];
    let family = &m.search.families[atom.family];
    let slots = model.slots(i);
    let amplitude: Vec<f64> =
        if atom.fixed { atom.shape.iter().skip(2).copied().collect() } else { fit.beta[slots.clone()].to_vec() };
    let values = family.parameters(ctx, atom.joint, &atom.shape, &amplitude);
    let spread = |slot: usize| -> f64 {
        let draws: Vec<f64> = fit.fold_beta.iter().filter_map(|b| b.get(slot).copied()).collect();
        let folds = draws.len() as f64;
        let mean = stats::mean(&draws);
        let jackknife = ((folds - 1.0) / folds * draws.iter().map(|b| (b - mean).powi(2)).sum::<f64>()).sqrt();
        let formal = fit.variance.get(slot).copied().unwrap_or(0.0).sqrt();
        // Student's t for as many folds.
        (1.96 + 2.4 / (folds - 1.0).max(1.0)) * jackknife.max(formal)
    };
    let shapes = family.shapes(ctx, atom.joint).unwrap_or_default();
    values
        .into_iter()
        .map(|(symbol, value)| {
            let half = match family.keep.iter().position(|k| *k == symbol) {
                Some(c) if !atom.fixed => spread(slots.start + c),
                Some(_) => 0.0,
                None => shapes
                    .iter()
                    .position(|s| s.symbol == symbol && s.bounds.is_some())
                    .map_or(0.0, |s| 1.96 * curvature(m, ctx, i, s)),
            };
            Parameter {
                unit: family.effect.parameters.iter().find(|p| p.symbol == symbol).map_or("", |p| p.unit).to_owned(),
                joint: (several || family.per_joint()).then(|| m.scene.robot.joints[atom.joint].clone()),
                ci95: [value - half, value + half],
                symbol,
                value,
            }
        })
        .collect()
}

/// Standard deviation of a shape parameter from how the evidence falls beside it.
fn curvature(m: &Material<'_>, ctx: &Context<'_>, i: usize, shape: usize) -> f64 {
    let mut model = m.selection.model.clone();
    let atom = model.atoms.remove(i);
    let Some(state) = m.search.fit(&mut model) else { return 0.0 };
    let at = |factor: f64| -> Option<f64> {
        let mut s = atom.shape.clone();
        s[shape] *= factor;
        let moved = m.search.atom(ctx, atom.family, atom.joint, &s);
        Some(m.search.score(&model, &state, &[&moved])?.gain)
    };
    // The state's weights are those of the larger residual without the term; put the scale right.
    let scale =
        m.selection.state.weights.iter().zip(&state.weights).map(|(a, b)| a / b.max(1e-300)).fold(1.0, f64::max);
    let step = 0.03;
    match (at(1.0), at(1.0 + step), at(1.0 - step)) {
        (Some(c), Some(a), Some(b)) => {
            let fall = ((c - a) + (c - b)) * 0.5 * scale;
            atom.shape[shape].abs() * step / (2.0 * fall.max(1e-3)).sqrt()
        }
        _ => 0.0,
    }
}
