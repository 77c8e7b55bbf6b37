//! From findings to their report: names and figures are carried over, nothing is computed anew.

use crate::{identify_report, words};
use lacuna_diagnose::evidence::Trace;
use lacuna_diagnose::findings::{Finding, Map, Parameter, Reduction, Region, Where};
use lacuna_diagnose::forward::HORIZON_S;
use lacuna_diagnose::{Findings, Options, Outcome};
use lacuna_physics::effects;
use lacuna_report::number::significant;
use lacuna_report::{
    BeforeAfterRow, DiagnosisReportData, Excluded, ForwardRow, Gain, HeatMap, JointTrace, Located, NamedSeries,
    NextExperiment, ParameterRow, Setup, Stretch, TimeInterval, TorqueTrace, Unknown,
};

/// The report's data. `started` says whether the start times of the recordings were known.
pub fn data(outcome: &Outcome, options: &Options, started: bool) -> DiagnosisReportData {
    let (f, evidence) = (&outcome.findings, &outcome.evidence);
    let unit = options.robot.torque_unit.symbol();
    let [low, high] = f.held_out.relative_after_ci95;
    DiagnosisReportData {
        robot: f.robot.clone(),
        torque_unit: unit.to_owned(),
        verdict: f.verdict.clone(),
        detected: f.mismatch.detected,
        significance: number(f.mismatch.significance),
        setup: setup(outcome, options, started),
        located: f.mismatch.r#where.iter().map(located).collect(),
        findings: f.findings.iter().map(finding).collect(),
        held_out: held_out(f),
        held_out_words: match f.held_out.split.as_str() {
            "files" => "on test data used neither to choose nor to fit".to_owned(),
            _ => "every fold predicted by a fit to the others".to_owned(),
        },
        relative_before: number(f.held_out.relative_before),
        relative_after: number(f.held_out.relative_after),
        relative_after_ci95: (low < high).then_some((low, high)),
        black_box_relative: number(f.held_out.black_box_relative),
        black_box: evidence.black_box.clone(),
        noise_relative: number(evidence.noise_relative),
        forward: forward(outcome),
        forward_words: evidence.forward.as_ref().map_or_else(String::new, |f| {
            format!(
                "How far the position is off after {} s that begin at the recorded state and are driven by the recorded torque; {} windows in which all joints move, to first order in the deviation.",
                significant(HORIZON_S, 2),
                f.windows
            )
        }),
        traces: evidence.traces.iter().map(|t| trace(t, &f.joints)).collect(),
        unknown: unknown(f, unit),
        excluded: f.excluded.iter().map(|e| Excluded { effect: e.effect.clone(), reason: e.reason.clone() }).collect(),
        next_experiment: f.next_experiment.as_ref().map(|n| NextExperiment {
            sentence: n.words.clone(),
            separates: n.separate.clone(),
            ..NextExperiment::default()
        }),
        warnings: evidence.warnings.clone(),
        repairs: identify_report::repairs(&f.repairs),
    }
}

fn forward(outcome: &Outcome) -> Vec<ForwardRow> {
    let Some(f) = &outcome.evidence.forward else { return Vec::new() };
    let row =
        |((joint, off), on): ((&String, &f64), &f64)| ForwardRow { joint: joint.clone(), off_rad: *off, on_rad: *on };
    outcome.findings.joints.iter().zip(&f.off_rad).zip(&f.on_rad).map(row).collect()
}

/// Torques of one stretch: the models from before to after, the black box beside them.
fn trace(t: &Trace, joints: &[String]) -> TorqueTrace {
    let series = |name: &str, values: &[f64]| NamedSeries { name: name.to_owned(), values: values.to_vec() };
    let joint = |(name, j): (&String, &lacuna_diagnose::evidence::JointTrace)| JointTrace {
        joint: name.clone(),
        measured: j.measured.clone(),
        q_rad: j.q_rad.clone(),
        qd_rad_s: j.qd_rad_s.clone(),
        variables: j.variables.iter().map(|(name, values)| series(variable(name), values)).collect(),
        models: vec![series("before", &j.before), series("after", &j.after), series("black box", &j.black_box)],
    };
    TorqueTrace {
        recording: t.recording.clone(),
        t_s: t.t_s.clone(),
        joints: joints.iter().zip(&t.joints).map(joint).collect(),
    }
}

fn number(v: f64) -> Option<f64> {
    v.is_finite().then_some(v)
}

fn setup(outcome: &Outcome, options: &Options, started: bool) -> Setup {
    let evidence = &outcome.evidence;
    let all = |list: &[lacuna_diagnose::split::Stretch]| -> Vec<Stretch> {
        // Whole recordings by their name alone; of those cut into folds the name is enough.
        let whole = options.conditioning.split.test.is_empty();
        let mut out: Vec<Stretch> = Vec::new();
        for s in list {
            let bound = |v: f64| (!whole).then_some(v);
            let stretch = Stretch { recording: s.recording.clone(), from_s: bound(s.from_s), to_s: bound(s.to_s) };
            if !out.contains(&stretch) {
                out.push(stretch);
            }
        }
        out
    };
    let start = if started { "as manifest.json says" } else { "one right after another: no manifest.json tells" };
    let split = &outcome.findings.held_out.split;
    let held = match split.as_str() {
        "files" => "test stretches, neither chosen nor fitted on".to_owned(),
        _ => format!(
            "{} ({} folds); each is predicted by a fit to the others, the terms were chosen on all",
            words::split(split),
            evidence.folds
        ),
    };
    let slow = evidence.slow_rad_s.iter().map(|v| significant(*v, 2)).collect::<Vec<_>>().join(", ");
    let mut further = vec![
        ("Held out".to_owned(), held),
        ("Left out".to_owned(), format!("rows slower than {slow} rad/s, joint by joint")),
        ("Start of the recordings".to_owned(), start.to_owned()),
        ("Seed".to_owned(), options.seed.to_string()),
    ];
    further.splice(0..0, evidence.simulator.iter().cloned());
    Setup {
        train: all(&evidence.train),
        test: all(&evidence.test),
        band_hz: number(evidence.band_hz),
        moving_rad_s: None,
        samples: Some(options.recordings.iter().map(|r| r.len() as u64).sum()),
        further,
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
        regions: regions(&f.region),
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
    let held = &f.held_out;
    let get = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(f64::NAN);
    let interval = |list: &[[f64; 2]], j: usize| list.get(j).filter(|[a, b]| a < b).map(|[a, b]| (*a, *b));
    let row = |(j, joint): (usize, &String)| BeforeAfterRow {
        joint: joint.clone(),
        before_rms: get(&held.before_rms_nm, j),
        after_rms: get(&held.after_rms_nm, j),
        before_ci95: interval(&held.before_ci95_nm, j),
        after_ci95: interval(&held.after_ci95_nm, j),
        black_box_rms: number(get(&held.black_box_rms_nm, j)),
        noise_floor: number(get(&f.baseline.noise_floor_nm, j)),
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
