//! A calibration from diagnoses of robots whose truth is known, and how good one is.

use super::{Calibration, Evidence, Intervals, NumberKind, SCHEMA, logistic};
use lacuna_estimation::stats;
use nalgebra::{SMatrix, SVector};
use std::collections::BTreeMap;

/// What one diagnosis showed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observation {
    /// Families that are not missing, with what their best candidate gained, less the price of its numbers [nats].
    pub nulls: Vec<(String, f64)>,
    /// Named effects: evidence and whether the name is right.
    pub named: Vec<(Evidence, bool)>,
    /// Where "unknown" was said: whether something outside the catalogue was there.
    pub unknown: Vec<bool>,
    /// Numbers of effects named rightly.
    pub numbers: Vec<Number>,
}

/// A number of a finding held against the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// `effect.symbol`.
    pub name: String,
    /// Which kind.
    pub kind: NumberKind,
    /// Distance from the truth in half widths of the interval as it was printed.
    pub distance: f64,
    /// Error beyond what its statistics explain, √(error² − statistics²), as a share of its size.
    pub beyond: f64,
}

/// Least and largest entry threshold [nats].
const ENTRY_NATS: (f64, f64) = (15.0, 80.0);
/// On top of the largest null seen.
const ENTRY_OVER: f64 = 1.3;
/// Nulls up to which a family shares the threshold of all.
const FEW_NULLS: f64 = 20.0;
/// Least and largest law error, as a share of a number's size.
const LAW_ERROR: (f64, f64) = (1e-3, 2.0);
/// Law error of what was hardly ever seen.
const UNSEEN: f64 = 0.1;
/// Numbers from which on a law error of their own begins to count as much as the common one.
const FEW_NUMBERS: f64 = 20.0;
/// Ridge of the logistic regression: weights are pulled to the prior with this many observations' weight.
const RIDGE: f64 = 0.3;
/// Weights that few observations fall back to.
const PRIOR: [f64; 4] = [0.0, 0.6, 0.1, -0.5];

/// Fits a calibration.
pub fn fit(seen: &[Observation]) -> Calibration {
    let named: Vec<(Evidence, bool)> = seen.iter().flat_map(|o| o.named.iter().copied()).collect();
    let unknown: Vec<bool> = seen.iter().flat_map(|o| o.unknown.iter().copied()).collect();
    let right = unknown.iter().filter(|u| **u).count() as f64;
    let numbers: Vec<&Number> = seen.iter().flat_map(|o| &o.numbers).collect();
    let (entry_default, entry) = entries(seen);
    Calibration {
        schema: SCHEMA.to_owned(),
        cases: seen.len(),
        named: regression(&named).map(|w| (w * 1e3).round() / 1e3),
        // Laplace's rule of succession.
        unknown: (right + 1.0) / (unknown.len() as f64 + 2.0),
        entry_default,
        intervals: intervals(&numbers),
        entry,
    }
}

/// Threshold of all families and of each.
fn entries(seen: &[Observation]) -> (f64, BTreeMap<String, f64>) {
    let mut nulls: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (key, gain) in seen.iter().flat_map(|o| &o.nulls) {
        nulls.entry(key).or_default().push(*gain);
    }
    let bounded = |v: f64| (v * ENTRY_OVER).clamp(ENTRY_NATS.0, ENTRY_NATS.1).round();
    // The 99 % point over all families; a family's own, as far as it has been seen often enough.
    let all: Vec<f64> = nulls.values().flatten().copied().collect();
    let common = if all.is_empty() { ENTRY_NATS.0 } else { stats::quantile(&all, 0.99).max(0.0) };
    let entry = nulls
        .into_iter()
        .map(|(key, own)| {
            let n = own.len() as f64;
            let top = stats::quantile(&own, 0.99).max(0.0);
            (key.to_owned(), bounded((n * top + FEW_NULLS * common) / (n + FEW_NULLS)))
        })
        .collect();
    (bounded(common), entry)
}

/// Logistic regression by Newton's method. Its weights keep their signs: more evidence never counts against.
fn regression(named: &[(Evidence, bool)]) -> [f64; 4] {
    let prior = SVector::<f64, 4>::from(PRIOR);
    let mut w = prior;
    for _ in 0..60 {
        let mut g = -(w - prior) * RIDGE;
        let mut h = SMatrix::<f64, 4, 4>::identity() * RIDGE;
        for (evidence, right) in named {
            let x = SVector::<f64, 4>::from(evidence.features());
            let p = logistic(w.as_slice(), x.as_slice());
            g += x * (f64::from(u8::from(*right)) - p);
            h += x * x.transpose() * (p * (1.0 - p));
        }
        let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
        w += step * (1.0 / step.norm().max(1.0));
        w[1] = w[1].max(0.0);
        w[2] = w[2].max(0.0);
        w[3] = w[3].min(0.0);
        if step.norm() < 1e-9 {
            break;
        }
    }
    [w[0], w[1], w[2], w[3]]
}

fn intervals(numbers: &[&Number]) -> Intervals {
    let point = |mut v: Vec<f64>, default: f64| -> f64 {
        let n = v.len() as f64;
        if n < 5.0 {
            return default;
        }
        // With n past errors the next one is within the ⌈0.95 (n + 1)⌉-th of them with 95 %.
        stats::quantile_in_place(&mut v, (0.95 * (n + 1.0) / n).min(1.0)).clamp(LAW_ERROR.0, LAW_ERROR.1)
    };
    let mut own: BTreeMap<&str, (NumberKind, Vec<f64>)> = BTreeMap::new();
    for n in numbers {
        own.entry(&n.name).or_insert((n.kind, Vec::new())).1.push(n.beyond);
    }
    own.retain(|_, (_, v)| v.len() >= 5);
    let points: BTreeMap<&str, (NumberKind, f64, f64)> =
        own.into_iter().map(|(name, (kind, v))| (name, (kind, v.len() as f64, point(v, UNSEEN)))).collect();
    // What was not seen often is taken for the middle one of those that were.
    let common = |kind: NumberKind| -> f64 {
        let of: Vec<f64> = points.values().filter(|p| p.0 == kind).map(|p| p.2).collect();
        if of.is_empty() { UNSEEN } else { stats::median(&of) }
    };
    let rounded = |f: f64| (f * 1e4).round() / 1e4;
    let [amplitude, shape, event] = [NumberKind::Amplitude, NumberKind::Shape, NumberKind::Event].map(common);
    let unlisted = Intervals { amplitude, shape, event, of: BTreeMap::new() };
    let own = |(name, (kind, n, point)): (&&str, &(NumberKind, f64, f64))| {
        // A few small errors do not promise that the next is small; a few large ones are large.
        let log = (n * point.ln() + FEW_NUMBERS * unlisted.common(*kind).ln()) / (n + FEW_NUMBERS);
        ((*name).to_owned(), rounded(log.exp().max(*point)))
    };
    let of = points.iter().map(own).collect();
    Intervals { amplitude: rounded(amplitude), shape: rounded(shape), event: rounded(event), of }
}

/// How well a calibration did on cases it was not made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Named effects.
    pub named: usize,
    /// Of them right.
    pub right: usize,
    /// Mean of the probabilities given.
    pub mean_probability: f64,
    /// Mean difference between probability and frequency over bins of probability, weighed by their cases.
    pub calibration_error: f64,
    /// Numbers.
    pub numbers: usize,
    /// Share of the 95 % intervals that hold the true number.
    pub coverage: f64,
    /// Largest gain of a candidate that is not missing over its family's threshold.
    pub largest_null: f64,
}

/// Measures a calibration on `seen`, whose diagnoses ran with it.
pub fn quality(calibration: &Calibration, seen: &[Observation]) -> Quality {
    let named: Vec<(f64, bool)> = seen
        .iter()
        .flat_map(|o| &o.named)
        .map(|(e, right)| (logistic(&calibration.named, &e.features()), *right))
        .collect();
    let count = named.len().max(1) as f64;
    let numbers: Vec<&Number> = seen.iter().flat_map(|o| &o.numbers).collect();
    let inside = numbers.iter().filter(|n| n.distance <= 1.0).count();
    let bins = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0 + 1e-9];
    let calibration_error = bins
        .windows(2)
        .map(|b| {
            let own: Vec<&(f64, bool)> = named.iter().filter(|(p, _)| (b[0]..b[1]).contains(p)).collect();
            let sum = own.iter().map(|(p, right)| p - f64::from(u8::from(*right))).sum::<f64>();
            sum.abs() / count
        })
        .sum();
    Quality {
        named: named.len(),
        right: named.iter().filter(|n| n.1).count(),
        mean_probability: named.iter().map(|n| n.0).sum::<f64>() / count,
        calibration_error,
        numbers: numbers.len(),
        coverage: inside as f64 / numbers.len().max(1) as f64,
        largest_null: seen
            .iter()
            .flat_map(|o| &o.nulls)
            .map(|(key, gain)| gain / calibration.entry_of(key).max(1.0))
            .fold(0.0, f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A generator of known truth: p(right) = 1 / (1 + e^−(0.5 ln(1 + nats) − 1)), errors of a normal law.
    fn draw(n: usize, shift: u64) -> Vec<Observation> {
        let mut state = 0x9E37_79B9_7F4A_7C15u64.wrapping_mul(shift + 1);
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..n)
            .map(|_| {
                let evidence = Evidence { nats: 3000.0f64.powf(unit()), margin: 0.0, left: 1.0 };
                let p = logistic(&[-1.0, 0.5], &[1.0, evidence.nats.ln_1p()]);
                let right = unit() < p;
                let normal = (-2.0 * unit().max(1e-12).ln()).sqrt() * (std::f64::consts::TAU * unit()).cos();
                // Statistics of 0.01 of the size, a law error of 0.03, both 95 %.
                let other = (-2.0 * unit().max(1e-12).ln()).sqrt() * (std::f64::consts::TAU * unit()).cos();
                let error = (0.01 * normal + 0.03 * other).abs() / 1.96;
                let (distance, beyond) = (error, (error * error - 1e-4).max(0.0).sqrt());
                let kind = NumberKind::Amplitude;
                Observation {
                    nulls: vec![("a".into(), 10.0 * unit()), ("b".into(), 40.0 * unit())],
                    named: vec![(evidence, right)],
                    unknown: Vec::new(),
                    numbers: vec![Number { name: "a.x".into(), kind, distance, beyond }],
                }
            })
            .collect()
    }

    #[test]
    fn probabilities_intervals_and_thresholds_are_those_of_the_generator() {
        let c = fit(&draw(2000, 0));
        let mut other = draw(2000, 1);
        for n in other.iter_mut().flat_map(|o| &mut o.numbers) {
            n.distance /= c.law_error("a", "x", n.kind).hypot(0.01);
        }
        let q = quality(&c, &other);
        assert!(q.calibration_error < 0.03, "{q:?}");
        assert!((q.mean_probability - q.right as f64 / q.named as f64).abs() < 0.03, "{q:?}");
        assert!((0.93..0.97).contains(&q.coverage), "{q:?}");
        assert!((c.intervals.amplitude - 0.03).abs() < 0.003, "{:?}", c.intervals);
        assert_eq!(c.entry_of("a"), 15.0);
        assert!((c.entry_of("b") - 52.0).abs() < 3.0, "{}", c.entry_of("b"));
    }

    #[test]
    fn nothing_seen_gives_a_file_that_can_be_used() {
        let c = fit(&[]);
        assert_eq!(Calibration::parse(&toml::to_string(&c).unwrap()).unwrap(), c);
    }
}
