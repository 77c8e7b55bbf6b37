//! What `diagnose` puts out: findings against their schema, splits that are nested, a simulator to compare with, and
//! one line for input that cannot be used. The robots are the simulator's, which shares no code with the estimator.

use lacuna_diagnose::{Conditioning, Findings, Holdout, Options, Outcome, Span, Split, diagnose};
use lacuna_estimation::filter::{Stencil, ZeroPhase, differentiate};
use lacuna_interfaces::{Joints, MAX_JOINTS, ModelFile, Recording};
use lacuna_physics::Motion;
use lacuna_physics::effects::{EffectContext, TermInput, build_terms};
use lacuna_simulate::case::{Case, CaseOptions, draw_case};
use lacuna_simulate::simulate;
use serde_json::Value;

fn drawn(ids: &[&str], seed: u64, mass_error: f64) -> Case {
    let options = CaseOptions {
        effects: ids.len(),
        ids: ids.iter().map(|s| (*s).to_owned()).collect(),
        severity: [1.0, 1.0],
        mass_error,
        trajectories: 5,
        duration_s: 3.0,
        ..CaseOptions::default()
    };
    draw_case(seed, &options).unwrap()
}

fn options(case: &Case) -> Options {
    let simulation = simulate(&case.robot, None, &case.config).unwrap();
    let conditioning = Conditioning {
        start_s: simulation.manifest.files.iter().map(|f| f.start_time_s).collect(),
        ..Conditioning::default()
    };
    let recordings = simulation.recordings;
    Options { robot: case.robot.clone(), urdf: None, recordings, sim: Vec::new(), conditioning, seed: 1 }
}

fn run(options: &Options) -> Outcome {
    diagnose(options, &mut |_, _| {}).unwrap()
}

fn ids(findings: &Findings) -> Vec<&str> {
    findings.findings.iter().map(|f| f.effect.as_str()).collect()
}

/// Every key of the schema with its kind, and what must hold between them.
fn check_schema(findings: &Findings, joints: usize) {
    let json: Value = serde_json::from_str(&serde_json::to_string(findings).unwrap()).unwrap();
    let numbers = |v: &Value, n: usize, what: &str| {
        let list = v.as_array().unwrap_or_else(|| panic!("{what} is no list"));
        assert_eq!(list.len(), n, "{what}");
        list.iter().map(|x| x.as_f64().unwrap_or_else(|| panic!("{what}: {x} is no number"))).collect::<Vec<f64>>()
    };
    let rising = |v: &Value, what: &str| {
        let ends = numbers(v, 2, what);
        assert!(ends[0] < ends[1], "{what} has no width: {ends:?}");
    };
    assert_eq!(json["schema"], "lacuna.findings/1");
    assert_eq!(numbers(&json["baseline"]["rms_nm"], joints, "baseline.rms_nm").len(), joints);
    numbers(&json["baseline"]["noise_floor_nm"], joints, "baseline.noise_floor_nm");
    assert!(json["baseline"]["relative_error"].is_number());
    let significance = json["mismatch"]["significance"].as_f64().unwrap();
    assert!(significance > 0.0 && significance <= 1.0);
    let list = json["findings"].as_array().unwrap();
    assert_eq!(json["mismatch"]["detected"], !list.is_empty());
    let located = json["mismatch"]["where"].as_array().unwrap();
    assert_eq!(located.is_empty(), list.is_empty());
    for place in located {
        assert!(json["joints"].as_array().unwrap().contains(&place["joint"]));
        assert!(place["share"].as_f64().unwrap() <= 1.0 && place["stage"].is_string() && place["rms_nm"].is_number());
        for region in place["region"].as_array().unwrap() {
            assert!(region["variable"].is_string() && region["low"].as_f64() < region["high"].as_f64());
        }
        assert!(place["intervals_s"].is_array());
    }
    for f in list {
        let effect = f["effect"].as_str().unwrap();
        assert!(effect == "unknown" || lacuna_physics::effects::find(effect).is_some(), "{effect}");
        let probability = f["probability"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&probability));
        assert!(["named", "group", "unknown"].contains(&f["status"].as_str().unwrap()));
        assert_eq!(f["status"] == "group", f["group"].as_array().unwrap().len() > 1, "{effect}");
        let others: f64 =
            f["alternatives"].as_array().unwrap().iter().map(|a| a["probability"].as_f64().unwrap()).sum();
        assert!(probability + others < 1.0 + 1e-9);
        assert!(f["equation"].is_string() && f["stage"].is_string());
        let sentence = f["sentence"].as_str().unwrap();
        assert!(sentence.ends_with('.') && !sentence.contains('\n') && sentence.len() > 40, "{sentence}");
        for p in f["parameters"].as_array().unwrap() {
            let what = format!("{effect}.{}", p["symbol"]);
            assert!(p["unit"].is_string() && p["value"].is_number(), "{what}");
            rising(&p["ci95"], &what);
        }
        let held = &f["held_out"];
        let (before, after) = (held["before_rms_nm"].as_f64().unwrap(), held["after_rms_nm"].as_f64().unwrap());
        assert!((held["reduction"].as_f64().unwrap() - (1.0 - after / before)).abs() < 1e-9);
        rising(&held["ci95"], effect);
    }
    let held = &json["held_out"];
    for key in ["before_rms_nm", "after_rms_nm", "black_box_rms_nm"] {
        assert!(numbers(&held[key], joints, key).iter().all(|v| *v > 0.0), "{key}");
    }
    for key in ["before_ci95_nm", "after_ci95_nm"] {
        let list = held[key].as_array().unwrap();
        assert_eq!(list.len(), joints);
        list.iter().for_each(|i| rising(i, key));
    }
    rising(&held["relative_after_ci95"], "relative_after_ci95");
    for key in ["relative_before", "relative_after", "black_box_relative"] {
        assert!(held[key].is_number(), "{key}");
    }
    assert!(json["unknown"]["share"].is_number() && json["unknown"]["flag"].is_boolean());
    assert!(json["unknown"].get("where").is_some() && json["unknown"].get("expression").is_some());
    for e in json["excluded"].as_array().unwrap() {
        assert!(e["effect"].is_string() && !e["reason"].as_str().unwrap().is_empty());
    }
    assert!(json["repairs"].is_array() && json.get("next_experiment").is_some());
    let verdict = json["verdict"].as_str().unwrap();
    assert!(verdict.ends_with('.') && !verdict.contains('\n'), "{verdict}");
    let read: Findings = serde_json::from_value(json).unwrap();
    assert_eq!((read.verdict.as_str(), ids(&read)), (findings.verdict.as_str(), ids(findings)));
}

#[test]
fn findings_follow_their_schema() {
    for (k, list) in [&[][..], &["stribeck"], &["payload"], &["cogging"], &["elasticity"]].into_iter().enumerate() {
        let outcome = run(&options(&drawn(list, 60 + k as u64, 0.01)));
        check_schema(&outcome.findings, 3);
        let evidence = &outcome.evidence;
        assert!(!evidence.traces.is_empty() && evidence.black_box.contains("trees"));
        for trace in &evidence.traces {
            for j in &trace.joints {
                assert!(
                    [&j.measured, &j.before, &j.after, &j.black_box, &j.q_rad, &j.qd_rad_s]
                        .iter()
                        .all(|v| v.len() == trace.t_s.len())
                );
            }
        }
        assert_eq!(evidence.traces.iter().map(|t| t.joints.len()).max(), Some(3));
    }
}

/// Torque of a model file along a recording, by the catalogue's streaming terms, against what was recorded: RMS in the
/// band per joint over rows faster than `slow`, 25 ms and three periods of the band away from slower ones and the ends.
fn fresh_error(case: &Case, model: &ModelFile, recordings: &[Recording], band_hz: f64) -> Vec<f64> {
    let body = lacuna_physics::build(&case.robot, None).unwrap();
    let pi = lacuna_physics::parameters_of(body.as_ref(), &model.rigid_body).unwrap();
    let context = EffectContext { robot: &case.robot, urdf: None, body: body.as_ref(), pi: &pi };
    let slow = &model.friction.standstill_rad_s;
    let mut sums = [(0.0, 0.0f64); 3];
    for r in recordings {
        let dt = r.median_period_s().unwrap();
        let filter = |hz: f64, x: &[f64]| ZeroPhase::butterworth(4, hz, 1.0 / dt).unwrap().apply(x).unwrap();
        let q: Vec<Vec<f64>> = r.q_rad.iter().map(|x| filter(2.0 * band_hz, x)).collect();
        let derived = |k| q.iter().map(|x| differentiate(x, dt, Stencil::Seven, k).unwrap()).collect::<Vec<_>>();
        let (qd, qdd) = (derived(1), derived(2));
        let mut terms = build_terms(model, &context).unwrap();
        let mut rest = vec![Vec::new(); 3];
        for k in 0..r.len() {
            let at = |x: &[Vec<f64>]| -> Joints { std::array::from_fn(|j| x.get(j).map_or(0.0, |s| s[k])) };
            let (q, qd, qdd) = (at(&q), at(&qd), at(&qdd));
            let mut rigid = [0.0; MAX_JOINTS];
            let motion = Motion { q_rad: &q[..3], qd_rad_s: &qd[..3], qdd_rad_s2: &qdd[..3] };
            body.torque(&motion, &pi, &mut rigid[..3]).unwrap();
            let direction: Joints = std::array::from_fn(|j| if qd[j] == 0.0 { 0.0 } else { qd[j].signum() });
            let mut tau = [0.0; MAX_JOINTS];
            for j in 0..3 {
                tau[j] = model.friction.f_v[j] * qd[j] + model.friction.f_c[j] * direction[j];
            }
            let input = TermInput {
                stamp_ns: (r.t_s[k] * 1e9) as i64,
                q_rad: &q,
                qd_rad_s: &qd,
                qdd_rad_s2: &qdd,
                direction: &direction,
                ramp_rad_s: 0.01,
                tau_rigid_nm: &rigid,
                temperature_degc: &[f64::NAN; MAX_JOINTS],
            };
            terms.add_torque(&input, &mut tau);
            for j in 0..3 {
                rest[j].push(r.tau_nm[j][k] - rigid[j] - tau[j]);
            }
        }
        let (margin, edge) = ((0.025 / dt).round() as usize, (3.0 / band_hz / dt).round() as usize);
        for j in 0..3 {
            let rest = filter(band_hz, &rest[j]);
            for k in edge..r.len() - edge {
                let near = &qd[j][k.saturating_sub(margin)..(k + margin + 1).min(r.len())];
                if near.iter().all(|v| v.abs() >= slow[j]) {
                    sums[j].0 += rest[k] * rest[k];
                    sums[j].1 += 1.0;
                }
            }
        }
    }
    sums.iter().map(|(sum, count)| (sum / count).sqrt()).collect()
}

#[test]
fn test_recordings_neither_choose_nor_fit_and_the_model_file_keeps_its_word_on_them() {
    let case = drawn(&["stribeck"], 12, 0.0);
    let mut options = options(&case);
    let whole = |recording| Span { recording, from_s: f64::NEG_INFINITY, to_s: f64::INFINITY };
    options.conditioning.split =
        Split { holdout: None, train: vec![whole(0), whole(1), whole(2)], test: vec![whole(3), whole(4)] };
    let outcome = run(&options);
    let Outcome { findings, model, evidence, .. } = &outcome;
    check_schema(findings, 3);
    assert_eq!(ids(findings), ["stribeck"], "{}", findings.verdict);
    assert_eq!((findings.held_out.split.as_str(), findings.recordings.len()), ("files", 5));
    assert_eq!(evidence.test.len(), 2);
    assert!(evidence.traces.iter().all(|t| ["traj_04.csv", "traj_05.csv"].contains(&t.recording.as_str())));
    let fresh = fresh_error(&case, model, &options.recordings[3..], evidence.band_hz);
    for (j, (fresh, told)) in fresh.iter().zip(&findings.held_out.after_rms_nm).enumerate() {
        assert!((fresh / told - 1.0).abs() < 0.15, "joint {j}: {fresh} Nm from model.toml, {told} Nm told");
    }
    // What the test recordings say changes how the model is judged, never the model.
    for r in &mut options.recordings[3..] {
        r.tau_nm.iter_mut().flatten().for_each(|v| *v *= 1.3);
    }
    let other = run(&options);
    assert_eq!(other.model.terms, model.terms);
    assert_eq!(other.model.friction, model.friction);
    assert!(other.findings.held_out.relative_after > 5.0 * findings.held_out.relative_after);
}

#[test]
fn halves_of_a_single_recording_are_enough() {
    let mut case = drawn(&["coulomb_asym"], 71, 0.0);
    case.config.trajectories.truncate(3);
    let fourier = case.config.trajectories.pop().unwrap();
    case.config.trajectories = vec![lacuna_simulate::config::TrajectoryGroup { duration_s: 10.0, ..fourier }];
    let mut options = options(&case);
    assert_eq!(options.recordings.len(), 1);
    options.conditioning.split.holdout = Some(Holdout::Halves);
    let outcome = run(&options);
    check_schema(&outcome.findings, 3);
    assert_eq!((outcome.evidence.folds, outcome.findings.held_out.split.as_str()), (2, "halves"));
    assert!(ids(&outcome.findings).contains(&"coulomb_asym"), "{}", outcome.findings.verdict);
}

#[test]
fn only_what_the_simulator_leaves_out_is_named() {
    // The robot has two effects, the simulator the first of them, on other motions and with other noise.
    let robot = drawn(&["stribeck", "coulomb_asym"], 81, 0.0);
    let mut simulator = robot.clone();
    simulator.config.effects.truncate(1);
    simulator.config.noise.torque_nm = vec![0.01; 3];
    let mut options = options(&robot);
    options.sim = simulate(&simulator.robot, None, &simulator.config).unwrap().recordings;
    let outcome = run(&options);
    check_schema(&outcome.findings, 3);
    assert_eq!(ids(&outcome.findings), ["coulomb_asym"], "{}", outcome.findings.verdict);
    assert!(outcome.findings.findings[0].sentence.contains("simulator"));
    let words: Vec<&str> = outcome.evidence.simulator.iter().map(|(_, w)| w.as_str()).collect();
    assert!(words[0].contains("stribeck") || words[0].contains("Stribeck"), "{words:?}");
    assert!(words.iter().any(|w| w.contains("5 recordings that follow the same motion")), "{words:?}");
    // Both effects are in the model file, so that it can stand alone.
    let effects: Vec<&str> = outcome.model.terms.iter().map(|t| t.effect.as_str()).collect();
    assert!(effects.contains(&"stribeck") && effects.contains(&"coulomb_asym"), "{effects:?}");

    // The same robot twice: nothing to name.
    let mut twin = robot.clone();
    twin.config.effects.truncate(1);
    options.recordings = options.sim.clone();
    options.sim = simulate(&twin.robot, None, &twin.config).unwrap().recordings;
    let outcome = run(&options);
    assert!(ids(&outcome.findings).is_empty(), "{}", outcome.findings.verdict);
    assert!(outcome.findings.verdict.starts_with("The simulator leaves out nothing"));
}

#[test]
fn a_simulator_without_friction_lacks_friction() {
    let robot = drawn(&[], 82, 0.0);
    let mut simulator = robot.clone();
    simulator.config.friction.f_c = vec![0.0; 3];
    simulator.config.friction.f_v = vec![0.0; 3];
    simulator.config.noise.torque_nm = vec![0.0; 3];
    let mut options = options(&robot);
    options.sim = simulate(&simulator.robot, None, &simulator.config).unwrap().recordings;
    let Outcome { findings, model, .. } = run(&options);
    let mut named = ids(&findings);
    named.sort_unstable();
    assert_eq!(named, ["coulomb", "viscous"], "{}", findings.verdict);
    check_schema(&findings, 3);
    let truth = simulate(&robot.robot, None, &robot.config).unwrap().truth.base_params;
    for j in 0..3 {
        assert!((model.friction.f_c[j] / truth.fc[j] - 1.0).abs() < 0.05, "{:?} {:?}", model.friction.f_c, truth.fc);
    }
}

#[test]
fn what_cannot_be_used_is_refused_in_one_line() {
    let good = options(&drawn(&[], 15, 0.0));
    let refused = |change: &dyn Fn(&mut Options), words: &[&str]| {
        let mut options = good.clone();
        change(&mut options);
        let e = diagnose(&options, &mut |_, _| {}).unwrap_err().to_string();
        assert!(!e.contains('\n'), "{e}");
        for word in words {
            assert!(e.contains(word), "\"{word}\" belongs in: {e}");
        }
    };
    refused(&|o| o.recordings.clear(), &["found none"]);
    refused(&|o| o.recordings[1].q_rad.truncate(2), &["traj_02.csv", "found 2 joints", "expected 3"]);
    refused(&|o| o.recordings[1].tau_nm.truncate(1), &["traj_02.csv", "joints", "expected 3"]);
    refused(
        &|o| {
            for r in &mut o.recordings {
                r.t_s.truncate(40);
                r.q_rad.iter_mut().chain(&mut r.tau_nm).for_each(|x| x.truncate(40));
                r.extra.values_mut().for_each(|x| x.truncate(40));
            }
        },
        &["64", "expected"],
    );
    refused(&|o| o.recordings.iter_mut().flat_map(|r| &mut r.q_rad).for_each(|q| q.fill(0.3)), &["motion"]);
    refused(&|o| o.recordings.iter_mut().flat_map(|r| &mut r.tau_nm).for_each(|t| t.fill(2.0)), &["torque"]);
    refused(&|o| o.robot.mass = None, &["mass"]);
    refused(&|o| o.sim = vec![Recording::default()], &["simulator"]);
    refused(&|o| o.conditioning.band_hz = Some(1e6), &["band", "expected"]);
    let span = |recording| Span { recording, from_s: 0.0, to_s: 1e9 };
    refused(&|o| o.conditioning.split.test = vec![span(0)], &["training and test"]);
    refused(
        &|o| o.conditioning.split = Split { holdout: None, train: vec![span(0)], test: vec![span(9)] },
        &["recording 9"],
    );
}
