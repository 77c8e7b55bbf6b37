//! From findings to their report: names and figures are carried over, nothing is computed anew.

use crate::{identify_report, words};
use lacuna_diagnose::findings::{Finding, Map, Parameter, Reduction, Region, Where};
use lacuna_diagnose::{Findings, Options, Outcome};
use lacuna_physics::effects;
use lacuna_report::{
    BeforeAfterRow, DiagnosisReportData, Excluded, Gain, HeatMap, Located, NextExperiment, ParameterRow, Setup,
    Stretch, TimeInterval, Unknown,
};

/// The report's data. `started` says whether the start times of the recordings were known.
pub fn data(outcome: &Outcome, options: &Options, started: bool) -> DiagnosisReportData {
    let f = &outcome.findings;
    let unit = options.robot.torque_unit.symbol();
    DiagnosisReportData {
        robot: f.robot.clone(),
        torque_unit: unit.to_owned(),
        verdict: f.verdict.clone(),
        detected: f.mismatch.detected,
        significance: number(f.mismatch.significance),
        setup: setup(options, started),
        located: f.mismatch.r#where.iter().map(located).collect(),
        findings: f.findings.iter().map(finding).collect(),
        held_out: held_out(f),
        relative_before: number(f.held_out.relative_before),
        relative_after: number(f.held_out.relative_after),
        relative_after_ci95: None,
        black_box_relative: number(f.held_out.black_box_relative),
        black_box: String::new(),
        noise_relative: None,
        forward: Vec::new(),
        traces: Vec::new(),
        unknown: unknown(f, unit),
        excluded: f.excluded.iter().map(|e| Excluded { effect: e.effect.clone(), reason: e.reason.clone() }).collect(),
        next_experiment: f.next_experiment.as_ref().map(|n| NextExperiment {
            sentence: n.words.clone(),
            separates: n.separate.clone(),
            ..NextExperiment::default()
        }),
        warnings: Vec::new(),
        repairs: identify_report::repairs(&f.repairs),
    }
}

fn number(v: f64) -> Option<f64> {
    v.is_finite().then_some(v)
}

fn setup(options: &Options, started: bool) -> Setup {
    let all = || options.recordings.iter().map(|r| Stretch { recording: r.name.clone(), from_s: None, to_s: None });
    let start = if started { "as manifest.json says" } else { "one right after another: no manifest.json tells" };
    Setup {
        train: all().collect(),
        test: Vec::new(),
        band_hz: options.conditioning.band_hz,
        moving_rad_s: options.conditioning.moving_rad_s,
        samples: Some(options.recordings.iter().map(|r| r.len() as u64).sum()),
        further: vec![
            ("Held out".to_owned(), format!("part by part of {}", words::count(options.recordings.len(), "recording"))),
            ("Start of the recordings".to_owned(), start.to_owned()),
            ("Seed".to_owned(), options.seed.to_string()),
        ],
    }
}

/// A variable of findings.json as the report names it.
fn variable(name: &str) -> &str {
    match name {
        "load_nm" => "tau_nm",
        "temperature_degc" => "temperature_c",
        "order_per_rev" => "order",
        other => other,
    }
}

fn regions(list: &[Region]) -> Vec<lacuna_report::Region> {
    list.iter()
        .map(|r| lacuna_report::Region { variable: variable(&r.variable).to_owned(), low: r.low, high: r.high })
        .collect()
}

fn intervals(list: &[(String, f64, f64)]) -> Vec<TimeInterval> {
    list.iter()
        .map(|(recording, from_s, to_s)| TimeInterval { recording: recording.clone(), from_s: *from_s, to_s: *to_s })
        .collect()
}

fn located(w: &Where) -> Located {
    Located {
        joint: w.joint.clone(),
        share: w.share,
        size: number(w.rms_nm),
        stage: w.stage.clone(),
        regions: regions(&w.region),
        intervals: intervals(&w.intervals_s),
    }
}

fn finding(f: &Finding) -> lacuna_report::Finding {
    lacuna_report::Finding {
        effect: f.effect.clone(),
        title: effects::find(&f.effect).map_or_else(String::new, |e| e.title.to_owned()),
        joints: f.joints.clone(),
        probability: number(f.probability),
        status: f.status.clone(),
        sentence: f.sentence.clone(),
        equation: f.equation.clone(),
        group: f.group.clone(),
        alternatives: f.alternatives.iter().map(|a| (a.effect.clone(), a.probability)).collect(),
        parameters: f.parameters.iter().map(parameter).collect(),
        held_out: Some(gain(&f.held_out)),
        regions: Vec::new(),
        intervals: intervals(&f.intervals_s),
    }
}

fn parameter(p: &Parameter) -> ParameterRow {
    let [low, high] = p.ci95;
    ParameterRow {
        symbol: p.symbol.clone(),
        joint: p.joint.clone().unwrap_or_default(),
        unit: p.unit.clone(),
        value: p.value,
        // An interval of no width is no interval.
        ci95: (low < high).then_some((low, high)),
        ..ParameterRow::default()
    }
}

fn gain(g: &Reduction) -> Gain {
    let [low, high] = g.ci95;
    Gain {
        before_rms: g.before_rms_nm,
        after_rms: g.after_rms_nm,
        reduction: g.reduction,
        ci95: (low < high).then_some((low, high)),
    }
}

fn held_out(f: &Findings) -> Vec<BeforeAfterRow> {
    let get = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(f64::NAN);
    let row = |(j, joint): (usize, &String)| BeforeAfterRow {
        joint: joint.clone(),
        before_rms: get(&f.held_out.before_rms_nm, j),
        after_rms: get(&f.held_out.after_rms_nm, j),
        noise_floor: number(get(&f.baseline.noise_floor_nm, j)),
        ..BeforeAfterRow::default()
    };
    f.joints.iter().enumerate().map(row).collect()
}

fn unknown(f: &Findings, unit: &str) -> Option<Unknown> {
    let u = &f.unknown;
    if !u.flag && u.map.is_none() && u.expression.is_none() {
        return None;
    }
    let sentence = match &u.r#where {
        Some(w) => format!("What is left lies on joint {}, in the {} stage.", w.joint, w.stage),
        None => String::new(),
    };
    Some(Unknown {
        share: u.share,
        sentence,
        expression: u.expression.clone().unwrap_or_default(),
        map: u.map.as_ref().and_then(|m| heat_map(m, unit)),
    })
}

/// Mean torque over one variable, moving forwards above, backwards below.
fn heat_map(map: &Map, unit: &str) -> Option<HeatMap> {
    let (first, last) = (map.at.first()?, map.at.last()?);
    let half = if map.at.len() > 1 { 0.5 * (last - first) / (map.at.len() - 1) as f64 } else { 0.5 };
    let row = |list: &[Option<f64>]| list.iter().map(|v| v.unwrap_or(f64::NAN)).collect();
    Some(HeatMap {
        caption: format!("Torque of {} that no named effect explains", map.joint),
        x_label: map.variable.clone(),
        y_label: "direction".to_owned(),
        value_label: format!("Mean residual [{unit}]"),
        x_range: (first - half, last + half),
        y_range: (-1.0, 1.0),
        rows: vec![row(&map.backward_nm), row(&map.forward_nm)],
    })
}
