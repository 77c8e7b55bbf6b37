//! Where it is, the proof, what remains, what was excluded, what to do next.

use super::findings::region_words;
use super::{DiagnosisReportData, Excluded, TimeInterval};
use crate::blocks::{Bar, Bars, Block, Cell, Table, Tone};
use crate::chart::{Axis, Chart, Curve, Role};
use crate::common::{Shading, joint_names, residual_over, residual_over_time, variable_names};
use crate::data::TorqueTrace;
use crate::identification::per_recording;
use crate::number::{fixed, percent, with_interval};

/// What is shaded in the charts: the located regions, and the findings' own where they name some.
pub(super) fn shading(data: &DiagnosisReportData) -> Vec<Shading> {
    let times = |list: &[TimeInterval]| list.iter().map(|i| (i.recording.clone(), i.from_s, i.to_s)).collect();
    let located = data.located.iter().map(|l| Shading {
        joint: l.joint.clone(),
        regions: l.regions.iter().map(|r| (r.variable.clone(), r.low, r.high)).collect(),
        intervals: times(&l.intervals),
        label: "located here".to_owned(),
    });
    let found = data.findings.iter().flat_map(|f| {
        f.joints.iter().map(|joint| Shading {
            joint: joint.clone(),
            // Its regions are shaded in the finding's own card.
            regions: Vec::new(),
            intervals: times(&f.intervals),
            label: f.effect.clone(),
        })
    });
    located.chain(found).collect()
}

/// Which models the residual charts compare: before, after and, if wanted, the black box.
pub(super) fn compared(data: &DiagnosisReportData, black_box: bool) -> Vec<(usize, Role)> {
    let count = data.traces.iter().flat_map(|t| &t.joints).map(|j| j.models.len()).max().unwrap_or(0);
    let mut models = vec![(0, Role::Before)];
    if count > 1 {
        models.push((1, Role::After));
    }
    if count > 2 && black_box {
        models.push((2, Role::BlackBox));
    }
    models
}

pub(super) fn located(data: &DiagnosisReportData, unit: &str) -> Vec<Block> {
    if data.located.is_empty() {
        return Vec::new();
    }
    let bar = |l: &super::Located| Bar {
        label: if l.stage.is_empty() { l.joint.clone() } else { format!("{} ({})", l.joint, l.stage) },
        value: l.share,
        interval: None,
        text: percent(l.share),
        role: Role::Before,
    };
    let caption = "Share of the mismatch by joint".to_owned();
    let bars = Bars { caption, bars: data.located.iter().map(bar).collect(), full_scale: Some(1.0) };
    let mut table = Table::new("Where and when", &["Joint", "Share", "", "Stage", "Region", "Time"]);
    if let Some(size) = table.columns.get_mut(2) {
        *size = format!("Size, RMS [{unit}]");
    }
    for l in &data.located {
        let regions: Vec<String> = l.regions.iter().map(region_words).collect();
        table.push(vec![
            Cell::Head(l.joint.clone()),
            Cell::percent(l.share),
            Cell::optional(l.size),
            Cell::text(&l.stage),
            Cell::text(if regions.is_empty() { "everywhere".to_owned() } else { regions.join("; ") }),
            Cell::text(times(&l.intervals)),
        ]);
    }
    vec![Block::Bars(bars), Block::Table(table)]
}

fn times(intervals: &[TimeInterval]) -> String {
    const SHOWN: usize = 6;
    if intervals.is_empty() {
        return "throughout".to_owned();
    }
    let one = |i: &TimeInterval| format!("{}: {} to {} s", i.recording, fixed(i.from_s, 2), fixed(i.to_s, 2));
    let mut words: Vec<String> = intervals.iter().take(SHOWN).map(one).collect();
    if intervals.len() > SHOWN {
        words.push(format!("and {} more", intervals.len() - SHOWN));
    }
    words.join("; ")
}

pub(super) fn held_out(data: &DiagnosisReportData, unit: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let candidates = [
        ("before", data.relative_before, None, Role::Before),
        ("after, named physics", data.relative_after, data.relative_after_ci95, Role::After),
        ("black box", data.black_box_relative, None, Role::BlackBox),
        ("noise alone", data.noise_relative, None, Role::Measured),
    ];
    let bars: Vec<Bar> = candidates
        .into_iter()
        .filter_map(|(label, value, interval, role)| {
            value.map(|value| Bar { label: label.to_owned(), value, interval, text: percent(value), role })
        })
        .collect();
    if !bars.is_empty() {
        let words = if data.held_out_words.is_empty() { "held out" } else { &data.held_out_words };
        let caption = format!("Relative torque error, all joints, {words}");
        blocks.push(Block::Bars(Bars { caption, bars, full_scale: None }));
    }
    if let (Some(after), Some(black_box)) = (data.relative_after, data.black_box_relative) {
        blocks.push(Block::text(black_box_words(after, black_box)));
    }
    if !data.held_out.is_empty() {
        blocks.push(Block::Table(held_out_table(data, unit)));
    }
    if !data.forward.is_empty() {
        let columns = ["Joint", "Terms off [rad]", "Terms on [rad]", "Change"];
        let mut table = Table::new("Forward simulation: RMS error of the simulated position", &columns);
        for row in &data.forward {
            let change = row.on_rad / row.off_rad - 1.0;
            table.push(vec![
                Cell::Head(row.joint.clone()),
                Cell::number(row.off_rad),
                Cell::strong(row.on_rad),
                Cell::percent(change),
            ]);
        }
        blocks.push(Block::Table(table));
        if !data.forward_words.is_empty() {
            blocks.push(Block::text(&data.forward_words));
        }
    }
    blocks
}

fn black_box_words(after: f64, black_box: f64) -> String {
    let shares = format!("({} against {})", percent(after), percent(black_box));
    if after <= black_box {
        format!(
            "The named model is at least as good as the black box {shares}: a flexible function of the same inputs found nothing more."
        )
    } else {
        format!("The black box is better {shares}: something systematic is left that the named terms do not describe.")
    }
}

fn held_out_table(data: &DiagnosisReportData, unit: &str) -> Table {
    let black_box = data.held_out.iter().any(|r| r.black_box_rms.is_some());
    let noise = data.held_out.iter().any(|r| r.noise_floor.is_some());
    let mut table = Table::new("Residual RMS per joint, held out", &["Joint"]);
    for column in ["Before", "95 % interval, before", "After", "95 % interval, after"] {
        table.columns.push(format!("{column} [{unit}]"));
    }
    table.columns.push("Removed".to_owned());
    for (wanted, column) in [(black_box, "Black box"), (noise, "Noise alone")] {
        if wanted {
            table.columns.push(format!("{column} [{unit}]"));
        }
    }
    for row in &data.held_out {
        let interval = |value: f64, ci: Option<(f64, f64)>| {
            let (low, high) = ci.unwrap_or((f64::NAN, f64::NAN));
            with_interval(value, low, high)
        };
        let (before, after) = (interval(row.before_rms, row.before_ci95), interval(row.after_rms, row.after_ci95));
        let mut cells = vec![
            Cell::Head(row.joint.clone()),
            Cell::Number(before.0),
            Cell::Number(before.1),
            Cell::Strong(after.0),
            Cell::Number(after.1),
            Cell::percent(1.0 - row.after_rms / row.before_rms),
        ];
        if black_box {
            cells.push(Cell::optional(row.black_box_rms));
        }
        if noise {
            cells.push(Cell::optional(row.noise_floor));
        }
        table.push(cells);
    }
    table
}

pub(super) fn over_time(data: &DiagnosisReportData, unit: &str, shading: &[Shading]) -> Vec<Block> {
    let models = compared(data, true);
    per_recording(&data.traces, |k, trace: &TorqueTrace| {
        let group = format!("r{k}");
        let chart = |joint| residual_over_time(trace, joint, &models, unit, &group, shading);
        trace.joints.iter().map(chart).map(Block::Chart).collect()
    })
}

/// Joints with a share or a finding are open; the others wait.
pub(super) fn over_variables(data: &DiagnosisReportData, unit: &str, shading: &[Shading]) -> Vec<Block> {
    let models = compared(data, false);
    let mut blocks = Vec::new();
    for joint in joint_names(&data.traces) {
        let mut variables = vec!["qd_rad_s".to_owned(), "q_rad".to_owned()];
        variables.extend(variable_names(&data.traces, &joint));
        let over = |v: &String| residual_over(&data.traces, &joint, v, &models, unit, shading);
        let charts: Vec<Chart> = variables.iter().filter_map(over).collect();
        let concerned = data.located.iter().any(|l| l.joint == joint && l.share >= 0.1)
            || data.findings.iter().any(|f| f.joints.contains(&joint));
        if charts.is_empty() {
            continue;
        }
        blocks.push(Block::Details { summary: joint, open: concerned, blocks: vec![Block::Charts(charts)] });
    }
    blocks
}

pub(super) fn unknown(data: &DiagnosisReportData) -> Vec<Block> {
    let Some(unknown) = &data.unknown else { return Vec::new() };
    let mut blocks = vec![Block::text(format!("{} of the mismatch has no name.", percent(unknown.share)))];
    if !unknown.sentence.is_empty() {
        blocks.push(Block::text(&unknown.sentence));
    }
    if !unknown.expression.is_empty() {
        blocks.push(Block::text("An expression that survived data it had not seen:"));
        blocks.push(Block::Equation(unknown.expression.clone()));
    }
    blocks.extend(unknown.map.clone().map(Block::HeatMap));
    blocks
}

pub(super) fn excluded(list: &[Excluded]) -> Vec<Block> {
    if list.is_empty() {
        return Vec::new();
    }
    let mut table = Table::new("Effects that were tested and left out", &["Effect", "Reason"]);
    for row in list {
        table.push(vec![Cell::Head(row.effect.clone()), Cell::text(&row.reason)]);
    }
    vec![Block::Table(table)]
}

pub(super) fn next_experiment(data: &DiagnosisReportData) -> Vec<Block> {
    let Some(next) = &data.next_experiment else { return Vec::new() };
    let mut blocks = vec![Block::text(&next.sentence)];
    if !next.separates.is_empty() {
        blocks.push(Block::text(format!("It separates {}.", next.separates.join(" from "))));
    }
    if !next.command.is_empty() {
        blocks.push(Block::Notice { tone: Tone::Neutral, text: next.command.clone() });
    }
    let roles = [Role::After, Role::Before, Role::Other(1), Role::Other(2), Role::Other(0), Role::BlackBox];
    let curves: Vec<Curve<'_>> = next
        .positions_rad
        .iter()
        .zip(roles.into_iter().cycle())
        .map(|(s, role)| Curve { name: &s.name, role, values: &s.values, shown: true })
        .collect();
    if !curves.is_empty() && !next.t_s.is_empty() {
        let title = "Proposed trajectory";
        blocks.push(Block::Chart(Chart::lines(
            title,
            Axis::new("Time", "s"),
            super::position_axis(),
            &next.t_s,
            &curves,
        )));
    }
    blocks
}
