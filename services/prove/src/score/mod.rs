//! Findings held against answers.
//!
//! [`judge`] judges one case; [`Score`] adds cases up. Who says what an effect is called is the answer alone: an id
//! is right if it is the hidden one or one that the answer accepts as equal; a *group* is right if it holds the
//! hidden id.

mod calibration;
mod held_out;
mod intervals;
mod tables;

pub use calibration::Reliability;
pub use held_out::Improvement;
pub use intervals::{Coverage, Weighed};
pub use tables::section;

use crate::diagnosis::Answered;
use crate::hidden::{Effect, Hidden};
use crate::said::{Finding, Said};

/// How well one finding fits one hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Match {
    /// Not at all.
    No,
    /// The finding names a group, and the hidden effect is in it.
    Group,
    /// By its name, or by one that the answer accepts.
    Name,
}

/// Fit of a finding to a hidden effect.
pub fn fits(finding: &Finding, effect: &Effect) -> Match {
    let right = finding.effect == effect.id
        || effect.also_accept.contains(&finding.effect)
        || (effect.unknown && finding.is_unknown());
    if right {
        Match::Name
    } else if finding.group.contains(&effect.id) {
        Match::Group
    } else {
        Match::No
    }
}

/// What happened to one hidden effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Fate {
    /// Id.
    pub id: String,
    /// Outside the catalogue.
    pub unknown: bool,
    /// Share of the residual, if known.
    pub share: Option<f64>,
    /// Best fit of all findings.
    pub fit: Match,
    /// Whether a fitting finding acts on all its joints (effects of the whole robot: always).
    pub joints: bool,
}

/// One case, judged.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// Name.
    pub name: String,
    /// Why there are no findings, if there are none.
    pub error: Option<String>,
    /// Hidden effects.
    pub fates: Vec<Fate>,
    /// Fit of the first finding to the hidden effect it fits best.
    pub first: Match,
    /// Findings: probability, and whether name or group is right. Friction that every robot has is left out.
    pub findings: Vec<Said1>,
    /// Something beyond noise was detected.
    pub detected: bool,
    /// It says that something is outside the catalogue.
    pub unknown: bool,
    /// Held-out errors against the oracle's.
    pub improvement: Option<Improvement>,
    /// Black box: error of the named model and of the box, relative to the torque.
    pub black_box: Option<(f64, f64)>,
    /// Parameters with their intervals against the truth.
    pub coverage: Vec<Coverage>,
    /// Payloads.
    pub weighed: Vec<Weighed>,
    /// Wall time [s].
    pub seconds: f64,
    /// Answer and findings in a line.
    pub line: String,
}

/// A finding as a judge sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Said1 {
    /// Its probability.
    pub probability: Option<f64>,
    /// Whether it names something hidden, or a group that holds it.
    pub right: bool,
    /// It says "unknown".
    pub unknown: bool,
}

/// What every robot has: no finding unless the robot is without.
const BASE: [&str; 2] = ["coulomb", "viscous"];

/// Judges a case.
pub fn judge(name: &str, hidden: &Hidden, answered: &Answered) -> Judged {
    let said = match &answered.said {
        Ok(said) => said,
        Err(why) => return unanswered(name, hidden, why, answered.seconds),
    };
    let counted: Vec<&Finding> =
        said.findings.iter().filter(|f| hidden.frictionless || !BASE.contains(&f.effect.as_str())).collect();
    let unknown = said.says_unknown();
    let fates = hidden.effects.iter().enumerate().map(|(k, e)| fate(e, hidden.share(k), &counted, unknown)).collect();
    let best = |f: &Finding| hidden.effects.iter().map(|e| fits(f, e)).max().unwrap_or(Match::No);
    let findings = counted.iter().map(|f| Said1 {
        probability: f.probability,
        right: best(f) != Match::No,
        unknown: f.is_unknown(),
    });
    let held = &said.held_out;
    Judged {
        name: name.to_owned(),
        error: None,
        fates,
        first: counted.first().map_or(Match::No, |f| best(f)),
        findings: findings.collect(),
        detected: said.mismatch.detected,
        unknown,
        improvement: Improvement::of(said, hidden),
        black_box: held.relative_after.zip(held.black_box_relative),
        coverage: intervals::coverage(said, hidden),
        weighed: intervals::weighed(said, hidden),
        seconds: answered.seconds,
        line: line(hidden, said, &counted),
    }
}

fn unanswered(name: &str, hidden: &Hidden, why: &str, seconds: f64) -> Judged {
    Judged {
        name: name.to_owned(),
        error: Some(why.to_owned()),
        fates: hidden.effects.iter().enumerate().map(|(k, e)| fate(e, hidden.share(k), &[], false)).collect(),
        first: Match::No,
        findings: Vec::new(),
        detected: false,
        unknown: false,
        improvement: None,
        black_box: None,
        coverage: Vec::new(),
        weighed: Vec::new(),
        seconds,
        line: format!("hidden {}; no findings: {why}", hidden_words(hidden)),
    }
}

fn fate(effect: &Effect, share: Option<f64>, findings: &[&Finding], says_unknown: bool) -> Fate {
    let mut fit = findings.iter().map(|f| fits(f, effect)).max().unwrap_or(Match::No);
    if effect.unknown && says_unknown {
        fit = Match::Name;
    }
    let fitting = || findings.iter().filter(|f| fits(f, effect) != Match::No);
    let on = |joint: &String| fitting().any(|f| f.joints.is_empty() || f.joints.contains(joint));
    let joints = fit != Match::No && (effect.unknown || effect.joints.iter().all(on));
    Fate { id: effect.id.clone(), unknown: effect.unknown, share, fit, joints }
}

fn hidden_words(hidden: &Hidden) -> String {
    let effect = |(k, e): (usize, &Effect)| {
        let joints = if e.joints.is_empty() { String::new() } else { format!(" ({})", e.joints.join(", ")) };
        let share = hidden.share(k).map_or_else(String::new, |s| format!(" {:.0} %", 100.0 * s));
        format!("{}{joints}{share}", e.id)
    };
    let list: Vec<String> = hidden.effects.iter().enumerate().map(effect).collect();
    if list.is_empty() { "nothing".to_owned() } else { list.join(", ") }
}

fn line(hidden: &Hidden, said: &Said, counted: &[&Finding]) -> String {
    let found: Vec<String> = counted.iter().map(|f| f.words()).collect();
    let flag = if said.says_unknown() && !counted.iter().any(|f| f.is_unknown()) { ", rest unexplained" } else { "" };
    let found = if found.is_empty() { "nothing".to_owned() } else { found.join(", ") };
    format!("hidden {}; found {found}{flag}", hidden_words(hidden))
}

impl Judged {
    /// Nothing was hidden.
    pub fn clean(&self) -> bool {
        self.fates.is_empty()
    }

    /// Everything hidden is named, or in a named group, and nothing else is.
    pub fn perfect(&self) -> bool {
        let hidden_unknown = self.fates.iter().any(|f| f.unknown);
        self.error.is_none()
            && self.fates.iter().all(|f| f.fit != Match::No)
            && self.findings.iter().all(|f| f.right)
            && (!self.unknown || hidden_unknown)
    }

    /// Findings that name what is not there.
    pub fn wrong(&self) -> usize {
        self.findings.iter().filter(|f| !f.right && !f.unknown).count()
    }
}

#[cfg(test)]
mod tests;
