//! Diagnosis of simulated robots whose truth the simulator states: its plant shares no regressor with the
//! estimator. Short recordings, so that a debug build stays bearable; the `twins` example runs many.

use lacuna_diagnose::{Conditioning, Options, Outcome, diagnose};
use lacuna_interfaces::ModelFile;
use lacuna_simulate::case::{CaseOptions, draw_case};
use lacuna_simulate::{Simulation, simulate};

fn case(ids: &[&str], seed: u64) -> (Options, Simulation) {
    let options = CaseOptions {
        effects: ids.len(),
        ids: ids.iter().map(|s| (*s).to_owned()).collect(),
        severity: [1.0, 1.0],
        mass_error: 0.01,
        trajectories: 5,
        duration_s: 3.0,
        ..CaseOptions::default()
    };
    let case = draw_case(seed, &options).unwrap();
    let simulation = simulate(&case.robot, None, &case.config).unwrap();
    let conditioning = Conditioning {
        start_s: simulation.manifest.files.iter().map(|f| f.start_time_s).collect(),
        ..Conditioning::default()
    };
    let recordings = simulation.recordings.clone();
    (Options { robot: case.robot, urdf: None, recordings, sim: Vec::new(), conditioning, seed: 1 }, simulation)
}

fn run(options: &Options) -> Outcome {
    let mut last = 0.0;
    let outcome = diagnose(options, &mut |share, _| last = share).unwrap();
    assert!(last > 0.5, "progress reaches its end: {last}");
    outcome
}

#[test]
fn nothing_missing_is_no_finding() {
    let (options, simulation) = case(&[], 11);
    let Outcome { findings, model, .. } = run(&options);
    assert!(findings.findings.is_empty(), "{:?}", findings.findings);
    assert!(!findings.mismatch.detected && !findings.unknown.flag);
    let truth = &simulation.truth.base_params;
    for j in 0..3 {
        let (found, expected) = (model.friction.f_c[j], truth.fc[j]);
        assert!((found / expected - 1.0).abs() < 0.05, "joint {j}: f_c {found}; expected {expected}");
    }
}

#[test]
fn stribeck_is_named_with_its_joint_and_the_model_carries_it() {
    let (options, simulation) = case(&["stribeck"], 12);
    let Outcome { findings, model, .. } = run(&options);
    let first = findings.findings.first().unwrap();
    assert_eq!(first.effect, "stribeck", "{}", findings.verdict);
    assert_eq!(first.joints, simulation.truth.effects[0].joints);
    assert!(first.held_out.after_rms_nm < 0.5 * first.held_out.before_rms_nm);
    // The model file is what the stages load.
    model.check(&options.robot).unwrap();
    assert_eq!(ModelFile::parse(&model.to_toml().unwrap()).unwrap(), model);
    let body = lacuna_physics::build(&options.robot, None).unwrap();
    let context = lacuna_physics::effects::EffectContext {
        robot: &options.robot,
        urdf: None,
        body: body.as_ref(),
        pi: &body.nominal(),
    };
    lacuna_physics::effects::build_terms(&model, &context).unwrap();
}

#[test]
fn payload_is_weighed() {
    let (options, simulation) = case(&["payload"], 13);
    let findings = run(&options).findings;
    let first = findings.findings.first().unwrap();
    assert_eq!(first.effect, "payload", "{}", findings.verdict);
    let mass = first.parameters.iter().find(|p| p.symbol == "m").unwrap().value;
    let truth = simulation.truth.effects[0].params["m"];
    assert!((mass / truth - 1.0).abs() < 0.03, "{mass} kg; expected {truth}");
    assert!(!first.intervals_s.is_empty());
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let (options, _) = case(&["coulomb_asym"], 14);
    let text = |o: &Outcome| (serde_json::to_string(&o.findings).unwrap(), o.model.to_toml().unwrap());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = pool.install(|| text(&run(&options)));
    assert_eq!(alone, text(&run(&options)));
    let json: serde_json::Value = serde_json::from_str(&alone.0).unwrap();
    assert_eq!(json["schema"], "lacuna.findings/1");
    for key in [
        "robot",
        "recordings",
        "joints",
        "baseline",
        "mismatch",
        "findings",
        "held_out",
        "unknown",
        "excluded",
        "repairs",
        "next_experiment",
        "verdict",
    ] {
        assert!(json.get(key).is_some(), "{key} is missing");
    }
    for key in
        ["effect", "joints", "probability", "status", "alternatives", "group", "equation", "sentence", "parameters"]
    {
        assert!(json["findings"][0].get(key).is_some(), "findings[0].{key} is missing");
    }
    assert!(json["held_out"]["black_box_relative"].is_number());
}

#[test]
fn recordings_without_motion_are_refused_in_one_line() {
    let (mut options, _) = case(&[], 15);
    for r in &mut options.recordings {
        r.q_rad.iter_mut().for_each(|q| q.fill(0.3));
    }
    let e = diagnose(&options, &mut |_, _| {}).unwrap_err().to_string();
    assert!(e.contains("motion") && !e.contains('\n'), "{e}");
    options.recordings.clear();
    assert!(diagnose(&options, &mut |_, _| {}).is_err());
}

#[test]
fn a_counterbalance_is_not_also_called_presliding() {
    // Fitted while the counterbalance is not known yet, the travel over which friction turns round is wrong here.
    let (options, simulation) = case(&["gravity_spring"], 100);
    let findings = run(&options).findings;
    let names: Vec<&str> = findings.findings.iter().map(|f| f.effect.as_str()).collect();
    assert_eq!(names, ["gravity_spring"], "{}", findings.verdict);
    assert_eq!(findings.findings[0].joints, simulation.truth.effects[0].joints);
}
