//! Scores of hand-made findings, worked out by hand.

use super::*;
use crate::said::{Baseline, HeldOut, Mismatch, Parameter, Unknown};
use std::collections::BTreeMap;

fn finding(effect: &str, joints: &[&str], probability: f64) -> Finding {
    Finding {
        effect: effect.to_owned(),
        joints: joints.iter().map(|j| (*j).to_owned()).collect(),
        probability: Some(probability),
        group: Vec::new(),
        parameters: Vec::new(),
        held_out: None,
        intervals_s: Vec::new(),
        sentence: String::new(),
    }
}

fn said(findings: Vec<Finding>) -> Answered {
    let said = Said {
        schema: crate::said::SCHEMA.to_owned(),
        joints: ["q1", "q2", "q3"].map(str::to_owned).to_vec(),
        baseline: Baseline { rms_nm: vec![0.3, 0.4, 0.0] },
        mismatch: Mismatch { detected: !findings.is_empty() },
        held_out: HeldOut {
            before_rms_nm: vec![0.3, 0.4, 0.0],
            after_rms_nm: vec![0.1, 0.0, 0.0],
            relative_before: Some(0.1),
            relative_after: Some(0.02),
            black_box_relative: Some(0.03),
        },
        findings,
        unknown: Unknown::default(),
        excluded: Vec::new(),
        verdict: String::new(),
    };
    Answered { said: Ok(said), seconds: 2.0 }
}

fn effect(id: &str, joints: &[&str], rms: f64) -> Effect {
    Effect {
        id: id.to_owned(),
        joints: joints.iter().map(|j| (*j).to_owned()).collect(),
        rms_nm: Some(rms),
        ..Effect::default()
    }
}

fn hidden(effects: Vec<Effect>) -> Hidden {
    Hidden { effects, oracle_rms_nm: vec![0.05, 0.0, 0.0], ..Hidden::default() }
}

fn figure<'a>(section: &'a crate::section::Section, start: &str) -> &'a crate::section::Figure {
    section.figures.iter().find(|f| f.measure.starts_with(start)).unwrap_or_else(|| panic!("{start}"))
}

#[test]
fn a_right_name_a_group_an_accepted_name_and_a_wrong_one() {
    let truth = Effect { also_accept: vec!["torque_offset".to_owned()], ..effect("coulomb_asym", &["q1"], 0.1) };
    let grouped = Finding { group: vec!["x".to_owned(), "coulomb_asym".to_owned()], ..finding("x", &["q1"], 0.9) };
    for (f, fit) in [
        (finding("coulomb_asym", &["q1"], 0.9), Match::Name),
        (finding("torque_offset", &["q1"], 0.9), Match::Name),
        (grouped, Match::Group),
        (finding("stribeck", &["q1"], 0.9), Match::No),
        (finding("unknown", &["q1"], 0.9), Match::No),
    ] {
        assert_eq!(fits(&f, &truth), fit, "{}", f.effect);
    }
    let outside = Effect { unknown: true, ..effect("dent", &["q2"], 0.1) };
    assert_eq!(fits(&finding("unknown", &[], 0.9), &outside), Match::Name);
}

#[test]
fn base_friction_is_no_finding_unless_the_robot_has_none() {
    let answered = said(vec![finding("coulomb", &["q1"], 0.9), finding("viscous", &["q1"], 0.9)]);
    assert!(judge("clean", &hidden(vec![]), &answered).findings.is_empty());
    let frictionless = Hidden { frictionless: true, ..hidden(vec![effect("coulomb", &["q1"], 0.2)]) };
    let judged = judge("ideal", &frictionless, &answered);
    assert_eq!((judged.findings.len(), judged.wrong(), judged.first), (2, 1, Match::Name));
}

#[test]
fn the_scorecard_counts_what_was_worked_out_by_hand() {
    // Shares: 0.12 and 0.05 beside 0.05 of noise: 0.12/√(.0144+.0025+.0025) = .862, 0.05/.1393 = .359.
    let two = hidden(vec![effect("stribeck", &["q1", "q2"], 0.12), effect("cogging", &["q3"], 0.05)]);
    assert!((two.share(0).unwrap() - 0.8615).abs() < 1e-3 && (two.share(1).unwrap() - 0.3590).abs() < 1e-3);
    let dent = hidden(vec![Effect { unknown: true, ..effect("dent", &["q1"], 0.1) }]);
    let weak = hidden(vec![effect("payload", &[], 0.01)]);
    let cases = [
        judge("a", &hidden(vec![]), &said(vec![])),
        judge("b", &hidden(vec![]), &said(vec![finding("cogging", &["q1"], 0.6)])),
        judge("c", &two, &said(vec![finding("stribeck", &["q1"], 0.98), finding("backlash", &["q3"], 0.9)])),
        judge("d", &dent, &said(vec![finding("unknown", &["q1"], 0.9)])),
        judge("e", &weak, &Answered { said: Err("out of memory".to_owned()), seconds: 1.0 }),
    ];
    let mut s = crate::section::Section::default();
    section(&mut s, &cases);
    let value = |start: &str| figure(&s, start).value.unwrap_or(f64::NAN);
    assert_eq!(value("diagnoses that ended"), 0.2);
    assert_eq!(value("false alarms"), 0.5);
    assert!((value("mismatch detected") - 2.0 / 3.0).abs() < 1e-12);
    assert!((value("top-1:") - 2.0 / 3.0).abs() < 1e-12);
    // Hidden: stribeck (found), cogging (not), dent (found), payload (not).
    assert_eq!(value("recall:"), 0.5);
    assert_eq!(value("recall with all joints"), 0.25, "stribeck's second joint was missed");
    // Said: cogging on a clean robot and backlash are wrong, stribeck and unknown are not.
    assert_eq!(value("precision"), 0.5);
    assert_eq!(value("effects outside the catalogue"), 1.0);
    assert_eq!(value("catalogue effects alone"), 0.0);
    assert_eq!(value("effects with ≥ 30 %"), 0.5);
    assert_eq!(value("effects with 10–30 %"), 0.0, "0.01 beside 0.05 is a share of .196");
    // ECE over (.6, wrong), (.98, right), (.9, wrong): (.6 + .02 + .9)/3.
    assert!((value("probabilities") - 1.52 / 3.0).abs() < 1e-9, "{}", value("probabilities"));
    // after/oracle is .1/.05 wherever findings were made; the gain is (.5 − .1)/(.5 − .05).
    assert!((value("held-out residual") - 2.0).abs() < 1e-12);
    assert!((value("share of the true") - 0.4 / 0.45).abs() < 1e-12);
    assert_eq!(value("named model at least"), 1.0);
    assert_eq!(s.failures.len(), 3, "{:?}", s.failures);
    for part in ["b: hidden nothing", "c: hidden stribeck", "out of memory"] {
        assert!(s.failures.iter().any(|f| f.contains(part)), "{part}");
    }
    let row = s.tables[0].rows.iter().find(|r| r[0] == "stribeck").unwrap();
    assert_eq!(row[1..], ["1", "1", "1", "0", "1 of 1", "-", "-"].map(str::to_owned));
}

#[test]
fn intervals_are_compared_by_symbol_and_joint() {
    let parameter = |symbol: &str, joint: &str, value: f64, half: f64| Parameter {
        symbol: symbol.to_owned(),
        unit: String::new(),
        value: Some(value),
        ci95: Some([Some(value - half), Some(value + half)]),
        joint: Some(joint.to_owned()),
    };
    let truth = Effect {
        parameters: BTreeMap::from([("f_sc".to_owned(), 1.0), ("v_s".to_owned(), 0.1)]),
        ..effect("stribeck", &["q2"], 0.1)
    };
    let found = Finding {
        parameters: vec![
            parameter("f_sc", "q1", 5.0, 0.1),
            parameter("f_sc", "q2", 1.1, 0.2),
            parameter("v_s", "q1", 0.1, 0.001),
            parameter("v_s", "q2", 0.2, 0.05),
        ],
        ..finding("stribeck", &["q1", "q2"], 0.99)
    };
    let judged = judge("x", &hidden(vec![truth]), &said(vec![found]));
    let covers: Vec<(String, bool)> = judged.coverage.iter().map(|c| (c.what.clone(), c.covers())).collect();
    assert_eq!(covers, [("stribeck.f_sc".to_owned(), true), ("stribeck.v_s".to_owned(), false)]);
    assert!((judged.coverage[1].relative_error() - 1.0).abs() < 1e-9);
}

#[test]
fn a_payload_is_weighed_at_the_nearest_pick_of_its_file() {
    let file = |n: u32| format!("traj_{n:02}.csv");
    let truth = Hidden {
        carried: vec![(file(1), 1.0, 2.0, 2.0), (file(2), 0.5, 1.0, 2.0), (file(3), 1.0, 2.0, 2.0)],
        ..hidden(vec![effect("payload", &[], 1.0)])
    };
    let mass = Parameter {
        symbol: "m".to_owned(),
        unit: "kg".to_owned(),
        value: Some(2.1),
        ci95: Some([Some(1.95), Some(2.25)]),
        joint: None,
    };
    let found = Finding {
        parameters: vec![mass],
        intervals_s: vec![(file(1), 4.0, 5.0), (file(1), 1.25, 2.0), (file(2), 0.5, 1.0)],
        ..finding("payload", &[], 1.0)
    };
    let weighed = judge("x", &truth, &said(vec![found])).weighed;
    assert_eq!(weighed.len(), 2, "nothing was found in the third file");
    assert!((weighed[0].mass_error - 0.05).abs() < 1e-9 && (weighed[0].pick_error_s - 0.25).abs() < 1e-9);
    assert_eq!((weighed[1].pick_error_s, weighed[1].covered), (0.0, Some(true)));
}

#[test]
fn findings_with_unknown_keys_are_read_and_other_schemas_refused() {
    let text = r#"{"schema": "lacuna.findings/1", "joints": ["q1"], "baseline": {"rms_nm": [0.1], "extra": 1},
        "mismatch": {"detected": true, "where": []}, "new": {},
        "findings": [{"effect": "cogging", "probability": 0.5, "parameters": [{"symbol": "h", "value": null}]}],
        "held_out": {"before_rms_nm": [0.1], "after_rms_nm": [0.05]}, "unknown": {"share": 0.5}, "verdict": "v"}"#;
    let said = Said::parse(text).unwrap();
    assert_eq!(said.findings[0].effect, "cogging");
    assert!(said.says_unknown(), "more than 40 % unexplained");
    assert!(Said::parse(&text.replace("findings/1", "findings/9")).unwrap_err().to_string().contains("findings/9"));
    assert!(Said::parse("{}").is_err());
}
