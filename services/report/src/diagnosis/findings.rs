//! One card per finding: the sentence first, then law, parameters, gain, and the residual it explains.

use super::{DiagnosisReportData, Finding, Gain};
use crate::blocks::{Bar, Bars, Block, Cell, Table, Tone};
use crate::chart::{Chart, Role};
use crate::common::{Shading, parameter_table, residual_over, variable_words};
use crate::number::{compact, percent, significant};

/// The cards, or the statement that there is nothing to name.
pub(super) fn blocks(data: &DiagnosisReportData, unit: &str, shading: &[Shading]) -> Vec<Block> {
    if data.findings.is_empty() {
        let words = if data.detected {
            "The residual exceeds the noise, but no effect of the catalogue explains it."
        } else {
            "Nothing: the residual is what noise and the model's own tolerance allow."
        };
        return vec![Block::Notice {
            tone: if data.detected { Tone::Problem } else { Tone::Good },
            text: words.to_owned(),
        }];
    }
    data.findings.iter().map(|f| card(data, f, unit, shading)).collect()
}

fn card(data: &DiagnosisReportData, finding: &Finding, unit: &str, shading: &[Shading]) -> Block {
    let name = if finding.title.is_empty() { &finding.effect } else { &finding.title };
    let title = if finding.joints.is_empty() { name.clone() } else { format!("{name}, {}", finding.joints.join(", ")) };
    let mut tag = match finding.status.as_str() {
        "unknown" => "not in the catalogue".to_owned(),
        "group" => format!("group of {}", finding.group.len().max(2)),
        _ => String::new(),
    };
    if let Some(p) = finding.probability {
        let separator = if tag.is_empty() { "" } else { ", " };
        tag = format!("{tag}{separator}probability {}", significant(p, 2));
    }
    let mut blocks = vec![Block::text(&finding.sentence)];
    if !finding.equation.is_empty() {
        blocks.push(Block::Equation(finding.equation.clone()));
    }
    if let Some(gain) = finding.held_out {
        blocks.push(Block::Bars(gain_bars(&gain, unit)));
        blocks.push(Block::text(gain_words(&gain)));
    }
    if !finding.parameters.is_empty() {
        blocks.push(Block::Table(parameter_table("Parameters", &finding.parameters)));
    }
    let charts = charts(data, finding, unit, shading);
    if !charts.is_empty() {
        blocks.push(Block::Charts(charts));
    }
    if finding.status == "group" && finding.group.len() > 1 {
        let words = format!("These signals cannot tell apart: {}.", finding.group.join(", "));
        blocks.push(Block::Notice { tone: Tone::Neutral, text: words });
    }
    if !finding.alternatives.is_empty() {
        let mut table = Table::new("Alternatives that remain", &["Effect", "Probability"]);
        for (effect, probability) in &finding.alternatives {
            table.push(vec![Cell::Head(effect.clone()), Cell::Number(significant(*probability, 2))]);
        }
        blocks.push(Block::Table(table));
    }
    Block::Card { title, tag, blocks }
}

fn gain_bars(gain: &Gain, unit: &str) -> Bars {
    let bar = |label: &str, value: f64, interval, role| Bar {
        label: label.to_owned(),
        value,
        interval,
        text: format!("{} {unit}", significant(value, 3)),
        role,
    };
    // The reduction's interval, carried over to the error that is left.
    let left = gain.ci95.map(|(low, high)| (gain.before_rms * (1.0 - high), gain.before_rms * (1.0 - low)));
    Bars {
        caption: "Residual RMS on recordings it had not seen".to_owned(),
        bars: vec![bar("before", gain.before_rms, None, Role::Before), bar("after", gain.after_rms, left, Role::After)],
        full_scale: None,
    }
}

fn gain_words(gain: &Gain) -> String {
    let interval = |(low, high)| format!(" (95 % interval {} to {})", percent(low), percent(high));
    format!("Removes {} of the residual{}.", percent(gain.reduction), gain.ci95.map_or_else(String::new, interval))
}

/// The residual over each variable that locates the finding; over velocity where none does.
fn charts(data: &DiagnosisReportData, finding: &Finding, unit: &str, shading: &[Shading]) -> Vec<Chart> {
    let models = super::evidence::compared(data, false);
    let mut variables: Vec<&str> = Vec::new();
    for region in &finding.regions {
        if !variables.contains(&region.variable.as_str()) {
            variables.push(&region.variable);
        }
    }
    if variables.is_empty() && finding.intervals.is_empty() {
        variables.push("qd_rad_s");
    }
    let own: Vec<Shading> = finding
        .joints
        .iter()
        .map(|joint| Shading {
            joint: joint.clone(),
            regions: finding.regions.iter().map(|r| (r.variable.clone(), r.low, r.high)).collect(),
            intervals: Vec::new(),
            label: finding.effect.clone(),
        })
        .collect();
    let shown = if finding.regions.is_empty() { shading } else { &own };
    let over = |joint: &String| {
        let chart = |v: &&str| residual_over(&data.traces, joint, v, &models, unit, shown);
        variables.iter().filter_map(chart).collect::<Vec<_>>()
    };
    finding.joints.iter().flat_map(over).collect()
}

/// A region in words: "velocity −0.2 to 0.2 rad/s".
pub(super) fn region_words(region: &super::Region) -> String {
    let (label, unit) = variable_words(&region.variable);
    let edge = |v: f64, open: &str| if v.is_finite() { compact(v) } else { open.to_owned() };
    let words = format!("{label} {} to {} {unit}", edge(region.low, "lowest"), edge(region.high, "highest"));
    words.trim_end().to_owned()
}
