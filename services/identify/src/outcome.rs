//! What an identification returns: the model, the machine-readable account of it, and the data of its report.

use crate::condition::Plan;
use crate::delay::DelayEstimate;
use crate::evaluate::Score;
use crate::fit::InstrumentCheck;
use crate::forward::Forward;
use crate::paper::PaperResult;
use crate::payload::PayloadRun;
use crate::split::TimeRange;
use lacuna_interfaces::{ModelFile, Repair};
use serde::Serialize;

/// Schema string of [`Identification`].
pub const SCHEMA: &str = "lacuna.identification/1";

/// A factor by which another parameter merges into one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Merged {
    /// The parameter that merges.
    pub symbol: String,
    /// Its factor: β = π + Σ factor · π_merged.
    pub factor: f64,
}

/// An identified parameter.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterRow {
    /// Symbol.
    pub symbol: String,
    /// What it is, in words.
    pub meaning: String,
    /// SI unit, or with the robot file's torque unit.
    pub unit: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Value that follows from the robot file, merged parameters included; absent for friction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal: Option<f64>,
    /// Value minus nominal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub departure: Option<f64>,
    /// Whether the departure is beyond its interval and the robot file's tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub departs: Option<bool>,
    /// Torque that it explains: root mean square of its column times its value over the training rows of the joint
    /// where it is largest [Nm].
    pub contribution_nm: f64,
    /// Parameters that only appear together with it.
    pub merged_with: Vec<Merged>,
}

/// A parameter that the data do not determine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NotExcited {
    /// Symbol.
    pub symbol: String,
    /// Why, in words, with the number that shows it.
    pub reason: String,
    /// The 95 % interval, where the data give one that includes zero; the value itself is not supported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// Whether the model file still has its fitted value (leaving it out would move the others), not the robot file's.
    pub in_model: bool,
}

/// Held-out error with its conditions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// The figures.
    #[serde(flatten)]
    pub score: Score,
    /// Whether standing joints were left out.
    pub moving_only: bool,
    /// Speed above which a joint counts as moving [rad/s].
    pub moving_rad_s: f64,
    /// Band in which torque and model are compared [Hz].
    pub band_hz: f64,
    /// How rows were held out: `files`, `recordings`, `halves` or `kfold=N`.
    pub split: String,
    /// Training ranges; with several folds, those of the whole.
    pub train: Vec<TimeRange>,
    /// Test ranges; with several folds, those of the whole.
    pub test: Vec<TimeRange>,
    /// Relative error of every fold.
    pub folds: Vec<f64>,
    /// Delay of the torque that was undone in every fold, as its training data alone have it [s].
    pub fold_delays_s: Vec<f64>,
    /// Relative error of the robot file's own model (no friction) on the same rows; absent if it has no masses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal_relative_error: Option<f64>,
    /// The same figure with standing joints fitted and counted; absent if nothing stands still.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_standstill: Option<f64>,
}

/// How well the data determine the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Conditions {
    /// Condition number of the robot's base columns at random motions.
    pub structure: f64,
    /// Of the weighted training rows, all base columns.
    pub data: f64,
    /// Of the columns that were fitted.
    pub fitted: f64,
    /// Whether the fit is by QR, because normal equations could not carry the columns.
    pub by_qr: bool,
}

/// What enforcing physical consistency cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Consistency {
    /// Held-out relative error of the free fit; the constrained one's is that of `held_out`.
    pub free_relative_error: f64,
    /// Weighted residual of the constrained fit over that of the free fit, on the training rows (root of the ratio of squares).
    pub training_residual_ratio: f64,
    /// Most that this ratio is above the best constrained fit's, by the course of the fit.
    pub ratio_gap: f64,
}

/// `identification.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identification {
    /// Must be [`SCHEMA`].
    pub schema: &'static str,
    /// Robot name.
    pub robot: String,
    /// Joint names.
    pub joints: Vec<String>,
    /// Unit of every torque in this file.
    pub torque_unit: String,
    /// `pooled` or `paper`.
    pub method: String,
    /// Error on data that the fit has not seen.
    pub held_out: HeldOut,
    /// Forward simulation on the held-out data; absent where no stretch is long enough or the torque is not the motor's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forward: Option<Forward>,
    /// Parameters that the data support.
    pub parameters: Vec<ParameterRow>,
    /// Parameters that they do not.
    pub not_excited: Vec<NotExcited>,
    /// Condition numbers.
    pub condition_numbers: Conditions,
    /// Residual standard deviation per joint over the fitted rows [Nm].
    pub noise_nm: Vec<f64>,
    /// Share of fitted rows with bounded influence, per joint.
    pub outlier_share: Vec<f64>,
    /// Rows fitted, per joint.
    pub rows: Vec<usize>,
    /// Blocks of time behind the intervals.
    pub blocks: usize,
    /// Delay between torque and position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay: Option<DelayEstimate>,
    /// Least squares against instruments, where they were made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instruments: Option<InstrumentCheck>,
    /// Movement over which Coulomb friction builds up after a reversal [rad], per joint; null: at once.
    pub bristle_rad: Vec<Option<f64>>,
    /// Filters and masks.
    pub conditioning: Plan,
    /// What enforcing physical consistency cost, if asked for. Intervals are those of the free fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub consistency: Option<Consistency>,
    /// The paper's tables, with `--method paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<PaperResult>,
    /// Payload of the recordings that were given with one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub payload: Vec<PayloadRun>,
    /// What readers and conditioning repaired.
    pub repairs: Vec<Repair>,
    /// What a user should know before trusting the model.
    pub warnings: Vec<String>,
}

/// A joint's curves for the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointCurves {
    /// Joint name.
    pub joint: String,
    /// Measured torque, filtered [Nm].
    pub measured_nm: Vec<f32>,
    /// Model torque, filtered [Nm]; held out where possible.
    pub model_nm: Vec<f32>,
    /// Torque of the robot file's own model, without friction [Nm]; empty if it has no masses.
    pub nominal_nm: Vec<f32>,
    /// Velocity [rad/s].
    pub qd_rad_s: Vec<f32>,
    /// Whether the point counts in the held-out error.
    pub counted: Vec<bool>,
    /// Mean residual over velocity: centre of the bin [rad/s].
    pub bin_qd_rad_s: Vec<f32>,
    /// Mean residual in the bin [Nm].
    pub bin_residual_nm: Vec<f32>,
    /// Standard deviation of the residual in the bin [Nm].
    pub bin_std_nm: Vec<f32>,
}

/// Curves over time; recordings follow each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportData {
    /// Unit of every torque.
    pub torque_unit: String,
    /// Time since the first recording's start, recordings strung together without their pauses [s].
    pub time_s: Vec<f64>,
    /// Time at which each recording starts in `time_s`, with its name.
    pub recordings: Vec<(f64, String)>,
    /// Whether the model curve at this time is held out (predicted by a fit that has not seen it).
    pub held_out: Vec<bool>,
    /// Per joint.
    pub joints: Vec<JointCurves>,
}

/// Everything.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// What the stages load.
    pub model: ModelFile,
    /// The account.
    pub identification: Identification,
    /// Curves for the report.
    pub report: ReportData,
}
