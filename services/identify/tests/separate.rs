//! A motion designed to separate two explanations does so on recordings of a simulated robot, by the likelihood of a
//! recording that was not fitted; laws and fit are written here in closed form, apart from the catalogue.

use lacuna_identify::excite::{ExciteOptions, Explanation, Separation, Trajectory, excite, separate};
use lacuna_interfaces::{ModelFile, Recording, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use lacuna_simulate::{TrueEffect, Twin, TwinConfig, TwinReference};
use lacuna_smoother::smooth_recording;
use nalgebra::{DMatrix, DVector};

const DELTA: &str = "kind = \"delta\"\nname = \"test\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n[drive]\nencoder_bits = 20\n\
    gear_ratio = 33\nsample_rate_hz = 1000\n\
    [limits]\nq_min_rad = -0.4\nq_max_rad = 1.1\nqd_max_rad_s = 6.0\nqdd_max_rad_s2 = 60.0\n";
const SD_NM: f64 = 0.05;
const JOINT: usize = 1;

fn model(robot: &RobotFile) -> ModelFile {
    let mut model = ModelFile::nominal(robot);
    model.friction.f_v = vec![0.8; 3];
    model.friction.f_c = vec![3.0; 3];
    model.noise.sd_tau_nm = vec![SD_NM; 3];
    model
}

fn explanation(effect: &str, parameters: &[(&str, f64)]) -> Explanation {
    Explanation {
        effect: effect.to_owned(),
        joints: vec!["q2".to_owned()],
        parameters: parameters.iter().map(|(s, v)| ((*s).to_owned(), *v)).collect(),
    }
}

fn stribeck() -> Explanation {
    explanation("stribeck", &[("f_sc", 0.5), ("v_s", 0.12)])
}

fn power() -> Explanation {
    explanation("viscous_power", &[("a", 0.6), ("p", 0.5)])
}

fn design(pair: &[Explanation; 2], options: &ExciteOptions) -> Separation {
    let robot = RobotFile::parse(DELTA).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    separate(&robot, None, body.as_ref(), &model(&robot), pair, options, &mut |_| ()).unwrap()
}

fn options() -> ExciteOptions {
    ExciteOptions { candidates: 640, ..ExciteOptions::default() }
}

/// Two recordings of the robot with `truth` on the motion, with noise of their own.
fn record(robot: &RobotFile, motion: &Trajectory, truth: &Explanation) -> Vec<Recording> {
    let twin = Twin::new(robot, None, &model(robot), TwinConfig::new(vec![SD_NM; 3], 1000.0)).unwrap();
    let t_s: Vec<f64> = (0..=10_000).map(|k| f64::from(k) * 1e-3).collect();
    let mut q_rad = vec![Vec::new(); 3];
    for t in &t_s {
        q_rad.iter_mut().zip(motion.at(*t).0).for_each(|(list, q)| list.push(q));
    }
    let reference = TwinReference { t_s, q_rad, start_s: 0.0 };
    let parameters: Vec<(&str, f64)> = truth.parameters.iter().map(|(s, v)| (s.as_str(), *v)).collect();
    let effect = TrueEffect::new(&truth.effect, &["q2"], &parameters);
    let one =
        |seed| twin.simulate(std::slice::from_ref(&reference), std::slice::from_ref(&effect), seed).unwrap().remove(0);
    vec![one(1), one(2)]
}

/// Velocity, and torque beyond the rigid body, of the joint where it slides; every tenth sample.
fn friction(robot: &RobotFile, body: &dyn RigidBody, recording: &Recording) -> Vec<(f64, f64)> {
    let smoothed = smooth_recording(recording, &Default::default(), robot, None).unwrap();
    let at = |list: &[Vec<f64>], k: usize| -> Vec<f64> { list.iter().map(|s| s[k]).collect() };
    let mut out = Vec::new();
    for k in (200..recording.len() - 200).step_by(10) {
        let (q, qd, qdd) = (at(&smoothed.q_rad, k), at(&smoothed.qd_rad_s, k), at(&smoothed.qdd_rad_s2, k));
        if qd[JOINT].abs() < 0.05 {
            continue;
        }
        let mut tau = [0.0; 3];
        let motion = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
        body.torque(&motion, &body.nominal(), &mut tau).unwrap();
        out.push((qd[JOINT], recording.tau_nm[JOINT][k] - tau[JOINT]));
    }
    out
}

/// Squared error per noise variance on `test` of f_v, f_c and one more law fitted to `train`, at its best shape.
fn error(train: &[(f64, f64)], test: &[(f64, f64)], shapes: &[f64], law: fn(f64, f64) -> f64) -> f64 {
    let row = |v: f64, s: f64| [v, v.signum(), law(v.abs(), s) * v.signum()];
    let fit = |s: f64| {
        let x = DMatrix::from_fn(train.len(), 3, |i, c| row(train[i].0, s)[c]);
        let y = DVector::from_fn(train.len(), |i, _| train[i].1);
        let beta = x.clone().svd(true, true).solve(&y, 1e-12).unwrap();
        ((&y - &x * &beta).norm_squared(), s, beta)
    };
    let best = shapes.iter().map(|s| fit(*s)).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    let sum: f64 = test
        .iter()
        .map(|(v, y)| {
            let model: f64 = row(*v, best.1).iter().zip(best.2.iter()).map(|(x, b)| x * b).sum();
            (y - model) * (y - model)
        })
        .sum();
    sum / (SD_NM * SD_NM)
}

/// Held-out log-likelihood of the truth over its rival on this motion.
fn held_out(motion: &Trajectory, truth: &Explanation) -> f64 {
    let robot = RobotFile::parse(DELTA).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let recordings = record(&robot, motion, truth);
    let [train, test] = [0, 1].map(|i: usize| friction(&robot, body.as_ref(), &recordings[i]));
    let speeds: Vec<f64> = (0..30).map(|k| 0.02 * 1.12f64.powi(k)).collect();
    let powers: Vec<f64> = (1..60).map(|k| 0.05 * f64::from(k)).collect();
    let a = error(&train, &test, &speeds, |v, s| (-(v / s).powi(2)).exp());
    let b = error(&train, &test, &powers, f64::powf);
    if truth.effect == "stribeck" { 0.5 * (b - a) } else { 0.5 * (a - b) }
}

#[test]
fn the_designed_motion_separates_what_the_usual_one_leaves_open() {
    let robot = RobotFile::parse(DELTA).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let found = design(&[stribeck(), power()], &options());
    let usual = excite(&robot, body.as_ref(), &options(), &mut |_| ()).unwrap().motion;
    eprintln!("expected: {:?} -> {:?}", found.before, found.after);
    assert!(found.after.least() > 1.3 * found.before.least());
    for truth in [stribeck(), power()] {
        let (before, after) = (held_out(&usual, &truth), held_out(&found.motion, &truth));
        eprintln!("{} true: held-out log-likelihood over the rival {before:.1} -> {after:.1}", truth.effect);
        assert!(after > 5.0 && after > before + 3.0, "{}: {before} -> {after}", truth.effect);
    }
    // Limits hold, and the same seed gives the same motion.
    for k in 0..10_000 {
        let (q, qd, qdd) = found.motion.at(f64::from(k) * 1e-3);
        assert!(q.iter().all(|v| (-0.4..=1.1).contains(v)));
        assert!(qd.iter().all(|v| v.abs() <= 6.0) && qdd.iter().all(|v| v.abs() <= 60.0));
    }
    let few = ExciteOptions { candidates: 64, ..ExciteOptions::default() };
    let pair = [stribeck(), power()];
    assert_eq!(design(&pair, &few), design(&pair, &few));
}

#[test]
fn what_no_motion_can_separate_is_said() {
    let robot = RobotFile::parse(DELTA).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    let fails = |model: &ModelFile, pair: [Explanation; 2]| {
        separate(&robot, None, body.as_ref(), model, &pair, &options(), &mut |_| ()).unwrap_err().to_string()
    };
    let known = model(&robot);
    let e = fails(&known, [explanation("torque_offset", &[]), explanation("coulomb_asym", &[])]);
    assert!(e.contains("no motion shows a difference"), "{e}");
    assert!(fails(&known, [stribeck(), stribeck()]).contains("twice"));
    assert!(fails(&known, [explanation("stribek", &[]), power()]).contains("stribek"));
    let mut elsewhere = power();
    elsewhere.joints = vec!["q9".to_owned()];
    assert!(fails(&known, [stribeck(), elsewhere]).contains("q9"));
    assert!(fails(&known, [Explanation { joints: vec![], ..stribeck() }, power()]).contains("expected at least one"));
    assert!(fails(&known, [explanation("stribeck", &[("v_s", -1.0)]), power()]).contains("v_s"));
    let silent = ModelFile::nominal(&robot);
    assert!(fails(&silent, [stribeck(), power()]).contains("noise.sd_tau_nm"));
}
