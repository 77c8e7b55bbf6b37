//! From an identification to its report: names and figures are carried over, nothing is computed anew.

use crate::{payload_report, words};
use lacuna_identify::forward::Predicted;
use lacuna_identify::outcome::{Identification, JointCurves, ReportData};
use lacuna_identify::paper::{ErrorTable as Errors, PaperResult};
use lacuna_identify::split::TimeRange;
use lacuna_identify::{InstrumentCheck, InstrumentMotion, Outcome};
use lacuna_interfaces::Repair;
use lacuna_report::number::{compact, percent, significant};
use lacuna_report::{
    ConditionRow, ErrorTable, ForwardErrors, HeldOutRow, IdentificationReportData, JointTrace, MethodRow, NamedSeries,
    NotExcited, ParameterRow, RepairRow, Setup, Stretch, Tone, TorqueTrace,
};
use std::ops::Range;

/// Condition number of a fit above which it is in doubt: the identification warns from here on.
const DOUBTFUL_CONDITION: f64 = 1e3;

/// The report's data.
pub fn data(outcome: &Outcome) -> IdentificationReportData {
    let id = &outcome.identification;
    IdentificationReportData {
        robot: id.robot.clone(),
        torque_unit: id.torque_unit.clone(),
        method: method(&id.method).to_owned(),
        verdict: verdict(id),
        tone: tone(id),
        setup: setup(id),
        relative_error: Some(id.held_out.score.relative_error),
        relative_error_ci95: None,
        relative_error_nominal: id.held_out.nominal_relative_error,
        held_out: held_out(id),
        methods: methods(id),
        traces: traces(&outcome.report, &id.held_out.split),
        parameters: id.paper.as_ref().map_or_else(|| parameters(id), |p| paper_parameters(p, id)),
        not_excited: not_excited(id),
        conditioning: conditions(id),
        table_1: id.paper.as_ref().and_then(|p| {
            error_table("Table 1 of the paper: torque error over the held-out recordings", &p.table1, &id.joints)
        }),
        table_2: table_2(id),
        payload: payload_report::traces(&id.payload),
        payload_rows: payload_report::rows(&id.payload),
        forward: forward(id),
        warnings: id.warnings.clone(),
        repairs: repairs(&id.repairs),
    }
}

fn table_2(id: &Identification) -> Option<ErrorTable> {
    let caption = "Table 2 of the paper: torque error over the recordings with a payload, moving samples";
    match (&id.paper, &id.payload[..]) {
        (Some(paper), _) => error_table(caption, &paper.table2, &id.joints),
        (None, [one]) => {
            error_table(&format!("Torque error over {}, moving samples", one.file), &one.table2, &id.joints)
        }
        _ => None,
    }
}

fn forward(id: &Identification) -> Option<ForwardErrors> {
    let forward = id.forward.as_ref()?;
    let last = |p: &Predicted| p.rms_rad.last().cloned().unwrap_or_default();
    let nominal = forward.nominal.as_ref().map(|n| ("Robot file".to_owned(), last(n)));
    let mut failed = match forward.identified.failed {
        0 => String::new(),
        n => format!(" In {} more the identified model could not be simulated.", words::count(n, "window")),
    };
    match (&forward.nominal, id.held_out.nominal_relative_error) {
        (Some(n), _) if n.failed > 0 => {
            failed += &format!(" The robot file's model could not be simulated in {} of them.", n.failed);
        }
        (None, Some(_)) => failed += " The robot file's model cannot be simulated: a joint has no inertia of its own.",
        _ => {}
    }
    let note = format!(
        "{} of held-out motion, each started at the measured state and driven by the measured torque; the robot file \
         has no friction; velocity held is no model at all.{failed}",
        words::count(forward.identified.windows, "window")
    );
    Some(ForwardErrors {
        horizons_s: forward.horizons_s.clone(),
        joints: id.joints.clone(),
        identified: forward.identified.rms_rad.clone(),
        others: nominal.into_iter().chain([("Velocity held".to_owned(), last(&forward.held_velocity))]).collect(),
        note,
    })
}

fn method(name: &str) -> &str {
    match name {
        "pooled" => "all base parameters and friction of all joints in one weighted, robust fit",
        "paper" => "the paper's grid search for ρ1 and ρ2, least squares for friction, averages over recordings",
        other => other,
    }
}

/// How good the model is, in one sentence.
pub fn verdict(id: &Identification) -> String {
    let held = &id.held_out;
    let own = match held.nominal_relative_error {
        Some(nominal) => format!("; the robot file alone, without friction, misses {}", percent(nominal)),
        None => String::new(),
    };
    let where_ = if held.moving_only { "while the joints move, " } else { "" };
    let error = percent(held.score.relative_error);
    format!(
        "{}: {where_}the identified model misses {error} of the torque (RMS) on data it had not seen{own}.",
        id.robot
    )
}

fn tone(id: &Identification) -> Tone {
    let error = id.held_out.score.relative_error;
    if error.is_nan() || error >= 1.0 || id.held_out.nominal_relative_error.is_some_and(|nominal| error >= nominal) {
        Tone::Problem
    } else if id.warnings.is_empty() {
        Tone::Good
    } else {
        Tone::Caution
    }
}

fn setup(id: &Identification) -> Setup {
    let held = &id.held_out;
    let mut further = vec![("Held out".to_owned(), words::split(&held.split))];
    let mut add = |label: &str, value: String| further.push((label.to_owned(), value));
    if held.folds.len() > 1 {
        add("Error of every part held out", held.folds.iter().map(|f| percent(*f)).collect::<Vec<_>>().join(", "));
    }
    if let Some(error) = held.with_standstill {
        add("Error with standing joints fitted and counted", percent(error));
    }
    add("Low-pass on positions", format!("{} Hz, before differentiation", compact(id.conditioning.position_band_hz)));
    if let Some(delay) = id.delay {
        let [late, doubt, undone] =
            [delay.delay_s, 2.0 * delay.standard_error_s, delay.undone_s].map(|s| significant(1e3 * s, 3));
        add("Torque later than position", format!("{late} ± {doubt} ms, after undoing {undone} ms"));
    }
    let bristles: Vec<String> = (id.joints.iter().zip(&id.bristle_rad))
        .filter_map(|(joint, width)| width.map(|w| format!("{joint} {} rad", compact(w))))
        .collect();
    if !bristles.is_empty() {
        add("Coulomb friction builds up over", bristles.join(", "));
    }
    if let Some(i) = &id.instruments {
        add("Encoder noise in the accelerations", instruments(i));
    }
    if let Some(c) = &id.consistency {
        let more = percent(c.training_residual_ratio - 1.0);
        add("Physically consistent", format!("every link can exist; this costs {more} of training residual"));
    }
    add("Intervals", format!("95 %, from {} of time", words::count(id.blocks, "block")));
    if held.moving_only {
        add("Model in the charts", "where the joint counts; a gap is where it stands or the drive is off".to_owned());
    }
    add("Time in the charts", "since the first sample of each recording that was used".to_owned());
    Setup {
        train: held.train.iter().map(stretch).collect(),
        test: held.test.iter().map(stretch).collect(),
        band_hz: Some(held.band_hz),
        moving_rad_s: held.moving_only.then_some(held.moving_rad_s),
        samples: id.rows.iter().max().map(|n| *n as u64),
        further,
    }
}

/// Which instruments were used, if any.
fn instruments(check: &InstrumentCheck) -> String {
    let motion = match check.motion {
        InstrumentMotion::Smoothed => format!("the measured motion below {} Hz", compact(check.band_hz)),
        InstrumentMotion::Resimulated => "the motion re-simulated from the command".to_owned(),
    };
    let apart = format!("{} differs by {} standard errors", check.symbol, significant(check.statistic.abs(), 2));
    match check.used {
        true => format!("parameters by instruments from {motion}; from least squares {apart}"),
        false => format!(
            "least squares; instruments from {motion} say the same ({apart}, by chance up to {})",
            significant(check.threshold, 2)
        ),
    }
}

fn stretch(range: &TimeRange) -> Stretch {
    Stretch { recording: range.file.clone(), from_s: Some(range.from_s), to_s: Some(range.to_s) }
}

fn held_out(id: &Identification) -> Vec<HeldOutRow> {
    let score = &id.held_out.score;
    let get = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(f64::NAN);
    let row = |(j, joint): (usize, &String)| HeldOutRow {
        joint: joint.clone(),
        rms: get(&score.rms_nm, j),
        mean: get(&score.mean_nm, j),
        std: get(&score.std_nm, j),
        relative_error: get(&score.relative_error_per_joint, j),
        noise_floor: None,
    };
    id.joints.iter().enumerate().map(row).collect()
}

fn methods(id: &Identification) -> Vec<MethodRow> {
    let row = |name: &str, relative_error, rms: &[f64], note: &str| MethodRow {
        name: name.to_owned(),
        relative_error,
        rms: rms.to_vec(),
        note: note.to_owned(),
    };
    let mut rows = Vec::new();
    if let Some(error) = id.held_out.nominal_relative_error {
        rows.push(row("robot file", error, &[], "nominal masses, no friction"));
    }
    let mut note = "";
    if let Some(consistency) = &id.consistency {
        rows.push(row(
            "unconstrained",
            consistency.free_relative_error,
            &[],
            "the fit alone, whether such links can exist or not",
        ));
        note = "all inertias physically possible";
    }
    if !rows.is_empty() {
        rows.push(row("identified", id.held_out.score.relative_error, &id.held_out.score.rms_nm, note));
    }
    rows
}

fn parameters(id: &Identification) -> Vec<ParameterRow> {
    id.parameters
        .iter()
        .map(|p| ParameterRow {
            symbol: p.symbol.clone(),
            joint: String::new(),
            meaning: p.meaning.clone(),
            unit: p.unit.clone(),
            value: p.value,
            ci95: Some((p.ci95[0], p.ci95[1])),
            nominal: p.nominal,
            merged_with: p.merged_with.iter().map(|m| format!("{} {}", compact(m.factor), m.symbol)).collect(),
        })
        .collect()
}

/// ρ1, ρ2 and friction as the paper averages them; the paper gives no intervals.
fn paper_parameters(paper: &PaperResult, id: &Identification) -> Vec<ParameterRow> {
    let row = |symbol: &str, joint: &str, meaning: &str, unit: String, value: f64| ParameterRow {
        symbol: symbol.to_owned(),
        joint: joint.to_owned(),
        meaning: meaning.to_owned(),
        unit,
        value,
        ..ParameterRow::default()
    };
    let mut rows = vec![
        row("ρ1", "", "factor on the inertia term", String::new(), paper.rho1),
        row("ρ2", "", "factor on the gravity term", String::new(), paper.rho2),
    ];
    let unit = &id.torque_unit;
    for (joint, value) in id.joints.iter().zip(&paper.f_v) {
        rows.push(row("f_v", joint, "viscous friction", format!("{unit} s/rad"), *value));
    }
    for (joint, value) in id.joints.iter().zip(&paper.f_c) {
        rows.push(row("f_c", joint, "Coulomb friction", unit.clone(), *value));
    }
    rows
}

/// The paper's model has fixed parameters; what the data excite concerns the pooled fit alone.
fn not_excited(id: &Identification) -> Vec<NotExcited> {
    let of =
        |n: &lacuna_identify::outcome::NotExcited| NotExcited { symbol: n.symbol.clone(), reason: n.reason.clone() };
    if id.paper.is_some() { Vec::new() } else { id.not_excited.iter().map(of).collect() }
}

fn conditions(id: &Identification) -> Vec<ConditionRow> {
    let c = &id.condition_numbers;
    let fitted = match c.by_qr {
        true => "these recordings, the columns that were fitted (by QR)",
        false => "these recordings, the columns that were fitted",
    };
    let row = |what: &str, value, limit| ConditionRow { what: what.to_owned(), value, limit };
    vec![
        row("the robot's base columns at random motions", c.structure, None),
        row("these recordings, all base columns", c.data, None),
        row(fitted, c.fitted, Some(DOUBTFUL_CONDITION)),
    ]
}

/// μ and σ per joint and model; `None` without a model.
pub fn error_table(caption: &str, models: &[Errors], joints: &[String]) -> Option<ErrorTable> {
    if models.is_empty() {
        return None;
    }
    let get = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(f64::NAN);
    let of = |j: usize| models.iter().map(|m| (get(&m.mean_nm, j), get(&m.std_nm, j))).collect();
    Some(ErrorTable {
        caption: caption.to_owned(),
        models: models.iter().map(|m| m.model.clone()).collect(),
        joints: joints.to_vec(),
        errors: (0..joints.len()).map(of).collect(),
    })
}

/// The repairs, one row per file and kind.
pub fn repairs(list: &[Repair]) -> Vec<RepairRow> {
    let row = |r: &Repair| RepairRow {
        file: r.file.clone(),
        kind: format!("{}: {}", r.signal, words::repair(r.kind)),
        count: r.count,
    };
    list.iter().map(row).collect()
}

/// One trace per recording and side of the split, what was held out first.
fn traces(report: &ReportData, split: &str) -> Vec<TorqueTrace> {
    let mut held_out = Vec::new();
    let mut trained = Vec::new();
    for (range, name) in pieces(report) {
        let side = |wanted: bool| -> Vec<usize> {
            range.clone().filter(|&k| report.held_out.get(k).copied().unwrap_or(false) == wanted).collect()
        };
        let (tests, trains) = (side(true), side(false));
        // Where everything is held out in turn, the rest are the seams between the parts.
        let seams = split != "files";
        let label = |word: &str| if seams { name.clone() } else { format!("{name} ({word})") };
        if !tests.is_empty() {
            held_out.push(trace(report, label("held out"), range.start, &tests));
        }
        if !trains.is_empty() && !seams {
            trained.push(trace(report, label("training"), range.start, &trains));
        }
    }
    held_out.append(&mut trained);
    held_out
}

/// Index range and name of every recording. A recording's start is computed another way than the time of its first
/// point, so they may differ in the last bit.
fn pieces(report: &ReportData) -> Vec<(Range<usize>, String)> {
    const BIT_S: f64 = 1e-6;
    let begin = |start: f64| report.time_s.partition_point(|t| *t < start - BIT_S);
    let mut out = Vec::new();
    for (i, (start, name)) in report.recordings.iter().enumerate() {
        let end = report.recordings.get(i + 1).map_or(report.time_s.len(), |(next, _)| begin(*next));
        out.push((begin(*start)..end, name.clone()));
    }
    out
}

fn trace(report: &ReportData, recording: String, first: usize, points: &[usize]) -> TorqueTrace {
    let start = report.time_s.get(first).copied().unwrap_or(0.0);
    TorqueTrace {
        recording,
        t_s: points.iter().filter_map(|&k| report.time_s.get(k)).map(|t| t - start).collect(),
        joints: report.joints.iter().map(|curves| joint(curves, points)).collect(),
    }
}

fn joint(curves: &JointCurves, points: &[usize]) -> JointTrace {
    let pick =
        |list: &[f32]| -> Vec<f64> { points.iter().filter_map(|&k| list.get(k)).map(|v| f64::from(*v)).collect() };
    let counts = |k: &usize| curves.counted.get(*k).copied().unwrap_or(false);
    // A standing joint holds any torque within its stiction: what the model says there is not judged, nor drawn.
    let judged =
        |list: &[f32]| points.iter().zip(pick(list)).map(|(k, v)| if counts(k) { v } else { f64::NAN }).collect();
    let nominal = NamedSeries { name: "robot file".to_owned(), values: judged(&curves.nominal_nm) };
    let identified = NamedSeries { name: "identified".to_owned(), values: judged(&curves.model_nm) };
    JointTrace {
        joint: curves.joint.clone(),
        measured: pick(&curves.measured_nm),
        q_rad: Vec::new(),
        qd_rad_s: pick(&curves.qd_rad_s),
        variables: Vec::new(),
        models: if curves.nominal_nm.is_empty() { vec![identified] } else { vec![nominal, identified] },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two recordings of three points; the second's start differs from its first point in the last bit.
    fn report(held_out: [bool; 6]) -> ReportData {
        let curves = JointCurves {
            joint: "q1".to_owned(),
            measured_nm: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
            model_nm: vec![0.5; 6],
            nominal_nm: vec![0.25; 6],
            qd_rad_s: vec![1.0; 6],
            counted: vec![true, true, true, true, false, true],
            bin_qd_rad_s: Vec::new(),
            bin_residual_nm: Vec::new(),
            bin_std_nm: Vec::new(),
        };
        ReportData {
            torque_unit: "Nm".to_owned(),
            time_s: vec![0.0, 0.1, 0.2, 0.3 - 1e-16, 0.4, 0.5],
            recordings: vec![(0.0, "a.csv".to_owned()), (0.3, "b.csv".to_owned())],
            held_out: held_out.to_vec(),
            joints: vec![curves],
        }
    }

    #[test]
    fn traces_follow_the_recordings() {
        let all = traces(&report([true; 6]), "recordings");
        assert_eq!(all.iter().map(|t| t.recording.as_str()).collect::<Vec<_>>(), ["a.csv", "b.csv"]);
        assert_eq!(all[1].joints[0].measured, [3.0, 4.0, 5.0]);
        assert_eq!(all[1].t_s[0], 0.0);
        let [nominal, identified] = &all[1].joints[0].models[..] else { panic!("two models") };
        assert_eq!((nominal.name.as_str(), nominal.values[0]), ("robot file", 0.25));
        let model = &identified.values;
        assert!(model[0] == 0.5 && model[1].is_nan(), "what is not judged is not drawn: {model:?}");
    }

    #[test]
    fn what_was_held_out_comes_first_and_is_told_apart() {
        let split = traces(&report([false, false, false, false, true, true]), "files");
        let names: Vec<&str> = split.iter().map(|t| t.recording.as_str()).collect();
        assert_eq!(names, ["b.csv (held out)", "a.csv (training)", "b.csv (training)"]);
        assert_eq!(split[0].joints[0].measured, [4.0, 5.0]);
        // The seam between two halves is no training data of its own.
        let halves = traces(&report([true, true, true, true, false, true]), "halves");
        assert_eq!(halves.iter().map(|t| t.t_s.len()).collect::<Vec<_>>(), [3, 2]);
    }
}
