//! How well the numbers of a finding are known.
//!
//! Amplitudes: the larger of the formal standard deviation and the jackknife over folds left out. Shapes: from how
//! the evidence falls beside them. Events, which are in one recording only: from the noise alone. To all of them comes
//! what no noise explains, since laws are not quite those of the robot: a calibrated share of the number's size (see
//! [`crate::calibration`]).

use crate::calibration::{NumberKind, size};
use crate::families::{Context, Family};
use crate::findings::Parameter;
use crate::gram::Fit;
use crate::model::Atom;
use crate::report::Material;
use lacuna_estimation::stats;

/// Least half width, as a share of the value: no law is known better than that.
const LEAST_SHARE: f64 = 1e-3;
/// The same for what is found by simulating a soft joint: stiffness, damping ratio, gap.
const LEAST_STIFFNESS: f64 = 0.03;
const LEAST_DAMPING: f64 = 0.3;
const LEAST_GAP: f64 = 0.02;
/// Step beside a shape, as a share of it.
const STEP: f64 = 0.03;

/// Parameters of term `i` with intervals.
pub fn parameters(m: &Material<'_>, ctx: &Context<'_>, i: usize, several: bool) -> Vec<Parameter> {
    let (model, fit) = (&m.selection.model, &m.selection.state.fit);
    let atom = &model.atoms[i];
    let family = &m.search.families[atom.family];
    let start = model.slots(i).start;
    let amplitude: Vec<f64> = if atom.fixed { atom.amplitude.clone() } else { fit.beta[model.slots(i)].to_vec() };
    let values = family.parameters(ctx, atom.joint, &atom.shape, &amplitude);
    let shapes = family.shapes(ctx, atom.joint).unwrap_or_default();
    let unit = |symbol: &str| family.effect.parameters.iter().find(|p| p.symbol == symbol).map_or("", |p| p.unit);
    let given: Vec<(&str, &str, f64)> = values.iter().map(|(s, v)| (s.as_str(), unit(s), *v)).collect();
    let sizes: Vec<f64> = given
        .iter()
        .enumerate()
        .map(|(i, (s, ..))| size(&given, i, kind_of(family, family.keep.iter().any(|k| k == s))))
        .collect();
    values
        .iter()
        .zip(sizes)
        .map(|((symbol, value), size)| {
            let (symbol, value) = (symbol.clone(), *value);
            let column = family.keep.iter().position(|k| *k == symbol);
            let shape = shapes.iter().position(|s| s.symbol == symbol);
            let kind = kind_of(family, column.is_some());
            let half = match (column, shape) {
                (Some(c), _) if atom.fixed => 1.96 * event_amplitude(m, atom, c, value),
                (Some(c), _) => spread(fit, start + c),
                (None, Some(_)) if family.id() == "collision" => 1.96 * event_time(m, atom),
                (None, Some(s)) => 1.96 * curvature(m, ctx, i, s),
                (None, None) => 0.0,
            };
            let half = half.hypot(m.calibration.law_error(family.id(), &symbol, kind) * size);
            let half =
                if half.is_finite() { half.max(least_share(m, family, &symbol) * value.abs()) } else { value.abs() };
            Parameter {
                unit: unit(&symbol).to_owned(),
                joint: (several || family.per_joint()).then(|| m.scene.robot.joints[atom.joint].clone()),
                ci95: [value - half, value + half],
                symbol,
                value,
            }
        })
        .collect()
}

/// Least half width of a number as a share of it.
///
/// A soft joint is simulated, noise-free, with the link inertia of the robot file: its resonance is sharp, so that
/// the evidence falls steeply beside the wrong place. Stiffness goes with the inertia, whose error the file's
/// tolerance states; gap and damping are known to a few parts of what they do to the swing.
fn least_share(m: &Material<'_>, family: &Family, symbol: &str) -> f64 {
    match (family.id(), symbol) {
        ("elasticity" | "backlash", "k") => (2.0 * m.scene.robot.tolerance.mass).max(LEAST_STIFFNESS),
        ("elasticity" | "backlash", "zeta") => LEAST_DAMPING,
        ("backlash", "b") => LEAST_GAP,
        _ => LEAST_SHARE,
    }
}

/// Which of the calibrated factors is meant.
fn kind_of(family: &Family, amplitude: bool) -> NumberKind {
    match (family.event && family.id() != "payload", amplitude) {
        (true, _) => NumberKind::Event,
        (false, true) => NumberKind::Amplitude,
        (false, false) => NumberKind::Shape,
    }
}

/// Half of the 95 % interval of an amplitude, from the fit.
pub fn spread(fit: &Fit, slot: usize) -> f64 {
    let draws: Vec<f64> = fit.fold_beta.iter().filter_map(|b| b.get(slot).copied()).collect();
    let folds = draws.len() as f64;
    let mean = stats::mean(&draws);
    let jackknife = ((folds - 1.0) / folds * draws.iter().map(|b| (b - mean).powi(2)).sum::<f64>()).sqrt();
    let formal = fit.variance.get(slot).copied().unwrap_or(0.0).sqrt();
    // Student's t for as many folds.
    (1.96 + 2.4 / (folds - 1.0).max(1.0)) * jackknife.max(formal)
}

/// Evidence for an event as it stands: ½ Σ w c².
fn event_nats(m: &Material<'_>, atom: &Atom, columns: &[usize]) -> f64 {
    let power = |j: usize| -> f64 {
        columns.iter().filter_map(|c| atom.columns.get(*c)).map(|c| c.part[j].iter().map(|v| v * v).sum::<f64>()).sum()
    };
    0.5 * (0..m.scene.joints).map(|j| m.selection.state.weights[j] * power(j)).sum::<f64>()
}

/// Standard deviation of one force of an event whose column holds `value` times the unit.
fn event_amplitude(m: &Material<'_>, atom: &Atom, column: usize, value: f64) -> f64 {
    value.abs() / (2.0 * event_nats(m, atom, &[column])).max(1e-6).sqrt()
}

/// Standard deviation of begin and duration of an event: its width over its signal-to-noise ratio.
fn event_time(m: &Material<'_>, atom: &Atom) -> f64 {
    let all: Vec<usize> = (0..atom.columns.len()).collect();
    let duration = atom.shape.get(1).copied().unwrap_or(0.0).abs().hypot(0.35 / m.scene.band_hz);
    duration / (2.0 * event_nats(m, atom, &all)).max(1.0).sqrt()
}

/// Standard deviation of a shape parameter from how the evidence falls beside it.
fn curvature(m: &Material<'_>, ctx: &Context<'_>, i: usize, shape: usize) -> f64 {
    let atom = &m.selection.model.atoms[i];
    let mut model = m.selection.model.without(&[i]);
    let Some(value) = atom.shape.get(shape).copied() else { return 0.0 };
    let Some(state) = m.search.fit(&mut model) else { return 0.0 };
    let span = m.search.families[atom.family]
        .shapes(ctx, atom.joint)
        .and_then(|s| s.get(shape).and_then(|s| s.bounds))
        .map_or(0.0, |(low, high)| 0.05 * (high - low).abs());
    let step = STEP * value.abs().max(if value == 0.0 { span } else { 0.0 }).max(1e-12);
    let at = |by: f64| -> Option<f64> {
        let mut s = atom.shape.clone();
        s[shape] += by;
        let moved = m.search.atom(ctx, atom.family, atom.joint, &s);
        Some(m.search.score(&model, &state, &[&moved])?.gain)
    };
    // The state's weights are those of the larger residual without the term; put the scale right.
    let scale =
        m.selection.state.weights.iter().zip(&state.weights).map(|(a, b)| a / b.max(1e-300)).fold(1.0, f64::max);
    match (at(0.0), at(step), at(-step)) {
        (Some(c), Some(a), Some(b)) => {
            let fall = ((c - a) + (c - b)) * 0.5 * scale;
            step / (2.0 * fall.max(1e-3)).sqrt()
        }
        _ => 0.0,
    }
}
