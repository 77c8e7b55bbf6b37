//! Fitted numbers against true ones.

use super::{Match, fits};
use crate::hidden::Hidden;
use crate::said::{Finding, Said};

/// One parameter with its 95 % interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Coverage {
    /// `effect.symbol`.
    pub what: String,
    /// Truth.
    pub truth: f64,
    /// Fitted value.
    pub value: f64,
    /// Interval.
    pub ci95: [f64; 2],
}

impl Coverage {
    /// The interval holds the truth.
    pub fn covers(&self) -> bool {
        self.ci95[0] <= self.truth && self.truth <= self.ci95[1]
    }

    /// Error over the true value.
    pub fn relative_error(&self) -> f64 {
        (self.value - self.truth).abs() / self.truth.abs()
    }
}

/// Integers that are found exactly or not at all: an interval means nothing.
const COUNTED: [&str; 1] = ["h"];

/// Parameters of findings that have the hidden effect's own id, on its joints, where both give the same symbol.
pub fn coverage(said: &Said, hidden: &Hidden) -> Vec<Coverage> {
    let mut list = Vec::new();
    for effect in &hidden.effects {
        let on = |f: &&Finding| effect.joints.is_empty() || effect.joints.iter().any(|j| f.joints.contains(j));
        for finding in said.named(&effect.id).filter(on) {
            for (symbol, &truth) in effect.parameters.iter().filter(|(s, _)| !COUNTED.contains(&s.as_str())) {
                // Two payloads in one finding: which is which is for `weighed` to say.
                if finding.parameters.iter().filter(|p| p.symbol == *symbol && p.joint.is_none()).count() > 1 {
                    continue;
                }
                let joint = effect.joints.first().map(String::as_str);
                let Some(found) = finding.parameter(symbol, joint) else { continue };
                if let (Some(value), Some([Some(low), Some(high)])) = (found.value, found.ci95) {
                    let what = format!("{}.{symbol}", effect.id);
                    list.push(Coverage { what, truth, value, ci95: [low, high] });
                }
            }
        }
    }
    list
}

/// A payload found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighed {
    /// (found − true) / true mass.
    pub mass_error: f64,
    /// Pick found minus true [s].
    pub pick_error_s: f64,
    /// Whether the 95 % interval holds the mass, where there is one.
    pub covered: Option<bool>,
}

/// Every payload that was carried and found: by the interval that begins nearest to the pick, in the same file.
pub fn weighed(said: &Said, hidden: &Hidden) -> Vec<Weighed> {
    let Some(effect) = hidden.effects.iter().find(|e| e.id == "payload") else { return Vec::new() };
    let findings = || said.findings.iter().filter(|f| f.effect == "payload" && fits(f, effect) == Match::Name);
    let mut list = Vec::new();
    for (file, on, _, mass) in &hidden.carried {
        let begins = findings().flat_map(|f| f.intervals_s.iter().map(move |i| (f, i)));
        let here = begins.filter(|(_, (name, _, _))| name == file);
        let nearest = here.min_by(|a, b| (a.1.1 - on).abs().total_cmp(&(b.1.1 - on).abs()));
        let Some((finding, (_, from, _))) = nearest else { continue };
        // One mass for all picks of a finding, or several: the one nearest to the truth would flatter, so the first.
        let Some(found) = finding.parameters.iter().find(|p| p.symbol == "m") else { continue };
        let Some(value) = found.value else { continue };
        let covered = match found.ci95 {
            Some([Some(low), Some(high)]) => Some(low <= *mass && *mass <= high),
            _ => None,
        };
        list.push(Weighed { mass_error: (value - mass) / mass, pick_error_s: from - on, covered });
    }
    list
}
