//! `findings.json`, schema `lacuna.findings/1`.

use lacuna_interfaces::Repair;
use serde::{Deserialize, Serialize};

/// Schema string of this version.
pub const SCHEMA: &str = "lacuna.findings/1";

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Findings {
    /// Always [`SCHEMA`].
    pub schema: String,
    /// Robot's name.
    pub robot: String,
    /// Recordings' file names.
    pub recordings: Vec<String>,
    /// Joint names.
    pub joints: Vec<String>,
    /// What the base leaves.
    pub baseline: Baseline,
    /// Whether and where something is missing.
    pub mismatch: Mismatch,
    /// What is missing, largest held-out gain first.
    pub findings: Vec<Finding>,
    /// Held-out errors of base and full model.
    pub held_out: HeldOut,
    /// What no named effect explains.
    pub unknown: Unknown,
    /// Candidates that were looked at and not taken.
    pub excluded: Vec<Excluded>,
    /// What the readers repaired.
    pub repairs: Vec<Repair>,
    /// What to record next, if explanations stay open.
    pub next_experiment: Option<NextExperiment>,
    /// One or two sentences.
    pub verdict: String,
}

/// What the base leaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Residual of rigid body, viscous and Coulomb friction per joint [Nm].
    pub rms_nm: Vec<f64>,
    /// Its norm over the torque's.
    pub relative_error: f64,
    /// What torque and encoder noise alone would leave [Nm].
    pub noise_floor_nm: Vec<f64>,
}

/// Whether and where something is missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mismatch {
    /// Whether anything is missing beyond noise and tolerances.
    pub detected: bool,
    /// Probability of as much evidence if nothing were missing.
    pub significance: f64,
    /// Where.
    pub r#where: Vec<Where>,
}

/// One place of mismatch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Where {
    /// Joint.
    pub joint: String,
    /// Its share of the mismatch.
    pub share: f64,
    /// Stage of the pipeline it belongs to.
    pub stage: String,
    /// Region in which it is largest.
    pub region: Vec<Region>,
    /// Time intervals in which it is largest: file, from, to [s].
    pub intervals_s: Vec<(String, f64, f64)>,
    /// Size there [Nm].
    pub rms_nm: f64,
}

/// Range of one variable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// `q_rad`, `qd_rad_s`, `qdd_rad_s2`, `load_nm`, `since_reversal_rad`, `temperature_degc`, `order_per_rev`.
    pub variable: String,
    /// From.
    pub low: f64,
    /// To.
    pub high: f64,
}

/// One missing effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Catalogue id, or `unknown`.
    pub effect: String,
    /// Joints it acts on.
    pub joints: Vec<String>,
    /// Probability that it or its group is there.
    pub probability: f64,
    /// `named`, `group` or `unknown`.
    pub status: String,
    /// Other explanations.
    pub alternatives: Vec<Alternative>,
    /// Ids that the data do not tell apart.
    pub group: Vec<String>,
    /// Law.
    pub equation: String,
    /// What a controls engineer would say.
    pub sentence: String,
    /// Fitted numbers.
    pub parameters: Vec<Parameter>,
    /// Its effect on held-out recordings.
    pub held_out: Reduction,
    /// Region of the motion in which it acts most, if it has one by its law.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub region: Vec<Region>,
    /// Its effect in that region.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub in_region: Option<Reduction>,
    /// Stage of the pipeline it belongs to.
    pub stage: String,
    /// Intervals in which it acts, if it comes and goes: file, from, to [s].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub intervals_s: Vec<(String, f64, f64)>,
}

/// Another explanation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// Catalogue id.
    pub effect: String,
    /// Probability.
    pub probability: f64,
}

/// A fitted number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Symbol.
    pub symbol: String,
    /// SI unit.
    pub unit: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Joint it belongs to, if the finding has several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
}

/// Held-out residual with and without a finding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reduction {
    /// Without it [Nm].
    pub before_rms_nm: f64,
    /// With it [Nm].
    pub after_rms_nm: f64,
    /// 1 − after/before.
    pub reduction: f64,
    /// 95 % interval of the reduction.
    pub ci95: [f64; 2],
}

/// Held-out errors of base and full model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Base, per joint [Nm].
    pub before_rms_nm: Vec<f64>,
    /// Full model, per joint [Nm].
    pub after_rms_nm: Vec<f64>,
    /// Base over the torque.
    pub relative_before: f64,
    /// Full model over the torque.
    pub relative_after: f64,
    /// A black box on top of the base over the torque, same folds.
    pub black_box_relative: f64,
    /// 95 % interval of each of `before_rms_nm`.
    #[serde(default)]
    pub before_ci95_nm: Vec<[f64; 2]>,
    /// 95 % interval of each of `after_rms_nm`.
    #[serde(default)]
    pub after_ci95_nm: Vec<[f64; 2]>,
    /// 95 % interval of `relative_after`.
    #[serde(default)]
    pub relative_after_ci95: [f64; 2],
    /// The black box, per joint [Nm].
    #[serde(default)]
    pub black_box_rms_nm: Vec<f64>,
    /// How rows were held out: `files` (test stretches), `recordings`, `halves`, `kfold=N`, or `parts` of time.
    #[serde(default)]
    pub split: String,
}

/// What no named effect explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unknown {
    /// Whether it is large enough to be a finding.
    pub flag: bool,
    /// Share of the full model's residual power that a black box explains.
    pub share: f64,
    /// Where.
    pub r#where: Option<Where>,
    /// Map of the unexplained torque over the variable that explains most of it.
    pub map: Option<Map>,
    /// Small expression, if one survives a fresh hold-out.
    pub expression: Option<String>,
}

/// Mean torque over a variable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// Joint.
    pub joint: String,
    /// Variable, as in [`Region`].
    pub variable: String,
    /// Centres of the bins.
    pub at: Vec<f64>,
    /// Mean unexplained torque [Nm], moving forwards.
    pub forward_nm: Vec<Option<f64>>,
    /// Mean unexplained torque [Nm], moving backwards.
    pub backward_nm: Vec<Option<f64>>,
}

/// A candidate that was not taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Excluded {
    /// Catalogue id.
    pub effect: String,
    /// Why not.
    pub reason: String,
}

/// What to record next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NextExperiment {
    /// Explanations it is to separate.
    pub separate: Vec<String>,
    /// What to do, in words.
    pub words: String,
}
