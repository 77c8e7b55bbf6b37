//! From payload estimates to their report: names and figures are carried over, nothing is computed anew.

use crate::{identify_report, words};
use lacuna_identify::payload::{Interval, PayloadRun, Step, Trace};
use lacuna_interfaces::RobotFile;
use lacuna_report::{PayloadReportData, PayloadRow, PayloadTrace, Tone};

/// Most points of a curve in the report's data.
const POINTS: usize = 20_000;

/// The report's data.
pub fn data(robot: &RobotFile, model: &str, runs: &[PayloadRun], warnings: &[String]) -> PayloadReportData {
    let count: usize = runs.iter().map(|r| r.measured.len()).sum();
    let files: Vec<String> = runs.iter().map(|r| r.file.clone()).collect();
    let masses: Vec<String> =
        runs.iter().flat_map(|r| &r.measured).filter_map(|i| i.mass_kg).map(|m| format!("{m:.3} kg")).collect();
    let verdict = match &masses[..] {
        [] => format!("{}: no payload found.", robot.name),
        [one] => format!("{}: one payload, {one}.", robot.name),
        _ => format!("{}: {}: {}.", robot.name, words::count(count, "payload"), masses.join(", ")),
    };
    let table = |r: &PayloadRun| {
        identify_report::error_table(&format!("Torque error over {}, moving samples", r.file), &r.table2, &robot.joints)
    };
    PayloadReportData {
        robot: robot.name.clone(),
        torque_unit: robot.torque_unit.symbol().to_owned(),
        verdict,
        tone: if warnings.is_empty() { Tone::Neutral } else { Tone::Caution },
        facts: vec![("Model".to_owned(), model.to_owned()), ("Recordings".to_owned(), files.join(", "))],
        rows: rows(runs),
        traces: traces(runs),
        tables: runs.iter().filter_map(table).collect(),
        warnings: warnings.to_vec(),
        repairs: identify_report::repairs(&runs.iter().flat_map(|r| r.repairs.clone()).collect::<Vec<_>>()),
    }
}

/// What was carried, from the measured and from the simulated torque.
pub fn rows(runs: &[PayloadRun]) -> Vec<PayloadRow> {
    let row = |file: &str, source: &str, i: &Interval| PayloadRow {
        recording: file.to_owned(),
        source: source.to_owned(),
        picked_s: i.picked_s,
        placed_s: i.placed_s,
        mass_kg: i.mass_kg,
        sd_kg: i.sd_kg,
        known_kg: i.known_kg,
        settled_after_s: i.settled_after_s,
        zero_after_s: i.zero_after_s,
    };
    let measured = runs.iter().flat_map(|r| r.measured.iter().map(|i| row(&r.file, "measured torque", i)));
    let simulated = runs.iter().flat_map(|r| r.simulated.iter().map(|i| row(&r.file, "simulated torque", i)));
    measured.chain(simulated).collect()
}

const MEASURED: &str = "measured torque";
const SIMULATED: &str = "simulated torque of the model";

/// The estimates over time (the paper's Fig. 8).
pub fn traces(runs: &[PayloadRun]) -> Vec<PayloadTrace> {
    let of = |r: &PayloadRun| {
        let known = r.measured.iter().all(|i| i.times_known && i.known_kg.is_some()) && !r.measured.is_empty();
        [(MEASURED, &r.trace), (SIMULATED, &r.simulated_trace)]
            .map(|(source, t)| trace(&format!("the {source}, {}", r.file), t, &r.carried, known))
    };
    runs.iter().flat_map(of).collect()
}

fn trace(source: &str, trace: &Trace, carried: &[Step], known: bool) -> PayloadTrace {
    let step = trace.t_s.len().div_ceil(POINTS).max(1);
    let t_s: Vec<f64> = trace.t_s.iter().copied().step_by(step).collect();
    let at = |t: &f64| carried.iter().rev().find(|s| s.from_s <= *t).map_or(0.0, |s| s.mass_kg);
    PayloadTrace {
        source: source.to_owned(),
        true_kg: t_s.iter().map(at).collect(),
        estimate_kg: trace.mass_kg.iter().copied().step_by(step).collect(),
        t_s,
        known,
    }
}
