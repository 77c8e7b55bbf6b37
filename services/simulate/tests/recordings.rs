//! Recordings as a drive would log them: quantised, rounded, reproducible, and the same in a file as in memory.

use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{Recording, RobotFile};
use lacuna_simulate::case::{CaseOptions, draw_case};
use lacuna_simulate::config::TrajectoryGroup;
use lacuna_simulate::demo::{DEMO_PAYLOAD_KG, DEMO_ROBOT, demo_delta};
use lacuna_simulate::reference::{Kinds, MotionLimits};
use lacuna_simulate::{SimulationConfig, TrueEffect, simulate, write_csv};

fn robot() -> RobotFile {
    RobotFile::parse(DEMO_ROBOT).unwrap()
}

fn short() -> SimulationConfig {
    let group = |kind| TrajectoryGroup { kind, duration_s: 1.5, count: 1, intensity: 0.8 };
    SimulationConfig {
        trajectories: [Kinds::Fourier, Kinds::PointToPoint, Kinds::Sweep, Kinds::Chirp].map(group).to_vec(),
        effects: vec![
            TrueEffect::new("stribeck", &["q2"], &[("f_sc", 1.0), ("v_s", 0.1)]),
            TrueEffect::new("payload", &[], &[("m", 1.0)]),
        ],
        ..SimulationConfig::default()
    }
}

fn csv(r: &Recording) -> Vec<u8> {
    let mut out = Vec::new();
    write_csv(r, &mut out).unwrap();
    out
}

#[test]
fn same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let s = pool.install(|| simulate(&robot(), None, &short())).unwrap();
        let files: Vec<Vec<u8>> = s.recordings.iter().map(csv).collect();
        (files, s.truth.to_json().unwrap())
    };
    let one = on(1);
    assert_eq!(one, on(1), "run twice");
    assert_eq!(one, on(4), "four threads");
    let other = simulate(&robot(), None, &SimulationConfig { seed: 2, ..short() }).unwrap();
    assert_ne!(one.0[0], csv(&other.recordings[0]), "another seed");
}

#[test]
fn positions_come_in_encoder_steps_and_torques_carry_the_stated_noise() {
    let mut config = short();
    config.noise.torque_nm = vec![0.1, 0.05, 0.2];
    let s = simulate(&robot(), None, &config).unwrap();
    let step = std::f64::consts::TAU / f64::from(1 << 20) / 33.0;
    assert!((s.truth.noise.encoder_step_rad[0] - step).abs() < 1e-18);
    for r in &s.recordings {
        for q in r.q_rad.iter().flatten() {
            let off = (q / step - (q / step).round()).abs() * step;
            assert!(off <= 0.51e-9, "{q} is {off} rad off a step (the file has nine decimals)");
        }
    }
    // The same run without torque noise: the difference is the noise.
    config.noise.torque_nm = vec![0.0; 3];
    let clean = simulate(&robot(), None, &config).unwrap();
    for (i, sd) in [0.1, 0.05, 0.2].into_iter().enumerate() {
        let (mut sum, mut n) = (0.0, 0.0);
        for (a, b) in s.recordings.iter().zip(&clean.recordings) {
            assert_eq!(a.q_rad, b.q_rad, "sensor noise must not move the robot");
            for (x, y) in a.tau_nm[i].iter().zip(&b.tau_nm[i]) {
                sum += (x - y).powi(2);
                n += 1.0;
            }
        }
        let found = f64::sqrt(sum / n);
        assert!((found / sd - 1.0).abs() < 0.05, "joint {}: {found} of {sd}", i + 1);
    }
}

#[test]
fn spikes_are_single_samples_at_the_stated_rate() {
    let mut config = short();
    config.noise.spikes_per_s = 3.0;
    let spiky = simulate(&robot(), None, &config).unwrap();
    config.noise.spikes_per_s = 0.0;
    let clean = simulate(&robot(), None, &config).unwrap();
    let mut spikes = 0;
    for (a, b) in spiky.recordings.iter().zip(&clean.recordings) {
        for i in 0..3 {
            let off: Vec<f64> = a.tau_nm[i].iter().zip(&b.tau_nm[i]).map(|(x, y)| (x - y).abs()).collect();
            let far = 15.0 * spiky.truth.noise.torque_nm[i];
            spikes += off.iter().filter(|d| **d > far).count();
        }
    }
    // 3 per second and joint over 4 × 1.5 s × 3 joints: 54 are expected, 30 to 80 is within 3.5 σ.
    assert!((30..80).contains(&spikes), "{spikes}");
}

#[test]
fn a_file_reads_back_as_the_recording() {
    let mut config = short();
    config.log.temperature = true;
    let s = simulate(&robot(), None, &config).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let files = s.write(folder.path()).unwrap();
    assert_eq!(files.len(), s.recordings.len() + 1);
    for (r, path) in s.recordings.iter().zip(&files) {
        let text = std::fs::read_to_string(path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("t,q1,q2,q3,tau1,tau2,tau3,temp1,temp2,temp3"));
        for (k, line) in lines.enumerate() {
            let v: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            assert_eq!(v[0], r.t_s[k]);
            for i in 0..3 {
                assert_eq!((v[1 + i], v[4 + i]), (r.q_rad[i][k], r.tau_nm[i][k]));
                assert_eq!(v[7 + i], r.extra[&format!("temp{}", i + 1)][k]);
            }
        }
        assert_eq!(text.lines().count(), r.len() + 1);
    }
    let manifest: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["files"][1]["file"], "traj_02.csv");
    // A folder that cannot be made is named.
    let blocked = folder.path().join("traj_01.csv").join("below");
    assert!(s.write(&blocked).unwrap_err().to_string().contains("below"));
}

#[test]
fn motions_keep_their_limits_and_the_loop_follows_them() {
    let limits = MotionLimits::of(&robot());
    let mut config = short();
    config.effects.clear();
    config.trajectories.push(TrajectoryGroup { kind: Kinds::PickPlace, duration_s: 3.0, count: 1, intensity: 1.0 });
    let s = simulate(&robot(), None, &config).unwrap();
    for (k, l) in s.behind.iter().enumerate() {
        assert!(l.tracking_error_rad < 0.01, "{}", l.tracking_error_rad);
        for i in 0..3 {
            let most = |v: &[f64]| v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            assert!(l.q_rad[i].iter().all(|q| *q > limits.q_min[i] - 0.02 && *q < limits.q_max[i] + 0.02));
            assert!(most(&l.qd_rad_s[i]) < 1.05 * limits.qd_max[i]);
            let sweep = k == 2;
            assert!(sweep || most(&l.qd_rad_s[i]) > 0.3, "recording {k}: joint {} hardly moves", i + 1);
        }
    }
}

#[test]
fn demo_has_the_papers_recordings() {
    let demo = demo_delta(1).unwrap();
    assert_eq!(demo.training_motions().len(), 12);
    let v_f = demo.test_motion().unwrap();
    assert!((v_f.duration_s() - 8.0).abs() < 0.01 && (v_f.median_period_s().unwrap() - 1e-3).abs() < 1e-9);
    let v_p = &demo.pick_place.recordings[0];
    assert!((v_p.duration_s() - 10.0).abs() < 0.01);
    let events = &demo.pick_place.truth.events[&v_p.name];
    assert!(events.len() >= 3 && events.iter().all(|e| e.mass == DEMO_PAYLOAD_KG));
    // The same robot carries the payload: same friction and noise.
    assert_eq!(demo.free.truth.base_params, demo.pick_place.truth.base_params);
    assert_eq!(demo.free.truth.noise, demo.pick_place.truth.noise);
    // Near the bounds, with large accelerations; and the paper's model misses several Nm.
    let reach = |f: fn(f64, f64) -> f64, start| {
        demo.free.recordings.iter().flat_map(|r| r.q_rad.iter().flatten()).copied().fold(start, f)
    };
    assert!(reach(f64::min, 9.0) < -0.4 && reach(f64::max, -9.0) > 1.35);
    assert!(demo.free.truth.hidden_rms_nm.iter().all(|h| *h > 5.0), "{:?}", demo.free.truth.hidden_rms_nm);
}

#[test]
fn serial_robots_are_simulated_too() {
    for seed in 0..6 {
        let options =
            CaseOptions { kind: Kind::Serial, effects: 0, trajectories: 4, duration_s: 2.0, ..Default::default() };
        let case = draw_case(seed, &options).unwrap();
        let s = simulate(&case.robot, None, &case.config).unwrap_or_else(|e| panic!("{seed}: {e}"));
        // The robot file survives its own format, and what is simulated is what it says.
        let text = toml::to_string(&case.robot).unwrap();
        let back = RobotFile::parse(&text).unwrap();
        assert_eq!(back, case.robot);
        assert_eq!(simulate(&back, None, &case.config).unwrap().recordings, s.recordings);
        // Nothing is hidden but friction, which never pushes.
        let base = &s.truth.base_params;
        for l in &s.behind {
            for i in 0..case.robot.joint_count() {
                let (mut error, mut n) = (0.0, 0.0);
                for k in 5..l.t_s.len() - 5 {
                    if (k - 5..=k + 5).all(|j| (0..base.fc.len()).all(|m| l.qd_rad_s[m][j] * l.qd_rad_s[m][k] > 0.0)) {
                        let v = l.qd_rad_s[i][k];
                        error += (l.hidden_nm[i][k] - base.fc[i] * v.signum() - base.fv[i] * v).powi(2);
                        n += 1.0;
                    }
                }
                let error = f64::sqrt(error / f64::max(n, 1.0));
                assert!(error < 0.05 * base.fc[i], "seed {seed} joint {}: {error} of {}", i + 1, base.fc[i]);
            }
        }
    }
}

#[test]
fn bad_configurations_are_refused_in_words() {
    let cases = [
        ("seed = -1", "-1"),
        ("sed = 1", "sed"),
        ("trajectory = []", "trajectory"),
        ("[[trajectory]]\nkind = \"zigzag\"", "zigzag"),
        ("[[trajectory]]\nkind = \"fourier\"\nduration_s = nan", "duration_s"),
        ("[friction]\nf_c = [1, 2]", "one per joint"),
        ("[friction]\nf_v = [1, -2, 1]", "-2"),
        ("[noise]\nencoder_steps = -1", "encoder_steps"),
        ("[log]\nrate_hz = 3000", "whole fraction"),
        ("[control]\nsubsteps = 0", "substeps"),
        ("[control]\nbandwidth_hz = 4000", "bandwidth_hz"),
        ("mass_error = 2", "mass_error"),
    ];
    for (text, expect) in cases {
        let e = SimulationConfig::parse(text).and_then(|c| simulate(&robot(), None, &c)).unwrap_err();
        assert!(e.what.contains(expect), "{text}: {e}");
        assert!(!e.to_string().contains('\n'), "{e}");
    }
    // Drives too weak for the arm: they trip, as real ones do.
    let mut weak = robot();
    weak.drive.rated_torque_nm = Some(lacuna_interfaces::robot::PerJoint::All(0.5));
    let e = simulate(&weak, None, &short()).map(|_| ()).unwrap_err();
    assert!(e.what.contains("off its reference"), "{e}");
    // Limits around no reachable pose.
    let mut nowhere = robot();
    nowhere.limits.q_min_rad = Some(lacuna_interfaces::robot::PerJoint::All(-1.58));
    nowhere.limits.q_max_rad = Some(lacuna_interfaces::robot::PerJoint::All(-1.57));
    assert!(simulate(&nowhere, None, &short()).is_err());
    // A chain without masses.
    let massless = "kind = \"serial\"\nname = \"m\"\njoints = [\"a\"]\n[[dh]]\na = 0.3\n";
    let e = simulate(&RobotFile::parse(massless).unwrap(), None, &SimulationConfig::default()).unwrap_err();
    assert!(e.what.contains("rotor_inertia"), "{e}");
}
