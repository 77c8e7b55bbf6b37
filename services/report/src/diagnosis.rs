//! The diagnosis report: which physics the model leaves out, where, how sure, and what it is worth.

mod evidence;
mod findings;

use crate::blocks::{Block, Figure, HeatMap, Report, Section, Tone};
use crate::chart::Axis;
use crate::common::{repairs_blocks, setup_facts, torque_unit};
use crate::data::{NamedSeries, ParameterRow, RepairRow, Setup, TorqueTrace};
use crate::number::{percent, significant};
use serde::{Deserialize, Serialize};

/// All a diagnosis report shows. Empty fields leave their part out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DiagnosisReportData {
    /// Name of the robot.
    pub robot: String,
    /// Unit of all torques: "Nm", "A" or "V"; empty means Nm.
    pub torque_unit: String,
    /// One or two sentences a controls engineer would say.
    pub verdict: String,
    /// Whether there is a mismatch beyond noise.
    pub detected: bool,
    /// Probability of a mismatch this large on a clean recording.
    pub significance: Option<f64>,
    /// Data, split, band.
    pub setup: Setup,
    /// Where the mismatch is, per joint.
    pub located: Vec<Located>,
    /// Findings, by held-out gain.
    pub findings: Vec<Finding>,
    /// Held-out error per joint before and after all findings.
    pub held_out: Vec<BeforeAfterRow>,
    /// What the held-out rows are, to complete "Relative torque error, all joints, …": "on recordings used neither to
    /// select nor to fit". Empty: "held out".
    pub held_out_words: String,
    /// Pooled relative error before.
    pub relative_before: Option<f64>,
    /// Pooled relative error after.
    pub relative_after: Option<f64>,
    /// 95 % interval of `relative_after`.
    pub relative_after_ci95: Option<(f64, f64)>,
    /// Pooled relative error of the black box on the same folds and inputs.
    pub black_box_relative: Option<f64>,
    /// What the black box is: "gradient boosting, 200 trees".
    pub black_box: String,
    /// Pooled relative error that noise alone would leave, where known.
    pub noise_relative: Option<f64>,
    /// Forward simulation with the terms off and on, per joint.
    pub forward: Vec<ForwardRow>,
    /// How the forward simulation was made, in words.
    pub forward_words: String,
    /// Recordings, held-out ones first. Per joint, model 0 is before, 1 is after, 2 the black box (optional),
    /// others beside them.
    pub traces: Vec<TorqueTrace>,
    /// What remains unexplained.
    pub unknown: Option<Unknown>,
    /// Effects that were tested and left out.
    pub excluded: Vec<Excluded>,
    /// The experiment that would decide what is open.
    pub next_experiment: Option<NextExperiment>,
    /// Warnings in words.
    pub warnings: Vec<String>,
    /// What was repaired in the recordings.
    pub repairs: Vec<RepairRow>,
}

/// Where the mismatch of one joint is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Located {
    /// Joint.
    pub joint: String,
    /// Its share of the whole mismatch, 0 to 1.
    pub share: f64,
    /// Size (RMS), in the torque unit.
    pub size: Option<f64>,
    /// Stage of the pipeline it belongs to.
    pub stage: String,
    /// Where in the joint's motion.
    pub regions: Vec<Region>,
    /// When.
    pub intervals: Vec<TimeInterval>,
}

/// A range of a variable.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Region {
    /// Variable with unit suffix, as in findings.json: `qd_rad_s`, `q_rad`, `tau_nm`, `temperature_c` …
    pub variable: String,
    /// Low edge.
    pub low: f64,
    /// High edge.
    pub high: f64,
}

/// A stretch of time in a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimeInterval {
    /// File name of the recording.
    pub recording: String,
    /// From \[s\].
    pub from_s: f64,
    /// To \[s\].
    pub to_s: f64,
}

/// A named (or unknown) piece of missing physics.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Finding {
    /// Id of the effect in the catalogue.
    pub effect: String,
    /// Its name in words: "Stribeck friction"; empty: the id.
    pub title: String,
    /// Joints it acts on.
    pub joints: Vec<String>,
    /// Probability of this name.
    pub probability: Option<f64>,
    /// `named`, `group` or `unknown`.
    pub status: String,
    /// What a controls engineer would say.
    pub sentence: String,
    /// Law in plain notation.
    pub equation: String,
    /// Effects these signals cannot tell apart from it.
    pub group: Vec<String>,
    /// Other names and their probabilities.
    pub alternatives: Vec<(String, f64)>,
    /// Parameters with intervals.
    pub parameters: Vec<ParameterRow>,
    /// Held-out gain.
    pub held_out: Option<Gain>,
    /// Where in the motion it acts.
    pub regions: Vec<Region>,
    /// When it acts.
    pub intervals: Vec<TimeInterval>,
}

/// What a finding is worth on data that were used neither to select nor to fit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gain {
    /// RMS before, in the torque unit.
    pub before_rms: f64,
    /// RMS after.
    pub after_rms: f64,
    /// Share of the residual removed.
    pub reduction: f64,
    /// 95 % interval of the reduction.
    pub ci95: Option<(f64, f64)>,
}

/// Held-out error of one joint, in the torque unit.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BeforeAfterRow {
    /// Joint.
    pub joint: String,
    /// RMS before.
    pub before_rms: f64,
    /// RMS after.
    pub after_rms: f64,
    /// 95 % interval of the RMS before.
    pub before_ci95: Option<(f64, f64)>,
    /// 95 % interval of the RMS after.
    pub after_ci95: Option<(f64, f64)>,
    /// RMS of the black box.
    pub black_box_rms: Option<f64>,
    /// RMS of the noise alone.
    pub noise_floor: Option<f64>,
}

/// Forward simulation of one joint: how far the simulated motion is from the recorded one.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ForwardRow {
    /// Joint.
    pub joint: String,
    /// RMS position error with the terms off \[rad\].
    pub off_rad: f64,
    /// RMS position error with the terms on \[rad\].
    pub on_rad: f64,
}

/// What no named effect explains.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Unknown {
    /// Share of the mismatch.
    pub share: f64,
    /// In words: where, how large, what it looks like.
    pub sentence: String,
    /// Small expression that survived a fresh hold-out, in plain notation; empty where none did.
    pub expression: String,
    /// Where the residual sits.
    pub map: Option<HeatMap>,
}

/// An effect that was tested and left out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Excluded {
    /// Id of the effect.
    pub effect: String,
    /// Why, with the number that shows it.
    pub reason: String,
}

/// The experiment that would decide between explanations left open.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NextExperiment {
    /// What to do and why, in words.
    pub sentence: String,
    /// Effects it separates.
    pub separates: Vec<String>,
    /// Command or file to run it with; may be empty.
    pub command: String,
    /// Time of the proposed trajectory \[s\]; may be empty.
    pub t_s: Vec<f64>,
    /// Proposed joint positions \[rad\].
    pub positions_rad: Vec<NamedSeries>,
}

/// Writes the diagnosis report as one self-contained HTML file.
#[must_use]
pub fn diagnosis_report(data: &DiagnosisReportData) -> String {
    let unit = torque_unit(&data.torque_unit);
    let mut facts = vec![("Robot".to_owned(), data.robot.clone())];
    facts.extend(setup_facts(&data.setup));
    let shading = evidence::shading(data);
    let mut sections = vec![
        Section::new("Warnings", data.warnings.iter().map(Block::caution).collect()),
        Section::new("What is missing", findings::blocks(data, unit, &shading)),
        Section::new("Where the mismatch is", evidence::located(data, unit)),
        Section::new("Proof on held-out recordings", evidence::held_out(data, unit)),
        Section::new("Residual over time", evidence::over_time(data, unit, &shading)),
        Section::new("Residual over velocity and angle", evidence::over_variables(data, unit, &shading)),
        Section::new("What remains unknown", evidence::unknown(data)),
        Section::new("Tested and left out", evidence::excluded(&data.excluded)),
        Section::new("Next experiment", evidence::next_experiment(data)),
        Section::new("Repairs", repairs_blocks(&data.repairs)),
    ];
    sections.retain(|s| !s.blocks.is_empty());
    let (tone, label) = tone(data);
    Report {
        title: format!("Diagnosis of {}", data.robot),
        verdict_label: label.to_owned(),
        verdict: data.verdict.clone(),
        tone,
        figures: figures(data),
        facts,
        sections,
    }
    .to_html()
}

fn tone(data: &DiagnosisReportData) -> (Tone, &'static str) {
    if !data.detected {
        (Tone::Good, "No mismatch beyond noise")
    } else if data.findings.is_empty() || data.findings.iter().all(|f| f.status == "unknown") {
        (Tone::Problem, "Mismatch found, cause unknown")
    } else if data.findings.iter().any(|f| f.status == "unknown") {
        (Tone::Caution, "Mismatch found and named in part")
    } else {
        (Tone::Caution, "Mismatch found and named")
    }
}

fn figures(data: &DiagnosisReportData) -> Vec<Figure> {
    let figure = |label: &str, value: String, note: String| Figure { label: label.to_owned(), value, note };
    let mut figures = Vec::new();
    if let Some(before) = data.relative_before {
        figures.push(figure("Torque error before, held out", percent(before), String::new()));
    }
    if let Some(after) = data.relative_after.filter(|_| !data.findings.is_empty()) {
        let interval = |(low, high)| format!("95 % interval {} to {}", percent(low), percent(high));
        let note = data.relative_after_ci95.map_or_else(String::new, interval);
        figures.push(figure("After", percent(after), note));
    }
    if let Some(black_box) = data.black_box_relative {
        figures.push(figure("Black box, same data", percent(black_box), data.black_box.clone()));
    }
    if let Some(p) = data.significance {
        let label = "Chance of this on a sound model";
        figures.push(figure(label, significant(p, 2), String::new()));
    }
    figures
}

/// Axis of the proposed trajectory.
fn position_axis() -> Axis {
    Axis::new("Position", "rad")
}
