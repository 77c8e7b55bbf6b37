//! From evidence to thresholds, probabilities and intervals.
//!
//! Evidence in nats of an incomplete model is no probability: residuals are not white, candidates are many, laws
//! are not quite those of the robot. `lacuna calibrate` diagnoses simulated robots whose truth is known and fits
//!
//! ```text
//! entry of a family     what the strongest wrong candidates of that family gain where nothing of it is missing
//! p(named effect right) = 1 / (1 + e^−(w·x)),  x = (1, ln(1 + nats), margin, ln left)
//! interval              √(statistics² + (share · size)²), so that 95 % of the true numbers lie inside
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | nats | held-out evidence that is lost without the effect | nat |
//! | margin | merit over the best other explanation, in tens of nats, 0 to [`MOST_MARGIN`] | |
//! | left | residual of the model over the noise, at the effect's joints, 1 to [`MOST_LEFT`] | |
//!
//! Platt 1999 (probabilities by logistic regression); Vovk, Gammerman, Shafer 2005 (quantiles of past errors).

pub mod cases;
pub mod fit;

use crate::findings::Alternative;
use crate::swap::Rivals;
use lacuna_interfaces::BadInput;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The file that is built in.
const BUILT_IN: &str = include_str!("../calibration.toml");
/// Schema of the file.
pub const SCHEMA: &str = "lacuna.calibration/1";
/// Largest margin that counts.
pub const MOST_MARGIN: f64 = 10.0;
/// Largest residual over noise that counts: simulated robots have hardly more, and what is left on a real one says less of
/// a single effect.
const MOST_LEFT: f64 = 5.0;

/// Size of parameter `i` of an instance, given as symbol, unit and value of all: amplitudes of one unit together, an angle
/// that is a place against [`PLACE_RAD`], all else by itself.
pub fn size(parameters: &[(&str, &str, f64)], i: usize, kind: NumberKind) -> f64 {
    let Some((symbol, unit, value)) = parameters.get(i) else { return 0.0 };
    match kind {
        NumberKind::Shape if *symbol == "q_0" => value.abs().max(PLACE_RAD),
        NumberKind::Shape => value.abs(),
        _ => parameters.iter().filter(|p| p.1 == *unit).map(|p| p.2 * p.2).sum::<f64>().sqrt(),
    }
}

/// Least size of an angle that says where something is [rad].
const PLACE_RAD: f64 = 0.3;

/// Which number of a finding an interval is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NumberKind {
    /// Enters linearly.
    Amplitude,
    /// Found by search.
    Shape,
    /// Of something that comes and goes.
    Event,
}

/// How far a number is off beyond what noise explains, as a share of its size: laws are not quite those of the robot,
/// and more recordings do not mend that.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intervals {
    /// Of amplitudes.
    pub amplitude: f64,
    /// Of shapes.
    pub shape: f64,
    /// Of events.
    pub event: f64,
    /// Of single numbers, `effect.symbol`, where there were enough cases.
    #[serde(default)]
    pub of: BTreeMap<String, f64>,
}

impl Intervals {
    /// That of a number that is not listed.
    fn common(&self, kind: NumberKind) -> f64 {
        match kind {
            NumberKind::Amplitude => self.amplitude,
            NumberKind::Shape => self.shape,
            NumberKind::Event => self.event,
        }
    }
}

/// What was measured on simulated robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// [`SCHEMA`].
    pub schema: String,
    /// Cases it was made from.
    pub cases: usize,
    /// Weights w of the probability that a named effect is there.
    pub named: [f64; 4],
    /// Probability that something is missing where "unknown" is said.
    pub unknown: f64,
    /// Entry threshold of a family that is not listed [nats].
    pub entry_default: f64,
    /// Factors on intervals.
    pub intervals: Intervals,
    /// Entry thresholds per family [nats].
    #[serde(default)]
    pub entry: BTreeMap<String, f64>,
}

/// What is known of a named effect beside its name.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Held-out evidence that is lost without it [nats].
    pub nats: f64,
    /// Merit over the best other explanation [nats].
    pub margin: f64,
    /// Residual over noise at its joints.
    pub left: f64,
}

impl Evidence {
    /// x of the logistic regression.
    pub fn features(&self) -> [f64; 4] {
        let margin = (self.margin / 10.0).clamp(0.0, MOST_MARGIN);
        [1.0, self.nats.max(0.0).ln_1p(), margin, self.left.clamp(1.0, MOST_LEFT).ln()]
    }
}

impl Calibration {
    /// Parses a calibration file.
    ///
    /// # Errors
    /// [`BadInput`] with the line, or for another schema or numbers that cannot be.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        let out: Self = toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))?;
        if out.schema != SCHEMA {
            return Err(BadInput::new(format!("schema: found \"{}\"; expected \"{SCHEMA}\"", out.schema)));
        }
        let of = &out.intervals;
        let mut shares = [of.amplitude, of.shape, of.event].into_iter().chain(of.of.values().copied());
        if !shares.all(|f| f.is_finite() && f > 0.0) {
            return Err(BadInput::new("intervals: found a share that is not positive; expected positive numbers"));
        }
        let mut entries = out.entry.values().copied().chain([out.entry_default]);
        if !entries.all(|e| e.is_finite() && e >= 0.0) {
            return Err(BadInput::new("entry: found a negative threshold; expected zero or more nats"));
        }
        if !(out.named.iter().all(|w| w.is_finite()) && (0.0..=1.0).contains(&out.unknown)) {
            return Err(BadInput::new("named, unknown: expected finite weights and a probability"));
        }
        Ok(out)
    }

    /// The calibration in the repository.
    ///
    /// # Errors
    /// [`BadInput`] if the built-in file was damaged before it was built in.
    pub fn built_in() -> Result<Self, BadInput> {
        Self::parse(BUILT_IN).map_err(|e| e.in_file("calibration.toml"))
    }

    /// Entry threshold of a family [nats].
    pub fn entry_of(&self, key: &str) -> f64 {
        self.entry.get(key).copied().unwrap_or(self.entry_default)
    }

    /// Error of a number that no noise explains, as a share of its size.
    pub fn law_error(&self, effect: &str, symbol: &str, kind: NumberKind) -> f64 {
        let own = self.intervals.of.get(&format!("{effect}.{symbol}")).copied();
        own.unwrap_or_else(|| self.intervals.common(kind))
    }

    /// Probability that an effect (or its group) is there, and those of its rivals.
    pub fn probability(
        &self,
        evidence: &Evidence,
        rivals: Option<&Rivals>,
        group: &[String],
    ) -> (f64, Vec<Alternative>) {
        let p = logistic(&self.named, &evidence.features());
        let Some(rivals) = rivals else { return (p, Vec::new()) };
        // Of what is not its probability, rivals have their share by merit; the rest is for anything else.
        let weight = |merit: f64| ((merit - rivals.merit) / RIVAL_NATS).min(0.0).exp();
        let others: Vec<(&str, f64)> = rivals
            .others
            .iter()
            .filter(|(o, merit)| *merit > 0.0 && !group.iter().any(|g| g == o))
            .map(|(o, merit)| (*o, weight(*merit)))
            .collect();
        let total = others.iter().map(|o| o.1).sum::<f64>().max(1.0);
        let share = |w: f64| (1.0 - p) * w / total;
        let alternatives = others
            .iter()
            .map(|(o, w)| Alternative { effect: (*o).to_owned(), probability: share(*w) })
            .filter(|a| a.probability > 1e-3)
            .collect();
        (p, alternatives)
    }
}

/// Difference of merit at which a rival has e times less of what is left [nats].
const RIVAL_NATS: f64 = 10.0;

/// 1 / (1 + e^−(w·x)).
pub fn logistic(w: &[f64], x: &[f64]) -> f64 {
    let z: f64 = w.iter().zip(x).map(|(w, x)| w * x).sum();
    1.0 / (1.0 + (-z).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_file_is_sound_and_says_how_it_was_made() {
        assert!(Calibration::built_in().is_ok());
        assert!(BUILT_IN.starts_with("# Made by `lacuna calibrate"), "the header says how it was made");
    }

    #[test]
    fn more_evidence_and_a_clearer_lead_make_an_effect_more_probable() {
        let c = Calibration::built_in().unwrap();
        let p = |nats, margin, left| c.probability(&Evidence { nats, margin, left }, None, &[]).0;
        assert!(p(500.0, 100.0, 1.0) >= p(30.0, 100.0, 1.0));
        assert!(p(100.0, 100.0, 1.0) >= p(100.0, 0.0, 1.0));
        assert!(p(100.0, 50.0, 1.0) >= p(100.0, 50.0, 8.0));
        assert!((0.0..=1.0).contains(&p(0.0, 0.0, 100.0)));
    }

    #[test]
    fn files_with_numbers_that_cannot_be_are_refused() {
        let text = toml::to_string(&Calibration::built_in().unwrap()).unwrap();
        assert!(Calibration::parse(&text).is_ok());
        for (from, to) in
            [("unknown = ", "unknown = 1"), ("entry_default = ", "entry_default = -"), ("shape = ", "shape = -")]
        {
            assert!(Calibration::parse(&text.replacen(from, to, 1)).is_err(), "{to}");
        }
        assert!(Calibration::parse(&text.replace("lacuna.calibration/1", "other")).is_err());
    }
}
