//! `findings.json` as an outside program reads it: the keys of schema `lacuna.findings/1` that a judge needs,
//! nothing of how they came about. Unknown keys are passed over, so that the diagnosis may say more.

use lacuna_interfaces::BadInput;
use lacuna_recording::files::read_text;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Schema that is understood.
pub const SCHEMA: &str = "lacuna.findings/1";

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Must be [`SCHEMA`].
    pub schema: String,
    /// Joint names.
    pub joints: Vec<String>,
    /// What the base model leaves.
    pub baseline: Baseline,
    /// Whether anything is missing.
    pub mismatch: Mismatch,
    /// What is missing, largest gain first.
    pub findings: Vec<Finding>,
    /// Errors on data that was held out.
    pub held_out: HeldOut,
    /// What no named effect explains.
    #[serde(default)]
    pub unknown: Unknown,
    /// Candidates that were looked at and not taken.
    #[serde(default)]
    pub excluded: Vec<Excluded>,
    /// One or two sentences.
    pub verdict: String,
}

/// A candidate that was not taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Excluded {
    /// Catalogue id.
    pub effect: String,
    /// Why not.
    pub reason: String,
}

/// What the base model leaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Per joint [Nm].
    pub rms_nm: Vec<f64>,
}

/// Whether anything is missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mismatch {
    /// Beyond noise and tolerances.
    pub detected: bool,
}

/// One missing effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Catalogue id, or `unknown`.
    pub effect: String,
    /// Joints.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Probability that it or its group is there.
    pub probability: Option<f64>,
    /// Ids that the data do not tell apart.
    #[serde(default)]
    pub group: Vec<String>,
    /// Fitted numbers.
    #[serde(default)]
    pub parameters: Vec<Parameter>,
    /// Its effect on held-out data.
    pub held_out: Option<Reduction>,
    /// Intervals in which it acts: file, from, to [s].
    #[serde(default)]
    pub intervals_s: Vec<(String, f64, f64)>,
    /// What a controls engineer would say.
    #[serde(default)]
    pub sentence: String,
}

/// A fitted number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Symbol.
    pub symbol: String,
    /// Unit.
    #[serde(default)]
    pub unit: String,
    /// Value.
    pub value: Option<f64>,
    /// 95 % interval.
    #[serde(default)]
    pub ci95: Option<[Option<f64>; 2]>,
    /// Joint it belongs to, if the finding has several.
    #[serde(default)]
    pub joint: Option<String>,
}

/// Held-out residual with and without a finding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reduction {
    /// Without it [Nm].
    pub before_rms_nm: Option<f64>,
    /// With it [Nm].
    pub after_rms_nm: Option<f64>,
    /// 1 − after/before.
    pub reduction: Option<f64>,
}

/// Errors on data that was held out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldOut {
    /// Base per joint [Nm].
    #[serde(default)]
    pub before_rms_nm: Vec<f64>,
    /// Full model per joint [Nm].
    #[serde(default)]
    pub after_rms_nm: Vec<f64>,
    /// Base over the torque.
    pub relative_before: Option<f64>,
    /// Full model over the torque.
    pub relative_after: Option<f64>,
    /// A black box over the torque, same folds.
    pub black_box_relative: Option<f64>,
}

/// What no named effect explains.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Unknown {
    /// Large enough to be a finding.
    #[serde(default)]
    pub flag: bool,
    /// Share of the residual's power that a black box explains.
    #[serde(default)]
    pub share: Option<f64>,
}

/// Share of the residual from which on an unexplained rest counts as said, flagged or not.
const SHARE_SAID: f64 = 0.4;

impl Said {
    /// Reads a findings file.
    ///
    /// # Errors
    /// [`BadInput`] if it is absent or not of this schema.
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        Self::parse(&read_text(path)?).map_err(|e| e.in_file(path))
    }

    /// Parses findings.
    ///
    /// # Errors
    /// [`BadInput`] with the key.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        let said: Self =
            serde_json::from_str(text).map_err(|e| BadInput::new(e.to_string()).at_line(e.line() as u64))?;
        if said.schema != SCHEMA {
            return Err(BadInput::new(format!("schema: found \"{}\"; expected \"{SCHEMA}\"", said.schema)));
        }
        Ok(said)
    }

    /// Whether it says that something outside the catalogue is there.
    pub fn says_unknown(&self) -> bool {
        self.findings.iter().any(Finding::is_unknown)
            || self.unknown.flag
            || self.unknown.share.is_some_and(|s| s > SHARE_SAID)
    }

    /// The findings with this id.
    pub fn named<'a>(&'a self, effect: &'a str) -> impl Iterator<Item = &'a Finding> {
        self.findings.iter().filter(move |f| f.effect == effect)
    }
}

impl Finding {
    /// True for "none of the catalogue".
    pub fn is_unknown(&self) -> bool {
        self.effect == "unknown"
    }

    /// The parameter `symbol` of `joint`; of a finding on one joint, whatever that is called.
    pub fn parameter(&self, symbol: &str, joint: Option<&str>) -> Option<&Parameter> {
        let single = self.joints.len() <= 1;
        self.parameters
            .iter()
            .find(|p| p.symbol == symbol && (single || p.joint.is_none() || p.joint.as_deref() == joint))
    }

    /// Effect and joints in a line.
    pub fn words(&self) -> String {
        let joints = if self.joints.is_empty() { String::new() } else { format!(" ({})", self.joints.join(", ")) };
        let p = self.probability.map_or_else(String::new, |p| format!(" {p:.2}"));
        format!("{}{joints}{p}", self.effect)
    }
}
