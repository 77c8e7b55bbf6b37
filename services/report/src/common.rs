//! Parts both builders use: settings, parameters, residual charts.

use crate::blocks::{Block, Cell, Table, Tone};
use crate::chart::{Axis, Chart, Cloud, Curve, Role};
use crate::data::{JointTrace, NamedSeries, ParameterRow, RepairRow, Setup, Stretch, TorqueTrace};
use crate::number::{compact, fixed, percent, with_interval};

/// What the located mismatch or a finding shades in the charts of one joint.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shading {
    /// Joint.
    pub joint: String,
    /// Variable, low edge, high edge.
    pub regions: Vec<(String, f64, f64)>,
    /// Recording, from, to \[s\].
    pub intervals: Vec<(String, f64, f64)>,
    /// Name in the charts.
    pub label: String,
}

pub(crate) fn torque_unit(given: &str) -> &str {
    if given.is_empty() { "Nm" } else { given }
}

pub(crate) fn stretch(s: &Stretch) -> String {
    match (s.from_s, s.to_s) {
        (None, None) => s.recording.clone(),
        (from, to) => {
            let end = |v: Option<f64>, word: &str| v.map_or_else(|| word.to_owned(), |v| format!("{} s", fixed(v, 1)));
            format!("{} ({} to {})", s.recording, end(from, "beginning"), end(to, "end"))
        }
    }
}

fn stretches(list: &[Stretch]) -> String {
    const SHOWN: usize = 12;
    let mut words: Vec<String> = list.iter().take(SHOWN).map(stretch).collect();
    if list.len() > SHOWN {
        words.push(format!("and {} more", list.len() - SHOWN));
    }
    words.join(", ")
}

/// Facts below the verdict.
pub(crate) fn setup_facts(setup: &Setup) -> Vec<(String, String)> {
    let mut facts = Vec::new();
    let mut add = |label: &str, value: String| facts.push((label.to_owned(), value));
    if !setup.train.is_empty() {
        add("Fitted to", stretches(&setup.train));
    }
    if !setup.test.is_empty() {
        add("Judged on", stretches(&setup.test));
    }
    if let Some(band) = setup.band_hz {
        add("Band", format!("0 to {} Hz, zero phase, on torque and model alike", compact(band)));
    }
    if let Some(speed) = setup.moving_rad_s {
        add("Judged where", format!("moving faster than {} rad/s", compact(speed)));
    }
    if let Some(samples) = setup.samples {
        add("Samples", fixed(samples as f64, 0));
    }
    facts.extend(setup.further.iter().cloned());
    facts
}

/// The parameter table; columns that would be empty throughout are left out.
pub(crate) fn parameter_table(caption: &str, rows: &[ParameterRow]) -> Table {
    let any = |has: fn(&ParameterRow) -> bool| rows.iter().any(has);
    let (joint, meaning) = (any(|r| !r.joint.is_empty()), any(|r| !r.meaning.is_empty()));
    let (nominal, merged) = (any(|r| r.nominal.is_some()), any(|r| !r.merged_with.is_empty()));
    let remarks = rows.iter().any(|r| remark(r) != Cell::Empty);
    let mut table = Table::new(caption, &["Symbol"]);
    let optional = [("Joint", joint), ("Meaning", meaning), ("Value", true), ("95 % interval", true), ("Unit", true)];
    let optional = optional.into_iter().chain([("Nominal", nominal), ("Merged with", merged), ("Remark", remarks)]);
    table.columns.extend(optional.filter(|(_, wanted)| *wanted).map(|(title, _)| title.to_owned()));
    for row in rows {
        let (low, high) = row.ci95.unwrap_or((f64::NAN, f64::NAN));
        let (value, interval) = with_interval(row.value, low, high);
        let mut cells = vec![Cell::Math(row.symbol.clone())];
        let mut add = |wanted: bool, cell: Cell| {
            if wanted {
                cells.push(cell);
            }
        };
        add(joint, Cell::text(&row.joint));
        add(meaning, Cell::text(&row.meaning));
        add(true, Cell::Strong(value));
        add(true, Cell::Number(interval));
        add(true, Cell::text(&row.unit));
        add(nominal, Cell::optional(row.nominal));
        add(merged, Cell::Math(row.merged_with.join(", ")));
        add(remarks, remark(row));
        table.push(cells);
    }
    table
}

/// What an interval says about its parameter, in words.
fn remark(row: &ParameterRow) -> Cell {
    match row.ci95 {
        None => Cell::Flag(Tone::Caution, "no interval".to_owned()),
        Some((low, high)) if low <= 0.0 && high >= 0.0 => {
            Cell::Flag(Tone::Caution, "not told apart from zero".to_owned())
        }
        Some((low, high)) if row.nominal.is_some_and(|n| n < low || n > high) => {
            Cell::text("nominal outside the interval")
        }
        _ => Cell::Empty,
    }
}

pub(crate) fn repairs_blocks(repairs: &[RepairRow]) -> Vec<Block> {
    if repairs.is_empty() {
        return vec![Block::text("Nothing was repaired: every sample is used as it was recorded.")];
    }
    let mut table = Table::new("Repaired before use", &["Recording", "What", "Count"]);
    for repair in repairs {
        table.push(vec![
            Cell::Head(repair.file.clone()),
            Cell::text(&repair.kind),
            Cell::Number(fixed(repair.count as f64, 0)),
        ]);
    }
    vec![Block::Table(table)]
}

/// "6.2 %" with "–" where there is none.
pub(crate) fn percent_or_dash(share: Option<f64>) -> String {
    percent(share.unwrap_or(f64::NAN))
}

/// Name and unit of a variable in words; unknown names stand for themselves.
pub(crate) fn variable_words(variable: &str) -> (String, &'static str) {
    let (label, unit) = match variable {
        "t_s" => ("time", "s"),
        "q_rad" => ("angle", "rad"),
        "qd_rad_s" => ("velocity", "rad/s"),
        "qdd_rad_s2" => ("acceleration", "rad/s²"),
        "tau_nm" => ("load torque", "Nm"),
        "temperature_c" => ("temperature", "°C"),
        "since_reversal_rad" => ("distance since reversal", "rad"),
        "frequency_hz" => ("frequency", "Hz"),
        "order" => ("order per motor revolution", ""),
        other => return (other.to_owned(), ""),
    };
    (label.to_owned(), unit)
}

/// Measured minus model, over the samples both have.
pub(crate) fn residual(joint: &JointTrace, model: &NamedSeries) -> Vec<f64> {
    joint.measured.iter().zip(&model.values).map(|(m, p)| m - p).collect()
}

/// Role of the k-th of `count` models: the first is before, the `after`-th is after.
pub(crate) fn model_role(k: usize, after: usize) -> Role {
    if k == after {
        Role::After
    } else if k == 0 {
        Role::Before
    } else {
        Role::Other(u8::try_from(k.saturating_sub(1) % 3).unwrap_or(0))
    }
}

/// Measured torque and the models of one joint over time. Models between the first and the last start
/// hidden: four curves on top of each other show nothing.
pub(crate) fn overlay(trace: &TorqueTrace, joint: &JointTrace, after: usize, unit: &str, group: &str) -> Chart {
    let mut curves =
        vec![Curve { name: "measured", role: Role::Measured, values: joint.measured.as_slice(), shown: true }];
    curves.extend(joint.models.iter().enumerate().filter(|(_, m)| !m.values.is_empty()).map(|(k, m)| Curve {
        name: m.name.as_str(),
        role: model_role(k, after),
        values: m.values.as_slice(),
        shown: k == after || k == 0,
    }));
    Chart::lines(&joint.joint, Axis::new("Time", "s"), Axis::new("Torque", unit), &trace.t_s, &curves).synced(group)
}

/// Residual of the named models of one joint over time, with what lies in this recording shaded.
pub(crate) fn residual_over_time(
    trace: &TorqueTrace,
    joint: &JointTrace,
    models: &[(usize, Role)],
    unit: &str,
    group: &str,
    shading: &[Shading],
) -> Chart {
    let residuals: Vec<(&str, Role, Vec<f64>)> = models
        .iter()
        .filter_map(|&(k, role)| joint.models.get(k).map(|m| (m.name.as_str(), role, residual(joint, m))))
        .collect();
    let curves: Vec<Curve<'_>> = residuals
        .iter()
        .map(|(name, role, values)| Curve { name, role: *role, values, shown: *role != Role::BlackBox })
        .collect();
    let axis = Axis::new("Residual", unit);
    let mut chart = Chart::lines(&joint.joint, Axis::new("Time", "s"), axis, &trace.t_s, &curves).synced(group);
    for part in shading.iter().filter(|s| s.joint == joint.joint) {
        for (_, from, to) in part.intervals.iter().filter(|(file, _, _)| *file == trace.recording) {
            chart = chart.with_region(*from, *to, &part.label);
        }
    }
    chart
}

/// Values of a joint's variable along the trace.
fn variable<'a>(joint: &'a JointTrace, name: &str) -> &'a [f64] {
    match name {
        "q_rad" => &joint.q_rad,
        "qd_rad_s" => &joint.qd_rad_s,
        _ => joint.variables.iter().find(|v| v.name == name).map_or(&[], |v| v.values.as_slice()),
    }
}

/// Residual of the models of one joint over a variable, all recordings together; `None` where no recording
/// has the variable.
pub(crate) fn residual_over(
    traces: &[TorqueTrace],
    joint_name: &str,
    variable_name: &str,
    models: &[(usize, Role)],
    unit: &str,
    shading: &[Shading],
) -> Option<Chart> {
    let joints: Vec<&JointTrace> = traces.iter().flat_map(|t| &t.joints).filter(|j| j.joint == joint_name).collect();
    let mut clouds = Vec::new();
    for &(k, role) in models {
        let (mut x, mut y, mut name) = (Vec::new(), Vec::new(), "");
        for joint in &joints {
            let Some(model) = joint.models.get(k) else { continue };
            name = &model.name;
            let values = residual(joint, model);
            let along = variable(joint, variable_name);
            let length = values.len().min(along.len());
            x.extend_from_slice(along.get(..length).unwrap_or_default());
            y.extend_from_slice(values.get(..length).unwrap_or_default());
        }
        clouds.push((name, role, x, y));
    }
    if clouds.iter().all(|(_, _, x, _)| x.is_empty()) {
        return None;
    }
    let clouds: Vec<Cloud<'_>> = clouds.iter().map(|(name, role, x, y)| Cloud { name, role: *role, x, y }).collect();
    let axis = variable_axis(variable_name);
    let title = format!("{joint_name}, over {}", variable_words(variable_name).0);
    let mut chart = Chart::binned(&title, axis, Axis::new("Residual", unit), &clouds);
    for part in shading.iter().filter(|s| s.joint == joint_name) {
        for (_, low, high) in part.regions.iter().filter(|(v, _, _)| v == variable_name) {
            chart = chart.with_region(*low, *high, &part.label);
        }
    }
    Some(chart)
}

/// The axis of a variable as regions and series name it.
fn variable_axis(name: &str) -> Axis {
    let (label, unit) = variable_words(name);
    let mut letters = label.chars();
    let first: String = letters.next().map(|c| c.to_uppercase().collect()).unwrap_or_default();
    Axis::new(&format!("{first}{}", letters.as_str()), unit)
}

/// Names of the joints in the order of their first appearance.
pub(crate) fn joint_names(traces: &[TorqueTrace]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for joint in traces.iter().flat_map(|t| &t.joints) {
        if !names.contains(&joint.joint) {
            names.push(joint.joint.clone());
        }
    }
    names
}

/// Names of the further variables a joint is recorded with.
pub(crate) fn variable_names(traces: &[TorqueTrace], joint: &str) -> Vec<String> {
    let mut names = Vec::new();
    for named in traces.iter().flat_map(|t| &t.joints).filter(|j| j.joint == joint).flat_map(|j| &j.variables) {
        if !names.contains(&named.name) {
            names.push(named.name.clone());
        }
    }
    names
}
