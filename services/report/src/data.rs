//! Input both reports share: plain structs, no dependence on how the numbers came about.
//!
//! All structs are serde types with defaults for every field, so that a caller fills what it has. Numbers
//! that do not exist are NaN (or `None`); they show as "–". In JSON serde writes NaN as `null`, which does
//! not read back as a number: keep NaN out of data that are to be stored.
//!
//! Torques are in the robot file's `torque_unit`, which may be A or V: a report never calls a current Nm.

use serde::{Deserialize, Serialize};

/// One recording with what was measured and what the models say, per joint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TorqueTrace {
    /// File name of the recording.
    pub recording: String,
    /// Time of each sample \[s\].
    pub t_s: Vec<f64>,
    /// One entry per joint.
    pub joints: Vec<JointTrace>,
}

/// One joint of a [`TorqueTrace`]; all vectors run along `t_s` (longer ones are cut, empty ones left out).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct JointTrace {
    /// Name of the joint.
    pub joint: String,
    /// Measured torque, in the torque unit.
    pub measured: Vec<f64>,
    /// Position \[rad, or m for a prismatic joint\].
    pub q_rad: Vec<f64>,
    /// Velocity \[rad/s, or m/s\].
    pub qd_rad_s: Vec<f64>,
    /// Further variables to show the residual over: named as regions name them (`temperature_c`,
    /// `since_reversal_rad`, `tau_nm` …).
    pub variables: Vec<NamedSeries>,
    /// Model torques, from the simplest to the best: the first is "before", the last "after".
    /// (A diagnosis report takes the second as "after" and the rest as beside it.)
    pub models: Vec<NamedSeries>,
}

/// A series with a name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NamedSeries {
    /// Name: of a model as the legend shows it ("M_Id+F"), of a variable with its unit suffix.
    pub name: String,
    /// One value per sample.
    pub values: Vec<f64>,
}

/// An identified parameter.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ParameterRow {
    /// Symbol in plain notation: `f_v`, `v_s`.
    pub symbol: String,
    /// Joint it belongs to; empty where it belongs to the robot.
    pub joint: String,
    /// What it is, in words; may be empty.
    pub meaning: String,
    /// Unit; empty for a pure number.
    pub unit: String,
    /// Estimate.
    pub value: f64,
    /// 95 % interval.
    pub ci95: Option<(f64, f64)>,
    /// Value of the robot file, where it states one.
    pub nominal: Option<f64>,
    /// Physical parameters that only occur together with this one in these signals.
    pub merged_with: Vec<String>,
}

/// A stretch of a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stretch {
    /// File name of the recording.
    pub recording: String,
    /// From \[s\]; `None` from the beginning.
    pub from_s: Option<f64>,
    /// To \[s\]; `None` to the end.
    pub to_s: Option<f64>,
}

/// Something that was repaired in a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RepairRow {
    /// File name of the recording.
    pub file: String,
    /// What: `spike`, `wrapped angle`, `corrupt row`.
    pub kind: String,
    /// How often.
    pub count: u64,
}

/// How the data were conditioned and divided.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Setup {
    /// What the models were fitted to.
    pub train: Vec<Stretch>,
    /// What they were judged on.
    pub test: Vec<Stretch>,
    /// Band of the zero-phase filter on torque and every regressor \[Hz\].
    pub band_hz: Option<f64>,
    /// Speed below which samples were left out of the judgement \[rad/s\]; `None`: all samples count.
    pub moving_rad_s: Option<f64>,
    /// Samples used.
    pub samples: Option<u64>,
    /// Further settings worth stating, as label and value.
    pub further: Vec<(String, String)>,
}
