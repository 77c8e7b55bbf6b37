//! The payload of a recording under an identified model (the paper's section 5, Table 2 and Fig. 8), by the stages
//! themselves: what the graph would record, offline.
//!
//! ```text
//! ΔT = τ − τ_rigid − τ_friction = m_p Jᵀγ + e         recursive least squares, lacuna_payload
//! simulated torque: τ̃ = τ_rigid + τ_friction + m Jᵀγ   with m the mass carried, known or found: e = 0
//! ```
//!
//! The estimate from the simulated torque (lower half of the paper's Fig. 8) shows the estimator alone; what the one
//! from the measured torque has beyond it is the model's error.

mod intervals;

use crate::outcome::Outcome;
use crate::paper::ErrorTable;
use crate::replay::{LAG_S, replay};
use intervals::{Carrying, Series};
pub use intervals::{Interval, SETTLED, settling};
use lacuna_interfaces::{
    BadInput, FrictionTorque, Joints, PayloadEstimate, Repair, RobotFile, Stage, StageContext, flag,
};
use lacuna_payload::Payload;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A stretch of time with a payload that is known, e.g. from the gripper's log: `FROM:TO` or `FROM:TO:KG`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Known {
    /// Picked at [s], in the recording's own time.
    pub from_s: f64,
    /// Placed at [s].
    pub to_s: f64,
    /// Mass [kg], if known.
    pub mass_kg: Option<f64>,
}

impl std::str::FromStr for Known {
    type Err = BadInput;

    fn from_str(text: &str) -> Result<Self, BadInput> {
        let bad =
            || BadInput::new(format!("carried: found \"{text}\"; expected FROM:TO or FROM:TO:KG, as in 0.5:1.2:3.8"));
        let numbers: Vec<f64> =
            text.split(':').map(|n| n.trim().parse().map_err(|_| bad())).collect::<Result<_, _>>()?;
        let (from_s, to_s, mass_kg) = match numbers[..] {
            [from, to] => (from, to, None),
            [from, to, mass] => (from, to, Some(mass)),
            _ => return Err(bad()),
        };
        let heavy = mass_kg.is_none_or(|m| m.is_finite() && m > 0.0);
        if from_s.is_finite() && to_s.is_finite() && from_s < to_s && heavy {
            Ok(Self { from_s, to_s, mass_kg })
        } else {
            Err(BadInput::new(format!("carried: found \"{text}\"; expected FROM before TO, and a mass above zero")))
        }
    }
}

/// What a user may choose.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// How much future a smoothed sample may use [s].
    pub lag_s: f64,
    /// Samples of a joint count in the table of errors above this speed [rad/s].
    pub moving_rad_s: f64,
    /// The estimator.
    pub estimator: lacuna_payload::Config,
    /// When a payload is known to be carried; empty: found from the estimate.
    pub known: Vec<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self { lag_s: LAG_S, moving_rad_s: 0.05, estimator: Default::default(), known: Vec::new() }
    }
}

/// The estimate over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Time, in the recording's own [s].
    pub t_s: Vec<f64>,
    /// m̂_p [kg]; NaN where the motion does not support it.
    pub mass_kg: Vec<f64>,
}

/// Mass carried over a stretch of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// From [s].
    pub from_s: f64,
    /// Mass [kg].
    pub mass_kg: f64,
}

/// The payload of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PayloadRun {
    /// File name.
    pub file: String,
    /// Length of the recording [s].
    pub duration_s: f64,
    /// Smallest mass that this recording's torque shows [kg]: 3 % of the mass that would ask for as much torque as was
    /// measured.
    pub noticeable_kg: f64,
    /// Share of the time in which the motion supports the estimate.
    pub supported_share: f64,
    /// What was carried when, from the measured torque.
    pub measured: Vec<Interval>,
    /// The same from the simulated torque.
    pub simulated: Vec<Interval>,
    /// Torque error with m_p = 0 and with the estimate, moving samples: the paper's Table 2.
    pub table2: Vec<ErrorTable>,
    /// What the reader repaired.
    pub repairs: Vec<Repair>,
    /// The sums behind `table2`.
    #[serde(skip)]
    pub moments: [Moments; 2],
    /// The estimate from the measured torque.
    #[serde(skip)]
    pub trace: Trace,
    /// And from the simulated torque.
    #[serde(skip)]
    pub simulated_trace: Trace,
    /// Mass carried, known or found, as steps.
    #[serde(skip)]
    pub carried: Vec<Step>,
}

/// μ and σ of an error over the moving samples of each joint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    /// Samples, sum, sum of squares.
    joints: Vec<[f64; 3]>,
}

impl Moments {
    /// Of `joints` joints.
    pub fn new(joints: usize) -> Self {
        Self { joints: vec![[0.0; 3]; joints] }
    }

    /// Adds one error of one joint.
    pub fn add(&mut self, joint: usize, error: f64) {
        if let Some([count, sum, squares]) = self.joints.get_mut(joint) {
            *count += 1.0;
            *sum += error;
            *squares += error * error;
        }
    }

    /// Adds the errors of another recording.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.joints.iter_mut().zip(&other.joints) {
            mine.iter_mut().zip(theirs).for_each(|(a, b)| *a += b);
        }
    }

    /// As a column of the paper's tables.
    pub fn table(&self, model: &str) -> ErrorTable {
        let mean = |[n, sum, _]: &[f64; 3]| sum / n.max(1.0);
        let std = |j: &[f64; 3]| (j[2] / j[0].max(1.0) - mean(j).powi(2)).max(0.0).sqrt();
        ErrorTable {
            model: model.to_owned(),
            mean_nm: self.joints.iter().map(mean).collect(),
            std_nm: self.joints.iter().map(std).collect(),
        }
    }
}

/// Names of the columns of Table 2.
const TABLE_2: [&str; 2] = ["M_Id+F, m_p = 0", "M_Id+F, m_p = m̂_p"];

/// The paper's Table 2: the error with m_p = 0 and with the estimate.
pub fn table_2(moments: &[Moments; 2]) -> Vec<ErrorTable> {
    moments.iter().zip(TABLE_2).map(|(m, name)| m.table(name)).collect()
}

/// Estimates the payload of every recording with the model of an identification, and adds it to its account, with the
/// paper's Table 2 over all of them.
///
/// # Errors
/// As [`payload`]; known times with more than one recording.
pub fn add_to(
    outcome: &mut Outcome,
    robot: &RobotFile,
    urdf: Option<&str>,
    recordings: &[PathBuf],
    options: &Options,
) -> Result<(), BadInput> {
    check_known(recordings.len(), options)?;
    let context = StageContext { robot, urdf, model: Some(&outcome.model) };
    let runs: Vec<PayloadRun> =
        recordings.iter().map(|path| payload(path, &context, options)).collect::<Result<_, _>>()?;
    let id = &mut outcome.identification;
    if let (Some(paper), Some(first)) = (&mut id.paper, runs.first()) {
        let mut sums = first.moments.clone();
        for run in &runs[1..] {
            sums.iter_mut().zip(&run.moments).for_each(|(s, m)| s.merge(m));
        }
        paper.table2 = table_2(&sums);
    }
    id.warnings.extend(runs.iter().flat_map(warnings));
    id.payload = runs;
    Ok(())
}

/// Known times belong to one recording.
///
/// # Errors
/// If there are several.
pub fn check_known(recordings: usize, options: &Options) -> Result<(), BadInput> {
    if options.known.is_empty() || recordings == 1 {
        return Ok(());
    }
    Err(BadInput::new(format!("carried: found times for {recordings} recordings; expected one recording with them")))
}

/// Estimates the payload of the recording at `path` with the model of `context`.
///
/// # Errors
/// [`BadInput`] with file and line where the recording cannot be read, or if robot, model and options do not fit.
pub fn payload(path: &Path, context: &StageContext<'_>, options: &Options) -> Result<PayloadRun, BadInput> {
    let joints = context.robot.joint_count();
    let mut tables = [Moments::new(joints), Moments::new(joints)];
    let (mut torque_squared, mut column_squared) = (0.0, 0.0);
    let mut series = Series::default();
    let mut estimator = Payload::new(options.estimator, context)?;
    let repairs = replay(path, context, options.lag_s, &mut |sample| {
        let moving = |j: usize| sample.qd_rad_s[j].abs() > options.moving_rad_s;
        for j in (0..joints).filter(|&j| moving(j)) {
            torque_squared += sample.tau_nm[j].powi(2);
            column_squared += sample.payload_column_nm_kg[j].powi(2);
        }
        estimator.step(sample, &mut |o| {
            series.push(o, says(sample, o, joints, options.moving_rad_s));
            for j in (0..joints).filter(|&j| moving(j)) {
                tables[0].add(j, o.residual_nm[j]);
                tables[1].add(j, o.residual_payload_nm[j]);
            }
        });
    })?;
    let noticeable_kg = if column_squared > 0.0 { NOTICEABLE * (torque_squared / column_squared).sqrt() } else { 0.0 };
    let carrying = if options.known.is_empty() {
        intervals::find(&series, noticeable_kg)
    } else {
        intervals::known(&series, &options.known)
    };
    let simulated = simulated(path, context, options, &carrying)?;
    let supported = series.supported.iter().filter(|s| **s).count();
    Ok(PayloadRun {
        file: path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        duration_s: series.duration_s(),
        noticeable_kg,
        supported_share: supported as f64 / series.t_s.len().max(1) as f64,
        measured: intervals::judge(&series, &carrying),
        simulated: intervals::judge(&simulated, &carrying),
        table2: table_2(&tables),
        repairs,
        moments: tables,
        carried: steps(&carrying, series.t_s.first().copied().unwrap_or(0.0)),
        trace: series.trace(),
        simulated_trace: simulated.trace(),
    })
}

/// Share of the mass that would ask for the torque measured, below which a mass does not show: as the estimator's own.
const NOTICEABLE: f64 = 0.03;

/// The estimate from the torque that the model has with the carried mass.
fn simulated(
    path: &Path,
    context: &StageContext<'_>,
    options: &Options,
    carrying: &[Carrying],
) -> Result<Series, BadInput> {
    let mut series = Series::default();
    let mut estimator = Payload::new(options.estimator, context)?;
    replay(path, context, options.lag_s, &mut |sample| {
        let mass = mass_at(carrying, sample.header.stamp_ns as f64 * 1e-9);
        let ideal = FrictionTorque { tau_nm: model_torque(sample, mass), ..*sample };
        estimator.step(&ideal, &mut |o| series.push(o, [0.0; 2]));
    })?;
    Ok(series)
}

/// Σ φ ΔT and Σ φ² over the moving joints of a sample that can be relied on.
fn says(sample: &FrictionTorque, o: &PayloadEstimate, joints: usize, moving_rad_s: f64) -> [f64; 2] {
    if o.header.flags & (flag::DRIVE_OFF | flag::UNREACHABLE | flag::SHORT_LAG) != 0 {
        return [0.0; 2];
    }
    let mut sums = [0.0; 2];
    for j in (0..joints).filter(|&j| sample.qd_rad_s[j].abs() > moving_rad_s) {
        let column = sample.payload_column_nm_kg[j];
        sums[0] += column * o.residual_nm[j];
        sums[1] += column * column;
    }
    sums
}

fn model_torque(sample: &FrictionTorque, mass_kg: f64) -> Joints {
    std::array::from_fn(|j| {
        sample.tau_rigid_nm[j] + sample.tau_friction_nm[j] + mass_kg * sample.payload_column_nm_kg[j]
    })
}

fn mass_at(carrying: &[Carrying], t_s: f64) -> f64 {
    carrying.iter().find(|c| c.from_s <= t_s && c.to_s.is_none_or(|to| t_s < to)).map_or(0.0, |c| c.mass_kg)
}

fn steps(carrying: &[Carrying], start_s: f64) -> Vec<Step> {
    let mut out = vec![Step { from_s: start_s, mass_kg: 0.0 }];
    for c in carrying {
        out.push(Step { from_s: c.from_s, mass_kg: c.mass_kg });
        out.extend(c.to_s.map(|to| Step { from_s: to, mass_kg: 0.0 }));
    }
    out
}

/// What a user should know before trusting the masses.
pub fn warnings(run: &PayloadRun) -> Vec<String> {
    let mut out = Vec::new();
    let file = &run.file;
    if run.supported_share < 0.5 {
        out.push(format!(
            "{file}: the motion supports an estimate of the payload in {:.0} % of the time only: elsewhere the joints stand, reverse or are not loaded by it",
            100.0 * run.supported_share
        ));
    }
    if run.measured.is_empty() {
        out.push(format!(
            "{file}: no payload found; masses below {:.2} kg do not show in this recording's torque",
            run.noticeable_kg
        ));
    }
    let [empty, carried] = &run.table2[..] else { return out };
    let worse = |j: usize| carried.std_nm[j] > 1.02 * empty.std_nm[j];
    let joints: Vec<String> = (0..empty.std_nm.len()).filter(|&j| worse(j)).map(|j| (j + 1).to_string()).collect();
    if !joints.is_empty() {
        out.push(format!(
            "{file}: with the payload the torque error of joint {} is larger than without: the model lacks something else",
            joints.join(", ")
        ));
    }
    out
}

impl Series {
    fn push(&mut self, o: &PayloadEstimate, says: [f64; 2]) {
        self.says.push(says);
        self.t_s.push(o.header.stamp_ns as f64 * 1e-9);
        self.mass_kg.push(o.mass_kg);
        self.sd_kg.push(o.sd_mass_kg);
        self.supported.push(o.header.flags & flag::NOT_EXCITED == 0);
        self.step.push(o.header.has(flag::PAYLOAD_STEP));
    }
}
