//! Identification on simulated recordings: what the files say, and what is said about bad ones.

mod common;

use common::{ARM, DELTA};
use lacuna_identify::split::Span;
use lacuna_identify::{Delay, Holdout, Method, Options, Outcome, identify, identify_recordings};
use lacuna_interfaces::{BadInput, ModelFile, Recording, RobotFile};
use lacuna_physics::{Motion, RigidBody, parameters_of};
use lacuna_simulate::config::{SimulationConfig, TrajectoryGroup};
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{Simulation, simulate};

fn robot(text: &str) -> (RobotFile, Box<dyn RigidBody>) {
    let robot = RobotFile::parse(text).unwrap();
    let body = lacuna_physics::build(&robot, None).unwrap();
    (robot, body)
}

fn motions(robot: &RobotFile, seed: u64, count: u32) -> Simulation {
    let group = |kind, count| TrajectoryGroup { kind, duration_s: 5.0, count, intensity: 0.8 };
    let config = SimulationConfig {
        seed,
        trajectories: vec![group(Kinds::Fourier, count), group(Kinds::PointToPoint, 1)],
        ..SimulationConfig::default()
    };
    simulate(robot, None, &config).unwrap()
}

fn run(
    options: &Options,
    robot: &RobotFile,
    body: &dyn RigidBody,
    recordings: Vec<Recording>,
) -> Result<Outcome, BadInput> {
    identify_recordings(options, robot, body, recordings, &(Vec::new(), Vec::new()), &mut |_, _| ())
}

fn said(outcome: &Outcome, what: &str) -> bool {
    outcome.identification.warnings.iter().any(|w| w.contains(what))
}

#[test]
fn the_model_file_reproduces_the_fit_through_the_physics() {
    for text in [DELTA, ARM] {
        let (robot, body) = robot(text);
        let simulation = motions(&robot, 3, 2);
        let outcome = run(&Options::default(), &robot, body.as_ref(), simulation.recordings.clone()).unwrap();
        let model = ModelFile::parse(&outcome.model.to_toml().unwrap()).unwrap();
        model.check(&robot).unwrap();
        let pi = parameters_of(body.as_ref(), &model.rigid_body).unwrap();
        // Noise-free signals behind the first recording: model torque against the plant's, away from standstill.
        let behind = &simulation.behind[0];
        let n = robot.joint_count();
        let (mut error, mut torque) = (0.0, 0.0);
        let mut tau = vec![0.0; n];
        for k in 200..behind.t_s.len() - 200 {
            let at = |signal: &[Vec<f64>]| signal.iter().map(|s| s[k]).collect::<Vec<f64>>();
            let (q, qd, qdd) = (at(&behind.q_rad), at(&behind.qd_rad_s), at(&behind.qdd_rad_s2));
            body.torque(&Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, &pi, &mut tau).unwrap();
            for j in (0..n).filter(|&j| qd[j].abs() > 0.3) {
                let f = &model.friction;
                let predicted = tau[j] + f.f_v[j] * qd[j] + f.f_c[j] * qd[j].signum() + f.offset[j];
                error += (predicted - simulation.recordings[0].tau_nm[j][k]).powi(2);
                torque += simulation.recordings[0].tau_nm[j][k].powi(2);
            }
        }
        let relative = (error / torque).sqrt();
        let noise: f64 = simulation.truth.noise.torque_nm.iter().map(|v| v * v).sum::<f64>() / n as f64;
        eprintln!(
            "{}: relative error of model.toml on unfiltered torque {relative:.4}, noise {:.4} Nm",
            robot.name,
            noise.sqrt()
        );
        assert!(relative < 0.05, "{relative}");
        assert!(outcome.identification.held_out.score.relative_error < 0.03);
        // Everything that merged is zero in the file, so that the full regressor adds up to the fit.
        for p in &outcome.identification.parameters {
            for m in &p.merged_with {
                assert_eq!(model.rigid_body.parameters.get(&m.symbol), Some(&0.0), "{} into {}", m.symbol, p.symbol);
            }
        }
    }
}

#[test]
fn account_and_model_read_back_from_their_text() {
    let (robot, _) = robot(DELTA);
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("robot.toml"), DELTA).unwrap();
    let paths = motions(&robot, 5, 2).write(dir.path()).unwrap();
    let recordings: Vec<_> = paths.into_iter().filter(|p| p.extension().is_some_and(|e| e == "csv")).collect();
    let mut shares = Vec::new();
    let options = Options { robot: dir.path().join("robot.toml"), recordings, ..Options::default() };
    let outcome = identify(&options, &mut |share, what| shares.push((share, what.to_owned()))).unwrap();
    assert!(shares.windows(2).all(|w| w[0].0 <= w[1].0) && shares.len() > 3);
    let text = serde_json::to_string(&outcome.identification).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["schema"], "lacuna.identification/1");
    for key in ["relative_error", "rms_nm", "mean_nm", "std_nm", "moving_only", "band_hz", "train", "test"] {
        assert!(!json["held_out"][key].is_null(), "{key}");
    }
    assert_eq!(json["held_out"]["train"][0]["file"], "traj_01.csv");
    for key in ["symbol", "unit", "value", "ci95", "merged_with"] {
        assert!(!json["parameters"][0][key].is_null(), "{key}");
    }
    for key in ["not_excited", "repairs", "warnings"] {
        assert!(json[key].is_array(), "{key}");
    }
    ModelFile::parse(&outcome.model.to_toml().unwrap()).unwrap().check(&robot).unwrap();
    assert_eq!(outcome.report.time_s.len(), outcome.report.joints[0].measured_nm.len());
    assert!(outcome.report.held_out.iter().all(|h| *h) && outcome.report.recordings.len() == 3);
}

#[test]
fn a_delay_is_found_and_undone() {
    let (robot, body) = robot(DELTA);
    let mut recordings = motions(&robot, 7, 3).recordings;
    // The torque of 0.6 ms before, by interpolation.
    for r in &mut recordings {
        for tau in &mut r.tau_nm {
            let late: Vec<f64> =
                (0..tau.len()).map(|k| if k == 0 { tau[0] } else { 0.4 * tau[k] + 0.6 * tau[k - 1] }).collect();
            *tau = late;
        }
    }
    let outcome = run(&Options::default(), &robot, body.as_ref(), recordings).unwrap();
    let delay = outcome.identification.delay.unwrap();
    assert!((delay.undone_s - 0.6e-3).abs() < 0.05e-3, "{delay:?}");
}

#[test]
fn the_papers_progression() {
    // As in the paper, the nominal model lacks inertia and weight that the real robot has.
    let (robot, body) = robot(DELTA);
    let real =
        DELTA.replace("upper_arm = 1.8", "upper_arm = 3.0").replace("rotor_inertia = 0.06", "rotor_inertia = 0.12");
    let real = RobotFile::parse(&real).unwrap();
    let group = |kind, count| TrajectoryGroup { kind, duration_s: 5.0, count, intensity: 0.9 };
    let trajectories = vec![group(Kinds::Fourier, 4), group(Kinds::PickPlace, 2)];
    let simulation =
        simulate(&real, None, &SimulationConfig { seed: 11, trajectories, ..SimulationConfig::default() }).unwrap();
    let options = Options { method: Method::Paper, ..Options::default() };
    let outcome = run(&options, &robot, body.as_ref(), simulation.recordings.clone()).unwrap();
    let paper = outcome.identification.paper.as_ref().unwrap();
    let sigma: Vec<f64> =
        paper.table1.iter().map(|t| (t.std_nm.iter().map(|s| s * s).sum::<f64>() / 3.0).sqrt()).collect();
    for t in &paper.trajectories {
        eprintln!("   {}: rho {:.3} {:.3}, f_v {:.3?}, f_c {:.3?}", t.file, t.rho1, t.rho2, t.f_v, t.f_c);
    }
    for (t, s) in paper.table1.iter().zip(&sigma) {
        eprintln!("{}: mean {:.3?} sd {:.3?} ({s:.3} Nm)", t.model, t.mean_nm, t.std_nm);
    }
    for t in &paper.table1_moving {
        eprintln!("moving {}: mean {:.3?} sd {:.3?}", t.model, t.mean_nm, t.std_nm);
    }
    assert_eq!(paper.table1.iter().map(|t| t.model.as_str()).collect::<Vec<_>>(), ["M_KH", "M_Id", "M_Id+F", "pooled"]);
    assert!(sigma[1] < sigma[0] && sigma[2] < 0.7 * sigma[1] && sigma[3] < sigma[2], "{sigma:?}");
    assert_eq!((outcome.model.rigid_body.rho1, outcome.model.friction.f_v.len()), (Some(paper.rho1), 3));
    let (arm, arm_body) = self::robot(ARM);
    let e = run(&options, &arm, arm_body.as_ref(), motions(&arm, 1, 1).recordings).unwrap_err();
    assert!(e.to_string().contains("paper"), "{e}");
}

#[test]
fn consistent_links_could_exist_and_cost_little() {
    for text in [ARM, DELTA] {
        let (robot, body) = robot(text);
        let recordings = motions(&robot, 21, 2).recordings;
        let options = Options { consistent: true, ..Options::default() };
        let outcome = run(&options, &robot, body.as_ref(), recordings).unwrap();
        let i = &outcome.identification;
        let cost = i.consistency.unwrap();
        eprintln!(
            "{}: {:.4} free {:.4}, residual ratio {:.5}",
            robot.name, i.held_out.score.relative_error, cost.free_relative_error, cost.training_residual_ratio
        );
        // The true links exist, so demanding that costs next to nothing; below 1 where the free fit left a column out.
        assert!((0.98..1.05).contains(&cost.training_residual_ratio));
        assert!(i.held_out.score.relative_error < 1.1 * cost.free_relative_error);
        let of = |symbol: &str| outcome.model.rigid_body.parameters[symbol];
        assert!(outcome.model.friction.f_c.iter().chain(&outcome.model.friction.f_v).all(|v| *v > 0.0));
        for link in (1..=2).filter(|_| text == ARM) {
            let at = |name: &str| of(&format!("{name}{link}"));
            let m = at("m");
            let (x, y, z) = (at("mx") / m, at("my") / m, at("mz") / m);
            // Inertia about the centre of mass: positive definite, and the triangle inequality of its principal values.
            let inertia = nalgebra::Matrix3::new(
                at("Ixx") - m * (y * y + z * z),
                at("Ixy") + m * x * y,
                at("Ixz") + m * x * z,
                at("Ixy") + m * x * y,
                at("Iyy") - m * (x * x + z * z),
                at("Iyz") + m * y * z,
                at("Ixz") + m * x * z,
                at("Iyz") + m * y * z,
                at("Izz") - m * (x * x + y * y),
            );
            let mut principal: Vec<f64> = inertia.symmetric_eigenvalues().iter().copied().collect();
            principal.sort_by(f64::total_cmp);
            assert!(m > 0.0 && principal[0] > 0.0 && principal[0] + principal[1] > principal[2], "{m} {principal:?}");
        }
    }
}

#[test]
fn bad_recordings_are_named_with_the_number_that_shows_it() {
    let (robot, body) = robot(ARM);
    let good = motions(&robot, 9, 2).recordings;
    let outcome = run(&Options::default(), &robot, body.as_ref(), good.clone()).unwrap();
    for nothing in ["hardly excited", "wrong unit", "saturated", "collinear", "rank deficient", "too few"] {
        assert!(!said(&outcome, nothing), "{nothing}: {:?}", outcome.identification.warnings);
    }

    let mut still = good.clone();
    for r in &mut still {
        r.q_rad[1].fill(0.3);
        r.tau_nm[1].fill(0.7);
    }
    let outcome = run(&Options::default(), &robot, body.as_ref(), still).unwrap();
    assert!(said(&outcome, "joint 2 (b) is hardly excited"), "{:?}", outcome.identification.warnings);
    assert!(said(&outcome, "rank deficient"), "{:?}", outcome.identification.warnings);
    let named = |s: &str| outcome.identification.parameters.iter().any(|p| p.symbol == s);
    assert!(!named("f_v2") && !named("f_c2") && !named("Ia2"), "nothing is printed that the data do not support");

    let mut currents = good.clone();
    currents.iter_mut().flat_map(|r| &mut r.tau_nm).flatten().for_each(|v| *v *= 0.02);
    let outcome = run(&Options::default(), &robot, body.as_ref(), currents).unwrap();
    assert!(
        said(&outcome, "wrong unit? the rigid-body parameters are 0.020 times"),
        "{:?}",
        outcome.identification.warnings
    );
    assert!(said(&outcome, "gear ratio is 50"));

    // Without masses in the robot file the drive's rating tells.
    let peak = good.iter().flat_map(|r| &r.tau_nm[0]).fold(0.0f64, |m, v| m.max(v.abs()));
    let rated = RobotFile::parse(&format!("{ARM}rated_torque_nm = {peak}\n")).unwrap();
    let mut milli = good.clone();
    milli.iter_mut().flat_map(|r| &mut r.tau_nm).flatten().for_each(|v| *v *= 5e-3);
    let outcome = run(&Options::default(), &rated, body.as_ref(), milli).unwrap();
    assert!(said(&outcome, &format!("the drive is rated for {peak} Nm")), "{:?}", outcome.identification.warnings);
    let outcome = run(&Options::default(), &rated, body.as_ref(), good.clone()).unwrap();
    assert!(!said(&outcome, "rated"), "{:?}", outcome.identification.warnings);

    let mut clipped = good.clone();
    let limit = 0.6 * clipped[0].tau_nm[0].iter().fold(0.0f64, |m, v| m.max(v.abs()));
    clipped.iter_mut().for_each(|r| r.tau_nm[0].iter_mut().for_each(|v| *v = v.clamp(-limit, limit)));
    let outcome = run(&Options::default(), &robot, body.as_ref(), clipped).unwrap();
    assert!(said(&outcome, "the torque of joint 1 stays at its limit"), "{:?}", outcome.identification.warnings);

    // One recording in another unit: they do not predict each other.
    let mut loaded = motions(&robot, 9, 6).recordings;
    assert!(!said(&run(&Options::default(), &robot, body.as_ref(), loaded.clone()).unwrap(), "do not agree"));
    loaded[1].tau_nm.iter_mut().flatten().for_each(|v| *v *= 2.0);
    let outcome = run(&Options::default(), &robot, body.as_ref(), loaded).unwrap();
    let found = outcome.identification.warnings.iter().find(|w| w.starts_with("the recordings do not agree"));
    let worst = outcome.identification.held_out.folds.iter().copied().fold(0.0, f64::max);
    assert!(found.is_some_and(|w| w.contains(&format!(" to {:.0} % (traj_", 100.0 * worst))), "{found:?}");

    let one = vec![good[0].clone()];
    let outcome = run(&Options::default(), &robot, body.as_ref(), one).unwrap();
    let short: Vec<&String> = outcome
        .identification
        .warnings
        .iter()
        .filter(|w| w.starts_with("little data") && w.contains(" s in motion"))
        .collect();
    assert_eq!(short.len(), 1, "{:?}", outcome.identification.warnings);
    assert!(said(&outcome, "too few recordings") && outcome.identification.held_out.split == "halves");

    let e = run(
        &Options { holdout: Some(Holdout::Recordings), ..Options::default() },
        &robot,
        body.as_ref(),
        vec![good[0].clone()],
    );
    assert!(e.unwrap_err().to_string().contains("at least 2"));
    let mut rest = good[0].clone();
    rest.q_rad.iter_mut().for_each(|q| q.fill(0.1));
    let e = run(&Options::default(), &robot, body.as_ref(), vec![rest]).unwrap_err().to_string();
    assert!(e.contains("0 rows of moving joints"), "{e}");
    let e = run(&Options { delay: Delay::Fixed(f64::NAN), ..Options::default() }, &robot, body.as_ref(), good);
    assert!(e.unwrap_err().to_string().contains("delay"));
}

#[test]
fn a_signal_that_is_no_torque_of_this_robot_is_named() {
    let (robot, body) = robot(DELTA);
    // Rotors are heavier than in the robot file, as they often are: no one factor explains another unit then.
    let real = RobotFile::parse(&DELTA.replace("rotor_inertia = 0.06", "rotor_inertia = 0.4")).unwrap();
    let good = motions(&real, 9, 2).recordings;
    let times = |factor: f64| {
        let mut list = good.clone();
        list.iter_mut().flat_map(|r| &mut r.tau_nm).flatten().for_each(|v| *v *= factor);
        list
    };
    let fit = |list: Vec<Recording>| run(&Options::default(), &robot, body.as_ref(), list);
    let outcome = fit(good.clone()).unwrap();
    assert!(!said(&outcome, "wrong unit") && !said(&outcome, "wrong sign"), "{:?}", outcome.identification.warnings);
    let begin = "wrong unit? every rigid-body parameter is ";
    for factor in [0.08, 1000.0] {
        let warnings = fit(times(factor)).unwrap().identification.warnings;
        let of = warnings.iter().find_map(|w| w.strip_prefix(begin));
        let least: f64 = of.and_then(|w| w.split(' ').next()).and_then(|n| n.parse().ok()).unwrap_or_default();
        // Platform and forearms are as in the file.
        assert!((least / factor - 1.0).abs() < 0.02, "{factor}: {warnings:?}");
    }
    let outcome = fit(times(-1.0)).unwrap();
    for joint in 1..=3 {
        assert!(
            said(&outcome, &format!("wrong sign? friction of joint {joint}")),
            "{:?}",
            outcome.identification.warnings
        );
    }
    // A torque that never changes is none: no fit is made of it.
    for level in [0.0, 3.0] {
        let mut dead = good.clone();
        dead.iter_mut().for_each(|r| r.tau_nm[1].fill(level));
        let e = fit(dead).unwrap_err().to_string();
        assert!(e.contains(&format!("joint 2 (q2): the torque is {level} Nm in every sample")), "{e}");
    }
}

/// Torque and position of a motion in closed form, with noise that no fit can follow.
fn closed_form(robot: &RobotFile, body: &dyn RigidBody, name: &str, q: impl Fn(f64, usize) -> [f64; 3]) -> Recording {
    let n = robot.joint_count();
    let mut out = Recording { name: name.to_owned(), joints: robot.joints.clone(), ..Recording::default() };
    (out.q_rad, out.tau_nm) = (vec![Vec::new(); n], vec![Vec::new(); n]);
    let mut tau = vec![0.0; n];
    for k in 0..15_000 {
        let t = f64::from(k) * 1e-3;
        let at: Vec<[f64; 3]> = (0..n).map(|j| q(t, j)).collect();
        let [q, qd, qdd] = [0, 1, 2].map(|d| at.iter().map(|a| a[d]).collect::<Vec<f64>>());
        let motion = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
        body.torque(&motion, &body.nominal(), &mut tau).unwrap();
        out.t_s.push(t);
        for j in 0..n {
            let noise = 0.01 * (f64::from(k) * (12.9898 + j as f64)).sin();
            out.q_rad[j].push(q[j]);
            out.tau_nm[j].push(tau[j] + 0.3 * qd[j] + 0.2 * qd[j].signum() + noise);
        }
    }
    out
}

#[test]
fn collinear_columns_are_named() {
    let (robot, body) = robot(ARM);
    // One sine a joint, small: acceleration is −w² times the position, and with it inertia and weight are one number.
    let swing = |a: f64| {
        move |t: f64, j: usize| {
            let (w, a) = (7.0, a * (1.0 + j as f64));
            let (s, c) = (w * t + j as f64).sin_cos();
            [a * s, a * w * c, -a * w * w * s]
        }
    };
    let recordings = ["a.csv", "b.csv"].map(|name| closed_form(&robot, body.as_ref(), name, swing(0.03))).to_vec();
    let outcome = run(&Options::default(), &robot, body.as_ref(), recordings).unwrap();
    let warning = outcome.identification.warnings.iter().find(|w| w.starts_with("collinear columns")).unwrap();
    assert!(warning.contains("mx1 (near Izz1)") && warning.contains("condition number"), "{warning}");
    // Of what is one number, no two are printed as two.
    let named = |s: &str| outcome.identification.parameters.iter().any(|p| p.symbol == s);
    assert!(!(named("Izz1") && named("mx1")), "{:?}", outcome.identification.not_excited);
}

#[test]
fn degrees_called_radians_are_doubted() {
    let (robot, body) = robot(ARM);
    let good = motions(&robot, 9, 2).recordings;
    let in_degrees = |list: &[Recording]| {
        let mut list = list.to_vec();
        list.iter_mut().flat_map(|r| &mut r.q_rad).flatten().for_each(|q| *q = q.to_degrees());
        list
    };
    let outcome = run(&Options::default(), &robot, body.as_ref(), good.clone()).unwrap();
    assert!(!said(&outcome, "degrees"));
    let outcome = run(&Options::default(), &robot, body.as_ref(), in_degrees(&good)).unwrap();
    assert!(said(&outcome, "turns: degrees called rad?"), "{:?}", outcome.identification.warnings);
    // With limits in the robot file the doubt names them.
    let limited = RobotFile::parse(&format!("{ARM}[limits]\nq_min_rad = -3.1\nq_max_rad = 3.1\n")).unwrap();
    let outcome = run(&Options::default(), &limited, body.as_ref(), in_degrees(&good)).unwrap();
    assert!(said(&outcome, "the robot file's limit is 3.10 rad"), "{:?}", outcome.identification.warnings);
    // A Delta has no pose there at all, which is an error.
    let (delta, delta_body) = self::robot(DELTA);
    let recordings = in_degrees(&motions(&delta, 5, 1).recordings);
    let e = run(&Options::default(), &delta, delta_body.as_ref(), recordings).unwrap_err().to_string();
    assert!(e.contains("in radians") && e.contains("traj_01.csv") && !e.contains('\n'), "{e}");
}

#[test]
fn ways_of_splitting_exclude_each_other() {
    let (robot, _) = robot(DELTA);
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("robot.toml"), DELTA).unwrap();
    let paths = motions(&robot, 5, 1).write(dir.path()).unwrap();
    let file = paths.into_iter().find(|p| p.extension().is_some_and(|e| e == "csv")).unwrap();
    let base = Options { robot: dir.path().join("robot.toml"), ..Options::default() };
    let part = |text: &str| format!("{}{text}", file.display()).parse().unwrap();
    let fails = |o: Options| identify(&o, &mut |_, _| ()).unwrap_err().to_string();
    assert!(fails(base.clone()).contains("no recording"));
    assert!(fails(Options { train: vec![part("@0:2")], ..base.clone() }).contains("expected both"));
    let both = Options { train: vec![part("@0:2")], test: vec![part("@2:5")], ..base.clone() };
    assert!(fails(Options { recordings: vec![file.clone()], ..both.clone() }).contains("one way"));
    assert!(fails(Options { test: vec![part("@90:95")], ..both.clone() }).contains("test: found no row"));
    let outcome = identify(&both, &mut |_, _| ()).unwrap();
    let held = outcome.identification.held_out;
    assert_eq!((held.split.as_str(), held.train[0].to_s, held.test[0].from_s), ("files", 2.0, 2.0));
    assert_eq!(Span { recording: 0, from_s: 0.0, to_s: 1.0 }.recording, 0);
}
