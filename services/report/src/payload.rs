//! The payload: what was carried when, how heavy, how quickly the estimate knew; on its own or within the report of an
//! identification.

use crate::blocks::{Block, Cell, Figure, Report, Section, Table, Tone};
use crate::chart::{Axis, Chart, Curve, Role};
use crate::common::{repairs_blocks, torque_unit};
use crate::data::RepairRow;
use crate::identification::ErrorTable;
use crate::number::fixed;
use serde::{Deserialize, Serialize};

/// Estimated payload mass over time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PayloadTrace {
    /// What it was estimated from: "v_P, measured torque".
    pub source: String,
    /// Time \[s\].
    pub t_s: Vec<f64>,
    /// Estimate \[kg\].
    pub estimate_kg: Vec<f64>,
    /// Mass carried, where known, or as found \[kg\].
    pub true_kg: Vec<f64>,
    /// Whether `true_kg` is known, not found.
    pub known: bool,
}

/// A payload that was carried for a while.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PayloadRow {
    /// File name of the recording.
    pub recording: String,
    /// What it was estimated from: "measured torque".
    pub source: String,
    /// Picked at \[s\]; `None`: before the motion first supports an estimate.
    pub picked_s: Option<f64>,
    /// Placed at \[s\]; `None`: carried to the end.
    pub placed_s: Option<f64>,
    /// Estimated mass \[kg\].
    pub mass_kg: Option<f64>,
    /// Its standard deviation by the estimator \[kg\].
    pub sd_kg: Option<f64>,
    /// Known mass \[kg\].
    pub known_kg: Option<f64>,
    /// Time from the pick until the estimate stays within 5 % \[s\].
    pub settled_after_s: Option<f64>,
    /// Time from the place until it stays at zero \[s\].
    pub zero_after_s: Option<f64>,
}

/// All a payload report shows. Empty fields leave their part out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PayloadReportData {
    /// Name of the robot.
    pub robot: String,
    /// Unit of all torques; empty means Nm.
    pub torque_unit: String,
    /// One or two sentences a controls engineer would say.
    pub verdict: String,
    /// How the verdict is to be taken.
    pub tone: Tone,
    /// Model, recordings, settings, as label and value.
    pub facts: Vec<(String, String)>,
    /// What was carried.
    pub rows: Vec<PayloadRow>,
    /// The estimate over time.
    pub traces: Vec<PayloadTrace>,
    /// Torque error without and with the payload, one table per recording.
    pub tables: Vec<ErrorTable>,
    /// Warnings in words.
    pub warnings: Vec<String>,
    /// What was repaired in the recordings.
    pub repairs: Vec<RepairRow>,
}

/// Writes the payload report as one self-contained HTML file.
#[must_use]
pub fn payload_report(data: &PayloadReportData) -> String {
    let unit = torque_unit(&data.torque_unit);
    let tables = data.tables.iter().map(|t| Block::Table(t.table(unit))).collect();
    let mut sections = vec![
        Section::new("Warnings", data.warnings.iter().map(Block::caution).collect()),
        Section::new("Payload over time", blocks(&data.rows, &data.traces)),
        Section::new("Torque error without and with the payload", tables),
        Section::new("Repairs", repairs_blocks(&data.repairs)),
    ];
    sections.retain(|s| !s.blocks.is_empty());
    let mut facts = vec![("Robot".to_owned(), data.robot.clone())];
    facts.extend(data.facts.iter().cloned());
    Report {
        title: format!("Payload of {}", data.robot),
        verdict_label: String::new(),
        verdict: data.verdict.clone(),
        tone: data.tone,
        figures: figures(&data.rows),
        facts,
        sections,
    }
    .to_html()
}

/// The slowest pick and the slowest place, and the largest error where the mass is known.
fn figures(rows: &[PayloadRow]) -> Vec<Figure> {
    let rows = || rows.iter().filter(|r| r.source.contains("measured"));
    let figure = |label: &str, value: String, note: String| Figure { label: label.to_owned(), value, note };
    let mut out = vec![figure("Payloads carried", rows().count().to_string(), String::new())];
    let worst = |of: fn(&PayloadRow) -> Option<f64>| {
        rows().filter_map(of).fold(None, |m: Option<f64>, v| Some(m.map_or(v, |m| m.max(v))))
    };
    let seconds = |v: f64| format!("{} s", fixed(v, 3));
    if let Some(t) = worst(|r| r.settled_after_s) {
        let missing = rows().filter(|r| r.picked_s.is_some() && r.settled_after_s.is_none()).count();
        let note = if missing > 0 {
            format!("{missing} did not settle before the place")
        } else {
            "within 5 % of the mass".to_owned()
        };
        out.push(figure("Slowest to settle after a pick", seconds(t), note));
    }
    if let Some(t) = worst(|r| r.zero_after_s) {
        out.push(figure("Slowest back to zero after a place", seconds(t), "within 5 % of the mass".to_owned()));
    }
    if let Some(e) = worst(|r| r.mass_kg.zip(r.known_kg).map(|(m, k)| (m / k - 1.0).abs())) {
        out.push(figure("Largest error of a mass", crate::number::percent(e), "against the known mass".to_owned()));
    }
    out
}

/// Table and charts of the payload.
pub(crate) fn blocks(rows: &[PayloadRow], traces: &[PayloadTrace]) -> Vec<Block> {
    let mut blocks = Vec::new();
    if !rows.is_empty() {
        blocks.push(Block::Table(table(rows)));
    }
    for trace in traces {
        let curve = |name, role, values| Curve { name, role, values, shown: true };
        let mut curves = vec![curve("estimated", Role::After, trace.estimate_kg.as_slice())];
        if !trace.true_kg.is_empty() {
            let name = if trace.known { "known" } else { "carried, as found" };
            curves.insert(0, curve(name, Role::Measured, trace.true_kg.as_slice()));
        }
        let title = format!("From {}", trace.source);
        let chart = Chart::lines(&title, Axis::new("Time", "s"), Axis::new("Payload", "kg"), &trace.t_s, &curves);
        blocks.push(Block::Chart(
            chart.synced("payload").with_note("A gap is where the motion does not support an estimate."),
        ));
    }
    blocks
}

/// Milliseconds and grams: more is not in the signals.
fn digits(value: Option<f64>) -> Cell {
    Cell::Number(fixed(value.unwrap_or(f64::NAN), 3))
}

fn table(rows: &[PayloadRow]) -> Table {
    let known = rows.iter().any(|r| r.known_kg.is_some());
    let mut table = Table::new("What was carried", &["Recording", "From", "Picked [s]", "Placed [s]", "Mass [kg]"]);
    table.columns.push("Standard deviation [kg]".to_owned());
    if known {
        table.columns.extend(["Known [kg]", "Error"].map(str::to_owned));
    }
    table.columns.extend(["Settled after [s]", "Zero after [s]"].map(str::to_owned));
    for row in rows {
        let mut cells = vec![
            Cell::Head(row.recording.clone()),
            Cell::text(&row.source),
            digits(row.picked_s),
            digits(row.placed_s),
            Cell::Strong(fixed(row.mass_kg.unwrap_or(f64::NAN), 3)),
            digits(row.sd_kg),
        ];
        if known {
            let error = row.mass_kg.zip(row.known_kg).map_or(f64::NAN, |(m, k)| m / k - 1.0);
            cells.extend([digits(row.known_kg), Cell::percent(error)]);
        }
        cells.extend([digits(row.settled_after_s), digits(row.zero_after_s)]);
        table.push(cells);
    }
    table.with_note(
        "Settled: within 5 % of the mass, after a place of zero, until the next event. A dash: not before it.",
    )
}
