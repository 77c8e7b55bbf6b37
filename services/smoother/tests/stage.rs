//! The smoother as a stage: one output per input, flags, lag, configuration.

use lacuna_interfaces::{BadInput, JointMeasured, JointSmoothed, Recording, RobotFile, Stage, StageContext, flag};
use lacuna_smoother::{Config, MOST_PROBED, Smoother, settings_for, smooth_recording};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n";

fn robot(drive: &str) -> RobotFile {
    RobotFile::parse(&format!("{DELTA}{drive}")).unwrap()
}

fn encoder() -> RobotFile {
    robot("[drive]\ngear_ratio = 33\nencoder_bits = 20\n")
}

fn make(robot: &RobotFile, config: &str) -> Result<Smoother, BadInput> {
    let config: Config = toml::from_str(config).map_err(|e| BadInput::from_toml(&e, config))?;
    Smoother::new(config, &StageContext { robot, urdf: None, model: None })
}

/// Three joints on sines with encoder noise, stamps as given.
fn measured(stamps: &[i64], seed: u64) -> Vec<JointMeasured> {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    stamps
        .iter()
        .enumerate()
        .map(|(k, &stamp_ns)| {
            let mut m = JointMeasured::default();
            m.header.seq = k as u64 + 1;
            m.header.stamp_ns = stamp_ns;
            m.header.joints = 3;
            for j in 0..3 {
                let t = (stamp_ns - stamps[0]) as f64 * 1e-9;
                m.q_rad[j] = 0.5 * (6.0 * t + j as f64).sin() + 5e-7 * rng.random_range(-1.7..1.7);
                m.tau_nm[j] = k as f64 + 0.1 * j as f64;
                m.temperature_degc[j] = 30.0 + k as f64;
            }
            m
        })
        .collect()
}

fn run(stage: &mut Smoother, input: &[JointMeasured]) -> Vec<JointSmoothed> {
    let mut out = Vec::new();
    for m in input {
        stage.step(m, &mut |o| out.push(*o));
    }
    stage.finish(&mut |o| out.push(*o));
    out
}

fn regular(n: usize, period_ns: i64) -> Vec<i64> {
    (0..n as i64).map(|k| 1_700_000_000_000_000_000 + k * period_ns).collect()
}

fn recording(input: &[JointMeasured]) -> Recording {
    Recording {
        name: "made.csv".to_owned(),
        joints: ["q1", "q2", "q3"].map(str::to_owned).to_vec(),
        t_s: input.iter().map(|m| (m.header.stamp_ns - input[0].header.stamp_ns) as f64 * 1e-9).collect(),
        q_rad: (0..3).map(|j| input.iter().map(|m| m.q_rad[j]).collect()).collect(),
        tau_nm: (0..3).map(|j| input.iter().map(|m| m.tau_nm[j]).collect()).collect(),
        ..Recording::default()
    }
}

#[test]
fn each_input_leads_to_its_own_output() {
    let input = measured(&regular(2000, 1_000_000), 1);
    let robot = encoder();
    let out = run(&mut make(&robot, "").unwrap(), &input);
    assert_eq!(out.len(), input.len());
    for (o, m) in out.iter().zip(&input) {
        assert_eq!((o.header.seq, o.header.stamp_ns, o.header.joints), (m.header.seq, m.header.stamp_ns, 3));
        assert_eq!((o.tau_nm, o.temperature_degc), (m.tau_nm, m.temperature_degc));
        assert_eq!(o.q_rad[3..], [0.0; 5]);
    }
    // 80 Hz: four time constants are 25 ms.
    assert_eq!(out[1000].header.lag_ns, 25_000_000);
    assert_eq!(out[0].header.flags, flag::STATE_RESET);
    assert!(out[1..1975].iter().all(|o| o.header.flags == 0));
    assert!(out[1975..].iter().all(|o| o.header.flags == flag::SHORT_LAG));
    assert_eq!(out[1999].header.lag_ns, 0);
    // Truth, and the offline smoother: a lag of four time constants leaves 2 % of the forward filter's error.
    let offline = smooth_recording(&recording(&input), &Config::default(), &robot, None).unwrap();
    for k in 100..1900 {
        let t = k as f64 * 1e-3;
        for j in 0..3 {
            assert!((out[k].qd_rad_s[j] - 3.0 * (6.0 * t + j as f64).cos()).abs() < 1e-3);
            assert!((out[k].qdd_rad_s2[j] + 18.0 * (6.0 * t + j as f64).sin()).abs() < 0.3, "{k}");
            let sd = offline.sd_qdd_rad_s2(j).at(k);
            assert!((out[k].qdd_rad_s2[j] - offline.qdd_rad_s2[j][k]).abs() < 0.2 * sd, "{k}");
            assert!((out[k].sd_qdd_rad_s2[j] / sd - 1.0).abs() < 1e-2);
        }
    }
}

#[test]
fn gaps_and_unusable_positions_are_flagged() {
    let mut stamps = regular(600, 1_000_000);
    stamps[300..].iter_mut().for_each(|s| *s += 50_000_000);
    let mut input = measured(&stamps, 2);
    input[100].q_rad[1] = f64::NAN;
    let out = run(&mut make(&encoder(), "lag_samples = 10").unwrap(), &input);
    assert_eq!(out.len(), 600);
    for (k, o) in out.iter().enumerate() {
        let expected = match k {
            0 => flag::STATE_RESET,
            100 => flag::REPAIRED,
            300 => flag::STATE_RESET | flag::GAP,
            290..300 | 590.. => flag::SHORT_LAG,
            _ => 0,
        };
        assert_eq!(o.header.flags, expected, "{k}");
        assert!(o.q_rad.iter().chain(&o.qdd_rad_s2).all(|v| v.is_finite()));
    }
    assert!((out[100].q_rad[1] - 0.5 * (0.6f64 + 1.0).sin()).abs() < 1e-5, "bridged");
    assert_eq!(out[50].header.lag_ns, 10_000_000);
}

#[test]
fn noise_is_found_from_the_first_stretch() {
    let robot = robot("");
    let input = measured(&regular(6000, 1_000_000), 3);
    // No encoder, no configuration: the measurement noise comes from the data (uniform ± 8.5e-7: sd 4.9e-7).
    let settings = settings_for(&recording(&input), &Config::default(), &robot, None).unwrap();
    for noise in &settings.noise {
        assert!((noise.measurement_sd / 4.9e-7 - 1.0).abs() < 0.1, "{noise:?}");
    }
    let out = run(&mut make(&robot, "process_noise = \"auto\"\nauto_s = 1.0").unwrap(), &input);
    assert_eq!(out.len(), 6000);
    // The stretch's samples leave together once it has been looked at.
    let mut stage = make(&robot, "process_noise = \"auto\"\nauto_s = 1.0").unwrap();
    let mut emitted = 0;
    for (k, m) in input.iter().enumerate().take(1500) {
        stage.step(m, &mut |_| emitted += 1);
        assert_eq!(emitted > 0, k >= 1000, "{k}");
    }
    // Ten times slower motion has a thousandth of the jerk: about a tenth of the bandwidth, and so much less noise.
    let mut slow = measured(&regular(6000, 1_000_000), 3);
    for m in &mut slow {
        let t = (m.header.seq - 1) as f64 * 1e-3;
        m.q_rad[0] += 0.5 * (0.6 * t).sin() - 0.5 * (6.0 * t).sin();
    }
    let slow = run(&mut make(&robot, "process_noise = \"auto\"\nauto_s = 1.0").unwrap(), &slow);
    let ratio = slow[3000].sd_qdd_rad_s2[0] / out[3000].sd_qdd_rad_s2[0];
    assert!((1e-3..2e-2).contains(&ratio), "{ratio}");
    assert!((slow[3000].qdd_rad_s2[0] + 0.18 * 1.8f64.sin()).abs() < 0.03);
    assert!((out[3000].qdd_rad_s2[0] + 18.0 * 18.0f64.sin()).abs() < 0.6);
    // At rest nothing is learnt, and the default stands.
    let mut rest = input.clone();
    rest.iter_mut().for_each(|m| m.q_rad[0] = 0.3);
    let out = run(&mut make(&robot, "process_noise = \"auto\"").unwrap(), &rest);
    assert!(out.iter().all(|o| (o.q_rad[0] - 0.3).abs() < 1e-8 && o.qdd_rad_s2[0].abs() < 1e-2));
    assert_eq!(MOST_PROBED, 4096);
}

#[test]
fn given_noise_is_used_as_given() {
    let robot = encoder();
    let config: Config =
        toml::from_str("process_noise = [1e3, 2e3, 3e3]\nmeasurement_sd_rad = 1e-6\nmodel = \"constant_jerk\"")
            .unwrap();
    let input = measured(&regular(100, 2_000_000), 4);
    let settings = settings_for(&recording(&input), &config, &robot, None).unwrap();
    let found: Vec<(f64, f64)> = settings.noise.iter().map(|n| (n.process, n.measurement_sd)).collect();
    assert_eq!(found, [(1e3, 1e-6), (2e3, 1e-6), (3e3, 1e-6)]);
    assert!((settings.gap_s - 0.01).abs() < 1e-12);
    // The encoder's resolution: 2π/(2^20 · 33)/√12; and a bandwidth as asked for.
    let config: Config = toml::from_str("process_noise = { bandwidth_hz = 30 }").unwrap();
    let settings = settings_for(&recording(&input), &config, &robot, None).unwrap();
    let noise = settings.noise[0];
    assert!((noise.measurement_sd / 5.241_739e-8 - 1.0).abs() < 1e-5, "{noise:?}");
    assert!((noise.bandwidth_hz(settings.model, 2e-3) / 30.0 - 1.0).abs() < 1e-9);
}

#[test]
fn bad_configurations_are_refused_in_words() {
    let robot = encoder();
    for (config, word) in [
        ("lag_s = -1.0", "lag_s"),
        ("lag_s = nan", "lag_s"),
        ("lag_s = 0.1\nlag_samples = 3", "both"),
        ("lag_samples = 5000", "at most"),
        ("gap_s = 0", "gap_s"),
        ("period_s = inf", "period_s"),
        ("auto_s = 0", "auto_s"),
        ("process_noise = -1", "process_noise"),
        ("process_noise = [1, 2]", "per joint"),
        ("process_noise = \"fast\"", "process_noise"),
        ("process_noise = { bandwidth_hz = 0 }", "bandwidth"),
        ("measurement_sd_rad = [1e-6, nan, 1e-6]", "measurement_sd_rad"),
        ("model = \"constant_speed\"", "constant_speed"),
        ("lagg = 3", "lagg"),
    ] {
        let e = make(&robot, config).unwrap_err().to_string();
        assert!(e.contains(word) || word == "process_noise", "{config}: {e}");
        assert!(!e.contains('\n'));
    }
    let input = measured(&regular(50, 1_000_000), 5);
    let mut short = recording(&input);
    short.q_rad[2].pop();
    assert!(smooth_recording(&short, &Config::default(), &robot, None).unwrap_err().what.contains("49"));
    let mut back = recording(&input);
    back.t_s[7] = 0.0;
    assert!(smooth_recording(&back, &Config::default(), &robot, None).unwrap_err().what.contains("increasing"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever stamps and positions come: one output per input, in order, and the same twice.
    #[test]
    fn nothing_is_lost(
        steps in prop::collection::vec(prop_oneof![4 => 900_000i64..1_100_000, 1 => 0i64..3, 1 => -5_000_000i64..5_000_000_000], 1..200),
        bad in prop::collection::vec(any::<bool>(), 200),
        config in prop_oneof![Just(""), Just("lag_samples = 0"), Just("process_noise = \"auto\"\nauto_s = 0.05"), Just("period_s = 0.001\nlag_s = 0.005"), Just("model = \"constant_jerk\"")],
    ) {
        let stamps: Vec<i64> = steps.iter().scan(0i64, |t, s| { *t += s; Some(*t) }).collect();
        let mut input = measured(&stamps, 6);
        for (m, bad) in input.iter_mut().zip(bad) {
            if bad && m.header.seq % 5 == 0 { m.q_rad[0] = f64::INFINITY; }
        }
        let robot = robot("");
        let out = run(&mut make(&robot, config).unwrap(), &input);
        prop_assert_eq!(out.len(), input.len());
        for (o, m) in out.iter().zip(&input) {
            prop_assert_eq!(o.header.seq, m.header.seq);
            prop_assert!(o.q_rad.iter().chain(&o.qd_rad_s).chain(&o.qdd_rad_s2).chain(&o.sd_qdd_rad_s2).all(|v| v.is_finite()));
        }
        let again = run(&mut make(&robot, config).unwrap(), &input);
        prop_assert_eq!(out, again);
    }
}
