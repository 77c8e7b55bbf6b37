//! The identification report: can this model be trusted, and what is in it?

use crate::blocks::{Bar, Bars, Block, Cell, Figure, Report, Section, Table, Tone};
use crate::chart::{Chart, Role};
use crate::common::{
    joint_names, model_role, overlay, parameter_table, percent_or_dash, repairs_blocks, residual_over,
    residual_over_time, setup_facts, torque_unit,
};
use crate::data::{ParameterRow, RepairRow, Setup, TorqueTrace};
use crate::number::{compact, percent, significant};
use crate::payload::{self, PayloadRow, PayloadTrace};
use serde::{Deserialize, Serialize};

/// All an identification report shows. Empty fields leave their part out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct IdentificationReportData {
    /// Name of the robot.
    pub robot: String,
    /// Unit of all torques: "Nm", "A" or "V"; empty means Nm.
    pub torque_unit: String,
    /// How the parameters were estimated: "pooled, weighted least squares", "paper".
    pub method: String,
    /// One or two sentences a controls engineer would say.
    pub verdict: String,
    /// How the verdict is to be taken.
    pub tone: Tone,
    /// Data, split, band.
    pub setup: Setup,
    /// Torque error on the held-out data, pooled over joints (share of the torque, not per cent).
    pub relative_error: Option<f64>,
    /// 95 % interval of `relative_error`.
    pub relative_error_ci95: Option<(f64, f64)>,
    /// The same error before identification (nominal model), for comparison.
    pub relative_error_nominal: Option<f64>,
    /// Held-out error per joint.
    pub held_out: Vec<HeldOutRow>,
    /// Other models or methods judged on the same held-out data: the paper's path, physically consistent
    /// parameters.
    pub methods: Vec<MethodRow>,
    /// Recordings with measured and model torque, held-out ones first. Models from simplest to best.
    pub traces: Vec<TorqueTrace>,
    /// Identified parameters.
    pub parameters: Vec<ParameterRow>,
    /// Parameters the data do not excite.
    pub not_excited: Vec<NotExcited>,
    /// Condition numbers.
    pub conditioning: Vec<ConditionRow>,
    /// Mean and standard deviation of the torque error per model, as the paper's Table 1.
    pub table_1: Option<ErrorTable>,
    /// The same without and with the payload, as the paper's Table 2.
    pub table_2: Option<ErrorTable>,
    /// Estimated payload over time, as the paper's Fig. 8; one entry per torque source.
    pub payload: Vec<PayloadTrace>,
    /// What was carried when.
    pub payload_rows: Vec<PayloadRow>,
    /// Forward simulation on the held-out data.
    pub forward: Option<ForwardErrors>,
    /// Warnings in words.
    pub warnings: Vec<String>,
    /// What was repaired in the recordings.
    pub repairs: Vec<RepairRow>,
}

/// Held-out torque error of one joint, in the torque unit.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeldOutRow {
    /// Joint.
    pub joint: String,
    /// Root mean square.
    pub rms: f64,
    /// Mean μ.
    pub mean: f64,
    /// Standard deviation σ.
    pub std: f64,
    /// Share of the joint's torque.
    pub relative_error: f64,
    /// RMS of the measurement noise alone, where known.
    pub noise_floor: Option<f64>,
}

/// One model among several judged on the same data.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MethodRow {
    /// Name.
    pub name: String,
    /// Pooled relative error.
    pub relative_error: f64,
    /// RMS per joint, in the torque unit.
    pub rms: Vec<f64>,
    /// Remark: "all inertias physically possible".
    pub note: String,
}

/// A parameter the data say nothing about.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NotExcited {
    /// Symbol.
    pub symbol: String,
    /// Why, with the number that shows it.
    pub reason: String,
}

/// A condition number.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ConditionRow {
    /// Of what: "regressor, columns scaled".
    pub what: String,
    /// The number.
    pub value: f64,
    /// Above this it is a reason for doubt.
    pub limit: Option<f64>,
}

/// Mean and standard deviation of the torque error: rows are joints, columns models (the paper's tables).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ErrorTable {
    /// What and over which trajectory.
    pub caption: String,
    /// Names of the models: `M_KH`, `M_Id`, `M_{Id+F}`.
    pub models: Vec<String>,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// (μ, σ) per joint and model, in the torque unit.
    pub errors: Vec<Vec<(f64, f64)>>,
}

impl ErrorTable {
    /// The table as the paper lays it out: μ and σ beside each other for every model.
    #[must_use]
    pub fn table(&self, unit: &str) -> Table {
        let mut table = Table::new(&self.caption, &["Joint"]);
        table.columns.extend(self.models.iter().flat_map(|m| [format!("{m}: μ [{unit}]"), format!("{m}: σ [{unit}]")]));
        for (joint, errors) in self.joints.iter().zip(&self.errors) {
            let mut row = vec![Cell::Head(joint.clone())];
            row.extend(errors.iter().flat_map(|&(mean, std)| [Cell::number(mean), Cell::number(std)]));
            table.push(row);
        }
        table
    }
}

/// Forward simulation on held-out data: root mean square position error per joint and horizon.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ForwardErrors {
    /// How far ahead \[s\].
    pub horizons_s: Vec<f64>,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// `identified[horizon][joint]` \[rad; prismatic: m\].
    pub identified: Vec<Vec<f64>>,
    /// Further models at the longest horizon, per joint: name and errors.
    pub others: Vec<(String, Vec<f64>)>,
    /// How it was done, in words.
    pub note: String,
}

/// Writes the identification report as one self-contained HTML file.
#[must_use]
pub fn identification_report(data: &IdentificationReportData) -> String {
    let unit = torque_unit(&data.torque_unit);
    let mut facts = vec![("Robot".to_owned(), data.robot.clone())];
    if !data.method.is_empty() {
        facts.push(("Method".to_owned(), data.method.clone()));
    }
    facts.extend(setup_facts(&data.setup));
    let mut sections = vec![Section::new("Warnings", data.warnings.iter().map(Block::caution).collect())];
    sections.push(Section::new("Error on held-out data", held_out(data, unit)));
    sections.push(Section::new("Measured and modelled torque", overlays(data, unit)));
    sections.push(Section::new("Residual over time", residuals_over_time(data, unit)));
    sections.push(Section::new("Residual over velocity and angle", residuals_over_variables(data, unit)));
    sections.push(Section::new("Parameters", parameters(data)));
    sections.push(Section::new("Error of each model", error_tables(data, unit)));
    sections.push(Section::new("Payload", payload::blocks(&data.payload_rows, &data.payload)));
    sections.push(Section::new("Repairs", repairs_blocks(&data.repairs)));
    sections.retain(|s| !s.blocks.is_empty());
    let title = format!("Identification of {}", data.robot);
    let figures = figures(data, unit);
    let (verdict, tone) = (data.verdict.clone(), data.tone);
    Report { title, verdict_label: String::new(), verdict, tone, figures, facts, sections }.to_html()
}

fn figures(data: &IdentificationReportData, unit: &str) -> Vec<Figure> {
    let mut figures = Vec::new();
    if let Some(error) = data.relative_error {
        let interval =
            data.relative_error_ci95.map(|(low, high)| format!("95 % interval {} to {}", percent(low), percent(high)));
        let nominal = data.relative_error_nominal.map(|e| format!("{} before identification", percent(e)));
        let note = [nominal, interval].into_iter().flatten().collect::<Vec<_>>().join("; ");
        figures.push(Figure { label: "Torque error, held out".to_owned(), value: percent(error), note });
    }
    if let Some(worst) = data.held_out.iter().max_by(|a, b| a.rms.total_cmp(&b.rms)) {
        let value = format!("{} {unit}", significant(worst.rms, 3));
        let note = format!("{}, RMS", worst.joint);
        figures.push(Figure { label: "Largest error of a joint".to_owned(), value, note });
    }
    if !data.parameters.is_empty() {
        let note = match data.not_excited.len() {
            0 => "all the model has".to_owned(),
            1 => "1 is not supported by these data".to_owned(),
            n => format!("{n} are not supported by these data"),
        };
        let value = data.parameters.len().to_string();
        figures.push(Figure { label: "Parameters identified".to_owned(), value, note });
    }
    figures
}

fn held_out(data: &IdentificationReportData, unit: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    if !data.held_out.is_empty() {
        let noise = data.held_out.iter().any(|r| r.noise_floor.is_some());
        let mut table = Table::new("Torque error per joint, held out", &["Joint"]);
        let units = ["RMS", "Mean μ", "Standard deviation σ"];
        table.columns.extend(units.iter().map(|c| format!("{c} [{unit}]")));
        table.columns.push("Relative error".to_owned());
        if noise {
            table.columns.push(format!("Noise alone [{unit}]"));
        }
        for row in &data.held_out {
            table.push(vec![
                Cell::Head(row.joint.clone()),
                Cell::strong(row.rms),
                Cell::number(row.mean),
                Cell::number(row.std),
                Cell::percent(row.relative_error),
                Cell::optional(row.noise_floor),
            ]);
        }
        let pooled = format!("All joints pooled: {} relative error.", percent_or_dash(data.relative_error));
        blocks.push(Block::Table(if data.relative_error.is_some() { table.with_note(&pooled) } else { table }));
    }
    if !data.methods.is_empty() {
        blocks.push(Block::Bars(method_bars(&data.methods)));
        blocks.push(Block::Table(method_table(data, unit)));
    }
    blocks.extend(data.forward.as_ref().map(forward));
    blocks
}

fn method_bars(methods: &[MethodRow]) -> Bars {
    let last = methods.len().saturating_sub(1);
    let bars = methods.iter().enumerate().map(|(k, m)| Bar {
        label: m.name.clone(),
        value: m.relative_error,
        interval: None,
        text: percent(m.relative_error),
        role: model_role(k, last),
    });
    Bars { caption: "Relative torque error, held out, by model".to_owned(), bars: bars.collect(), full_scale: None }
}

fn method_table(data: &IdentificationReportData, unit: &str) -> Table {
    let mut table = Table::new("Models judged on the same held-out data", &["Model", "Relative error"]);
    table.columns.extend(data.held_out.iter().map(|r| format!("{}, RMS [{unit}]", r.joint)));
    table.columns.push("Remark".to_owned());
    for method in &data.methods {
        let mut row = vec![Cell::Math(method.name.clone()), Cell::Strong(percent(method.relative_error))];
        row.extend((0..data.held_out.len()).map(|j| Cell::optional(method.rms.get(j).copied())));
        row.push(Cell::text(&method.note));
        table.push(row);
    }
    table
}

/// Position of the best model in a trace's list.
fn best(trace: &TorqueTrace) -> usize {
    trace.joints.iter().map(|j| j.models.len()).max().unwrap_or(0).saturating_sub(1)
}

fn overlays(data: &IdentificationReportData, unit: &str) -> Vec<Block> {
    per_recording(&data.traces, |k, trace| {
        let chart = |joint| overlay(trace, joint, best(trace), unit, &format!("r{k}"));
        trace.joints.iter().map(chart).map(Block::Chart).collect()
    })
}

fn residuals_over_time(data: &IdentificationReportData, unit: &str) -> Vec<Block> {
    per_recording(&data.traces, |k, trace| {
        let models = first_and_last(best(trace));
        let chart = |joint| residual_over_time(trace, joint, &models, unit, &format!("r{k}"), &[]);
        trace.joints.iter().map(chart).map(Block::Chart).collect()
    })
}

/// The first recording open, the others on demand.
pub(crate) fn per_recording(traces: &[TorqueTrace], charts: impl Fn(usize, &TorqueTrace) -> Vec<Block>) -> Vec<Block> {
    if let [only] = traces {
        let mut blocks = vec![Block::text(format!("Recording {}.", only.recording))];
        blocks.extend(charts(0, only));
        return blocks;
    }
    let one = |(k, trace): (usize, &TorqueTrace)| Block::Details {
        summary: trace.recording.clone(),
        open: k == 0,
        blocks: charts(k, trace),
    };
    traces.iter().enumerate().map(one).collect()
}

fn first_and_last(last: usize) -> Vec<(usize, Role)> {
    if last == 0 { vec![(0, Role::After)] } else { vec![(0, Role::Before), (last, Role::After)] }
}

fn residuals_over_variables(data: &IdentificationReportData, unit: &str) -> Vec<Block> {
    let models = first_and_last(data.traces.iter().map(best).max().unwrap_or(0));
    let mut blocks = Vec::new();
    for joint in joint_names(&data.traces) {
        let over = |variable| residual_over(&data.traces, &joint, variable, &models, unit, &[]);
        let charts: Vec<Chart> = ["qd_rad_s", "q_rad"].into_iter().filter_map(over).collect();
        if !charts.is_empty() {
            blocks.push(Block::Charts(charts));
        }
    }
    blocks
}

fn parameters(data: &IdentificationReportData) -> Vec<Block> {
    let mut blocks = Vec::new();
    if !data.parameters.is_empty() {
        let table = parameter_table("Identified parameters", &data.parameters);
        let merged = data.parameters.iter().any(|p| !p.merged_with.is_empty());
        let note = "Merged: these signals show only the combination, so the value is the combination's.";
        blocks.push(Block::Table(if merged { table.with_note(note) } else { table }));
    }
    if !data.not_excited.is_empty() {
        let mut table =
            Table::new("Not supported by these recordings, therefore not identified", &["Symbol", "Reason"]);
        for row in &data.not_excited {
            table.push(vec![Cell::Math(row.symbol.clone()), Cell::text(&row.reason)]);
        }
        blocks.push(Block::Table(table));
    }
    if !data.conditioning.is_empty() {
        let mut table = Table::new("Condition numbers", &["Of", "Value", "Doubtful above", "Judgement"]);
        for row in &data.conditioning {
            let judgement = match row.limit {
                Some(limit) if row.value > limit => Cell::Flag(Tone::Caution, "poorly excited".to_owned()),
                Some(_) if row.value.is_finite() => Cell::Flag(Tone::Good, "well excited".to_owned()),
                _ => Cell::Empty,
            };
            table.push(vec![
                Cell::Head(row.what.clone()),
                Cell::number(row.value),
                Cell::optional(row.limit),
                judgement,
            ]);
        }
        blocks.push(Block::Table(table));
    }
    blocks
}

fn error_tables(data: &IdentificationReportData, unit: &str) -> Vec<Block> {
    [&data.table_1, &data.table_2].into_iter().flatten().map(|t| Block::Table(t.table(unit))).collect()
}

fn forward(errors: &ForwardErrors) -> Block {
    let caption = "Forward simulation, held out: RMS error of the simulated position (prismatic joints: mm)";
    let mut table = Table::new(caption, &["Joint"]);
    let ahead = |h: &f64| format!("{} ms", compact(1e3 * h));
    table.columns.extend(errors.horizons_s.iter().map(|h| format!("Identified, {} [mrad]", ahead(h))));
    let longest = errors.horizons_s.last().map_or_else(String::new, ahead);
    table.columns.extend(errors.others.iter().map(|(name, _)| format!("{name}, {longest} [mrad]")));
    let last = errors.identified.len().saturating_sub(1);
    for (j, joint) in errors.joints.iter().enumerate() {
        let get = |list: &[f64]| 1e3 * list.get(j).copied().unwrap_or(f64::NAN);
        let mut row = vec![Cell::Head(joint.clone())];
        let cell =
            |(k, rms): (usize, &Vec<f64>)| if k == last { Cell::strong(get(rms)) } else { Cell::number(get(rms)) };
        row.extend(errors.identified.iter().enumerate().map(cell));
        row.extend(errors.others.iter().map(|(_, rms)| Cell::number(get(rms))));
        table.push(row);
    }
    Block::Table(table.with_note(&errors.note))
}
