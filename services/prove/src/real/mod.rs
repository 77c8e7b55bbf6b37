//! Real recordings as found: what independent fits say of them, and whether the diagnosis says it too.

mod expected;

use crate::error::Error;
use crate::said::{Finding, Said};
use crate::section::{Aim, Figure, Section, Table, short};
use crate::{Options, Part, Watcher, Workplace};
use expected::{Expected, ROBOTS, Robot};
use lacuna_interfaces::RobotFile;
use lacuna_recording::load_robot;

const TITLE: &str = "Real recordings, as found";

/// One line of the table.
struct Seen {
    found: String,
    figure: String,
    met: bool,
}

/// Diagnoses the recordings of every robot and holds the findings against what is expected.
///
/// # Errors
/// [`Error`] if a robot file cannot be read.
pub fn prove(options: &Options, watcher: &mut dyn Watcher) -> Result<Section, Error> {
    let data = options.shared.join("data");
    if !data.is_dir() {
        return Ok(Section::skipped(Part::Real, TITLE, options, format!("no recordings at {}", data.display())));
    }
    let place = Workplace::new(options.out.as_deref(), "real")?;
    let mut section = head(options);
    let mut table = Table::new("Expected and found", &["robot", "expected", "found", "figure", "verdict"]);
    let mut errors = Table::new(
        "Torque error, held out, relative to the torque",
        &["robot", "base", "with what was found", "black box", "seconds", "verdict in its words"],
    );
    let robots = &ROBOTS[..options.cases.unwrap_or(ROBOTS.len()).min(ROBOTS.len())];
    for (k, robot) in robots.iter().enumerate() {
        watcher.at(k as f64 / robots.len() as f64, robot.folder);
        let folder = data.join(robot.folder);
        if !folder.is_dir() {
            section.conditions.push(format!("SKIPPED: no recordings at {}.", folder.display()));
            continue;
        }
        let folder = folder.canonicalize().map_err(crate::error::io("found", &folder))?;
        let file = load_robot(folder.join("robot.toml"))?.file;
        let files: Vec<String> = robot.files.iter().map(|f| (*f).to_owned()).collect();
        let out = place.folder(&format!("findings/{}", robot.folder))?;
        let answered = options.diagnosis.run(&folder, "robot.toml", &files, &out)?;
        errors.rows.push(errors_row(robot, answered.said.as_ref(), answered.seconds));
        for expected in robot.expected {
            let seen = match &answered.said {
                Ok(said) => check(expected, said, &file),
                Err(why) => Seen { found: why.clone(), figure: "-".to_owned(), met: false },
            };
            let words = expected.words(&file);
            if !seen.met {
                section
                    .failures
                    .push(format!("{}: expected {words}; found {} ({})", robot.folder, seen.found, seen.figure));
            }
            let verdict = if seen.met { "met" } else { "missed" }.to_owned();
            table.rows.push(vec![robot.folder.to_owned(), words, seen.found, seen.figure, verdict]);
        }
    }
    let met = table.rows.iter().filter(|r| r[4] == "met").count();
    section.figures.push(Figure::share("expected answers met", met, table.rows.len(), Aim::Least(1.0)));
    section.tables.push(table);
    section.tables.push(errors);
    Ok(section)
}

fn head(options: &Options) -> Section {
    Section {
        part: Part::Real.name().to_owned(),
        title: TITLE.to_owned(),
        command: options.command(Part::Real),
        conditions: vec![
            "Six robots, `lacuna diagnose` with its own choice of band, hold-out and moving threshold; nothing set by hand."
                .to_owned(),
            "Expected: what independent fits of the same recordings found (held out, conditioned for each robot); the \
             relative errors are of those conditions and only roughly comparable."
                .to_owned(),
        ],
        ..Section::default()
    }
}

fn percent(v: Option<f64>) -> String {
    v.filter(|v| v.is_finite()).map_or("-".to_owned(), |v| format!("{} %", short(100.0 * v, 3)))
}

fn errors_row(robot: &Robot, said: Result<&Said, &String>, seconds: f64) -> Vec<String> {
    let held = said.map(|s| s.held_out.clone()).unwrap_or_default();
    let verdict = said.map_or_else(Clone::clone, |s| s.verdict.clone());
    vec![
        robot.folder.to_owned(),
        percent(held.relative_before),
        percent(held.relative_after),
        percent(held.black_box_relative),
        short(seconds, 2),
        verdict,
    ]
}

/// What the findings say of one expectation.
fn check(expected: &Expected, said: &Said, robot: &RobotFile) -> Seen {
    match *expected {
        Expected::Named { effect, joints, gain } => named(said, effect, joints, gain),
        Expected::Orders { joints, orders } => ripple(said, robot, joints, orders),
        Expected::Absent { effect } => {
            let found: Vec<String> = said.named(effect).map(Finding::words).collect();
            let met = found.is_empty();
            Seen { found: if met { "absent".to_owned() } else { found.join(", ") }, figure: "-".to_owned(), met }
        }
        Expected::Error { most } => {
            let after = said.held_out.relative_after;
            let met = after.is_some_and(|a| a <= most);
            Seen { found: words(said), figure: percent(after), met }
        }
        Expected::Stiffness { joint, k } => {
            let finding = said.named("elasticity").find(|f| f.joints.iter().any(|j| j == joint));
            let value = finding.and_then(|f| f.parameter("k", Some(joint))).and_then(|p| p.value);
            let found = finding.map_or_else(|| words(said), Finding::words);
            let figure = value.map_or("-".to_owned(), |v| format!("{} Nm/rad", short(v, 3)));
            Seen { found, figure, met: value.is_some_and(|v| (v / k - 1.0).abs() <= 0.3) }
        }
        Expected::NotUniform { effect } => {
            let said_so = |text: &str| text.contains("uniform") || text.contains("differ");
            let excluded = said.excluded.iter().find(|e| e.effect == effect && said_so(&e.reason));
            let named = said.named(effect).find(|f| said_so(&f.sentence));
            let figure = excluded.map(|e| e.reason.clone()).or(named.map(|f| f.sentence.clone()));
            Seen {
                found: said.named(effect).next().map_or("not taken".to_owned(), Finding::words),
                met: figure.is_some(),
                figure: figure.unwrap_or_else(|| "-".to_owned()),
            }
        }
    }
}

fn words(said: &Said) -> String {
    let list: Vec<String> = said.findings.iter().map(Finding::words).collect();
    if list.is_empty() { "nothing".to_owned() } else { list.join(", ") }
}

fn named(said: &Said, effect: &str, joints: &[&str], gain: Option<f64>) -> Seen {
    let on = |f: &&Finding| {
        joints.is_empty() || f.joints.is_empty() || joints.iter().any(|j| f.joints.iter().any(|k| k == j))
    };
    let findings: Vec<&Finding> = said.named(effect).filter(on).collect();
    let everywhere =
        joints.iter().all(|j| findings.iter().any(|f| f.joints.is_empty() || f.joints.iter().any(|k| k == j)));
    let best = findings
        .iter()
        .filter_map(|f| f.held_out.and_then(|h| h.reduction))
        .fold(None, |most: Option<f64>, r| Some(most.map_or(r, |m| m.max(r))));
    let enough = gain.is_none_or(|g| best.is_some_and(|b| b >= g));
    let found = findings.iter().map(|f| f.words()).collect::<Vec<_>>().join(", ");
    Seen {
        found: if found.is_empty() { words(said) } else { found },
        figure: best.map_or("-".to_owned(), |b| format!("−{} %", short(100.0 * b, 3))),
        met: !findings.is_empty() && everywhere && enough,
    }
}

/// Orders per motor turn found on any of `joints`.
fn ripple(said: &Said, robot: &RobotFile, joints: &[&str], orders: &[f64]) -> Seen {
    let mut found: Vec<(String, f64)> = Vec::new();
    for finding in said.named("cogging") {
        for p in finding.parameters.iter().filter(|p| p.symbol == "h") {
            let joint = p.joint.clone().or_else(|| finding.joints.first().cloned()).unwrap_or_default();
            found.extend(p.value.map(|v| (joint, v)));
        }
    }
    let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.02;
    let has = |order: &f64, joint: &str| found.iter().any(|(j, h)| j == joint && near(*h, *order));
    let every: Vec<&str> = robot.joints.iter().map(String::as_str).collect();
    // With joints given each must have every order; without, any joint may.
    let hit = |order: &f64| match joints.is_empty() {
        true => every.iter().any(|j| has(order, j)),
        false => joints.iter().all(|j| has(order, j)),
    };
    let hits = orders.iter().filter(|o| hit(o)).count();
    let list: Vec<String> = found.iter().map(|(j, h)| format!("{} ({j})", short(*h, 3))).collect();
    Seen {
        found: if list.is_empty() { words(said) } else { format!("orders {}", list.join(", ")) },
        figure: format!("{hits} of {} orders", orders.len()),
        met: hits == orders.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(findings: &str) -> Said {
        let text = format!(
            r#"{{"schema": "lacuna.findings/1", "joints": ["a", "b"], "baseline": {{"rms_nm": [0.1]}},
            "mismatch": {{"detected": true}}, "findings": [{findings}],
            "excluded": [{{"effect": "load_friction", "reason": "gain differs between recordings: 3, 8 and 18 %"}}],
            "held_out": {{"before_rms_nm": [], "after_rms_nm": [], "relative_after": 0.16}}, "verdict": ""}}"#
        );
        Said::parse(&text).unwrap()
    }

    #[test]
    fn expectations_are_met_and_missed() {
        let robot =
            RobotFile::parse("kind = \"serial\"\nname = \"r\"\njoints = [\"a\", \"b\"]\n[[dh]]\n[[dh]]\n").unwrap();
        let s = said(
            r#"{"effect": "cogging", "joints": ["a"], "probability": 1.0, "parameters": [{"symbol": "h", "value": 7.05}]},
               {"effect": "load_friction", "joints": ["a", "b"], "probability": 0.9, "held_out": {"reduction": 0.2}}"#,
        );
        let met = |e: Expected| check(&e, &s, &robot).met;
        assert!(met(Expected::Orders { joints: &[], orders: &[7.0] }));
        assert!(met(Expected::Orders { joints: &["a"], orders: &[7.0] }));
        assert!(!met(Expected::Orders { joints: &["b"], orders: &[7.0] }));
        assert!(!met(Expected::Orders { joints: &[], orders: &[7.0, 14.0] }));
        assert!(met(Expected::Named { effect: "load_friction", joints: &["a", "b"], gain: Some(0.19) }));
        assert!(!met(Expected::Named { effect: "load_friction", joints: &["a"], gain: Some(0.3) }));
        assert!(!met(Expected::Named { effect: "stribeck", joints: &[], gain: None }));
        assert!(met(Expected::Absent { effect: "stribeck" }) && !met(Expected::Absent { effect: "cogging" }));
        assert!(met(Expected::Error { most: 0.177 }) && !met(Expected::Error { most: 0.156 }));
        assert!(met(Expected::NotUniform { effect: "load_friction" }));
        assert!(!met(Expected::Stiffness { joint: "a", k: 1e6 }));
    }
}
