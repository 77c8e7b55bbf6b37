//! The estimator on made torques: mass and its interval, pick and place, what it must not take for mass, and
//! when it must say that it does not know.

use lacuna_interfaces::{BadInput, FrictionTorque, ModelFile, PayloadEstimate, RobotFile, Stage, StageContext, flag};
use lacuna_payload::{Config, Payload};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n";

fn robot() -> RobotFile {
    RobotFile::parse(DELTA).unwrap()
}

fn make(config: &str) -> Result<Payload, BadInput> {
    let config: Config = toml::from_str(config).map_err(|e| BadInput::from_toml(&e, config))?;
    Payload::new(config, &StageContext { robot: &robot(), urdf: None, model: None })
}

fn run(stage: &mut Payload, input: &[FrictionTorque]) -> Vec<PayloadEstimate> {
    let mut out = Vec::new();
    input.iter().for_each(|m| stage.step(m, &mut |o| out.push(*o)));
    stage.finish(&mut |o| out.push(*o));
    assert_eq!(out.len(), input.len());
    out
}

/// Made torques: columns of a few Nm/kg, velocities that reverse, and what the mass adds.
struct Motion {
    n: usize,
    noise_nm: f64,
    /// Autocorrelation of the noise from sample to sample.
    rho: f64,
    seed: u64,
}

impl Motion {
    fn new(n: usize) -> Self {
        Self { n, noise_nm: 0.2, rho: 0.0, seed: 1 }
    }

    fn torques(&self, mass: impl Fn(f64) -> f64) -> Vec<FrictionTorque> {
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let mut noise = [0.0; 3];
        (0..self.n)
            .map(|k| {
                let t = k as f64 * 1e-3;
                let mut m = FrictionTorque::default();
                m.header.seq = k as u64 + 1;
                m.header.stamp_ns = k as i64 * 1_000_000;
                m.header.joints = 3;
                m.header.flags = if k == 0 { flag::STATE_RESET } else { 0 };
                for i in 0..3 {
                    let phase = i as f64 * 2.1;
                    let z = lacuna_estimation::stats::normal_quantile(rng.random_range(1e-12..1.0));
                    noise[i] = self.rho * noise[i] + (1.0 - self.rho * self.rho).sqrt() * self.noise_nm * z;
                    m.qd_rad_s[i] = 2.0 * (7.0 * t + phase).cos();
                    m.payload_column_nm_kg[i] = -1.5 + 3.0 * (7.0 * t + phase).sin();
                    m.tau_rigid_nm[i] = 4.0 * m.payload_column_nm_kg[i];
                    m.tau_friction_nm[i] = 2.0 * m.qd_rad_s[i].signum();
                    let load = mass(t) * m.payload_column_nm_kg[i];
                    m.tau_nm[i] = m.tau_rigid_nm[i] + m.tau_friction_nm[i] + load + noise[i];
                }
                m
            })
            .collect()
    }
}

fn known(o: &PayloadEstimate) -> bool {
    o.header.flags & flag::NOT_EXCITED == 0
}

fn steps(out: &[PayloadEstimate]) -> Vec<usize> {
    (0..out.len()).filter(|&k| out[k].header.flags & flag::PAYLOAD_STEP != 0).collect()
}

#[test]
fn constant_mass_and_the_fields_passed_on() {
    let input = Motion::new(2000).torques(|_| 1.7);
    let out = run(&mut make("").unwrap(), &input);
    for (o, m) in out.iter().zip(&input) {
        assert_eq!(
            (o.header.seq, o.header.stamp_ns, o.q_rad, o.tau_nm),
            (m.header.seq, m.header.stamp_ns, m.q_rad, m.tau_nm)
        );
        for i in 0..3 {
            let model = m.tau_rigid_nm[i] + m.tau_friction_nm[i];
            assert!((o.tau_model_nm[i] - model).abs() < 1e-12);
            assert!((o.residual_nm[i] - (m.tau_nm[i] - model)).abs() < 1e-12);
            let left = o.residual_nm[i] - o.mass_kg * m.payload_column_nm_kg[i];
            assert!((o.residual_payload_nm[i] - left).abs() < 1e-12);
        }
    }
    assert!(!known(&out[0]) && out[0].sd_mass_kg == 1000.0);
    assert!(out[300..].iter().all(|o| known(o) && (o.mass_kg - 1.7).abs() < 0.05 && o.sd_mass_kg < 0.02));
    assert!(steps(&out).is_empty());
}

#[test]
fn pick_and_place_settle_within_tenths_of_a_second() {
    let load = |t: f64| if (1.0..2.5).contains(&t) { 3.8 } else { 0.0 };
    let out = run(&mut make("").unwrap(), &Motion::new(4000).torques(load));
    let at = steps(&out);
    assert_eq!(at.len(), 2, "{at:?}");
    assert!((1000..1050).contains(&at[0]) && (2500..2550).contains(&at[1]), "{at:?}");
    for k in (300..1000).chain(1100..2500).chain(2600..4000) {
        assert!((out[k].mass_kg - load(k as f64 * 1e-3)).abs() < 0.03 * 3.8, "{k}: {}", out[k].mass_kg);
        assert!(known(&out[k]), "{k}");
    }
    // Each rise to the new mass was announced: no wrong number claims to be settled for more than 50 ms.
    let wrong = (1000..1100).filter(|&k| known(&out[k]) && (out[k].mass_kg - 3.8).abs() > 0.2).count();
    assert!(wrong < 50, "{wrong}");
}

#[test]
fn slow_drift_is_followed() {
    let out = run(&mut make("forgetting_s = 0.2").unwrap(), &Motion::new(5000).torques(|t| 1.0 + 0.1 * t));
    assert!((1000..5000).all(|k| (out[k].mass_kg - 1.0 - 1e-4 * k as f64).abs() < 0.08));
}

/// Errors correlated over time: the interval must still hold the truth. 200 runs, sampled where the forgetting
/// has made the estimates independent of the start.
#[test]
fn intervals_cover_white_and_correlated_errors() {
    for (rho, low) in [(0.0, 0.90), (0.9, 0.88), (0.97, 0.85)] {
        let (mut inside, mut total) = (0, 0);
        for seed in 0..100 {
            let input = Motion { rho, seed, ..Motion::new(6000) }.torques(|_| 1.0);
            let out = run(&mut make("max_sd_kg = 1.0").unwrap(), &input);
            for o in [&out[3999], &out[5999]] {
                total += 1;
                inside += usize::from((o.mass_kg - 1.0).abs() < 1.96 * o.sd_mass_kg);
            }
        }
        let share = f64::from(inside as u32) / f64::from(total as u32);
        assert!((low..=0.995).contains(&share), "rho {rho}: {share}");
    }
}

#[test]
fn unknown_where_nothing_tells_the_mass() {
    let clean = Motion::new(3000).torques(|_| 1.0);
    // All joints stand from 1.5 s on; the payload is taken away unseen and motion resumes at 2.5 s.
    let mut rest = Motion::new(4000).torques(|t| if t < 2.0 { 1.0 } else { 0.0 });
    for m in &mut rest[1500..2500] {
        m.standstill = 0b111;
        m.header.flags |= flag::STANDSTILL;
        m.qd_rad_s = [0.0; 8];
        m.tau_nm = m.tau_rigid_nm;
    }
    let out = run(&mut make("").unwrap(), &rest);
    assert!(out[1575..2500].iter().all(|o| !known(o)));
    for (k, o) in out.iter().enumerate().skip(2500) {
        assert!(!known(o) || o.mass_kg.abs() < 0.25, "{k}: {} ± {}", o.mass_kg, o.sd_mass_kg);
    }
    assert!(out[2600..].iter().all(known));
    // No column, drive off, no model torque: flagged at once.
    for spoil in [
        (|m: &mut FrictionTorque| m.payload_column_nm_kg = [0.0; 8]) as fn(&mut FrictionTorque),
        |m| m.header.flags |= flag::DRIVE_OFF,
        |m| m.header.flags |= flag::UNREACHABLE,
    ] {
        let mut input = clean.clone();
        input[1500..2000].iter_mut().for_each(spoil);
        let out = run(&mut make("").unwrap(), &input);
        assert!(out[1000..1500].iter().all(known) && !out[1600..2000].iter().any(known));
        assert!(out[2100..].iter().all(|o| known(o) && (o.mass_kg - 1.0).abs() < 0.05));
    }
    // Never excited at all: no number ever.
    let mut still = clean;
    still.iter_mut().for_each(|m| m.standstill = 0b111);
    let out = run(&mut make("").unwrap(), &still);
    assert!(out.iter().all(|o| !known(o) && o.mass_kg == 0.0 && o.sd_mass_kg == 1000.0));
}

#[test]
fn what_is_not_mass_makes_no_step() {
    let base = Motion::new(4000).torques(|_| 1.0);
    // Friction 30 % too low on one joint; its sign wrong for 20 ms after each reversal.
    let mut friction = base.clone();
    for m in &mut friction {
        m.tau_nm[0] += 0.6 * m.qd_rad_s[0].signum();
    }
    let mut signs = base.clone();
    for k in 1..signs.len() {
        for i in 0..3 {
            if signs[k].qd_rad_s[i] * signs[k - 1].qd_rad_s[i] < 0.0 {
                let until = (k + 10).min(signs.len());
                let wrong = 4.0 * signs[k].qd_rad_s[i].signum();
                signs[k.saturating_sub(10)..until].iter_mut().for_each(|m| m.tau_nm[i] += wrong);
            }
        }
    }
    // A collision pushes two joints for 40 ms; torque spikes of single samples.
    let mut collision = base.clone();
    for (j, m) in collision[2000..2040].iter_mut().enumerate() {
        let force = (std::f64::consts::PI * j as f64 / 40.0).sin();
        m.tau_nm[0] += 12.0 * force;
        m.tau_nm[1] += 12.0 * force * m.payload_column_nm_kg[1].signum() * -m.payload_column_nm_kg[0].signum();
    }
    let mut spikes = base.clone();
    (500..4000).step_by(97).for_each(|k| spikes[k].tau_nm[k % 3] += 30.0);
    for (name, input, most) in
        [("friction", friction, 0.15), ("signs", signs, 0.05), ("collision", collision, 0.3), ("spikes", spikes, 0.05)]
    {
        let out = run(&mut make("").unwrap(), &input);
        assert_eq!(steps(&out), Vec::<usize>::new(), "{name}");
        let worst = out[400..].iter().map(|o| (o.mass_kg - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < most, "{name}: {worst} kg");
    }
}

/// With one joint any torque error looks like some mass; an error of its own kind at every reversal must end in
/// the interval, not in a series of picks and places.
#[test]
fn a_single_joint_with_wrong_friction_sees_no_picks() {
    let robot = RobotFile::parse("kind = \"serial\"\nname = \"s\"\njoints = [\"j\"]\n[[dh]]\na = 1.0\n").unwrap();
    let context = StageContext { robot: &robot, urdf: None, model: None };
    for error_nm in [0.2, 0.5, 1.0] {
        let mut input = Motion::new(8000).torques(|_| 2.0);
        for m in &mut input {
            m.header.joints = 1;
            m.tau_nm[0] += error_nm * m.qd_rad_s[0].signum();
        }
        let out = run(&mut Payload::new(Config::default(), &context).unwrap(), &input);
        assert!(steps(&out[1000..]).is_empty(), "{error_nm} Nm: {:?}", steps(&out));
        // Where the mass is called known, it is so within what it says.
        let claimed: Vec<&PayloadEstimate> = out[1000..].iter().filter(|o| known(o)).collect();
        assert!(error_nm > 0.3 || claimed.len() > 3000, "{error_nm} Nm: {} known", claimed.len());
        let within = claimed.iter().filter(|o| (o.mass_kg - 2.0).abs() < 3.0 * o.sd_mass_kg).count();
        assert!(within as f64 >= 0.9 * claimed.len() as f64, "{error_nm} Nm: {within} of {}", claimed.len());
    }
}

#[test]
fn noise_of_the_model_file_is_used_from_the_start() {
    let mut model = ModelFile::nominal(&robot());
    model.noise.sd_tau_nm = vec![0.2; 3];
    let robot = robot();
    let context = StageContext { robot: &robot, urdf: None, model: Some(&model) };
    let input = Motion::new(400).torques(|_| 2.0);
    let first = |out: &[PayloadEstimate]| out.iter().position(known).unwrap();
    let with = run(&mut Payload::new(Config::default(), &context).unwrap(), &input);
    let without = run(&mut make("").unwrap(), &input);
    assert!(first(&with) < first(&without));
    model.robot = "other".to_owned();
    let context = StageContext { robot: &robot, urdf: None, model: Some(&model) };
    assert!(Payload::new(Config::default(), &context).is_err());
}

#[test]
fn clamping_is_an_option() {
    let input = Motion { noise_nm: 1.0, ..Motion::new(2000) }.torques(|_| 0.0);
    let free = run(&mut make("").unwrap(), &input);
    let clamped = run(&mut make("clamp_at_zero = true").unwrap(), &input);
    assert!(free.iter().any(|o| o.mass_kg < 0.0));
    assert!(free.iter().zip(&clamped).all(|(f, c)| c.mass_kg == f.mass_kg.max(0.0)));
}

#[test]
fn bad_configurations_are_refused_in_words() {
    for (config, word) in [
        ("forgetting_s = 0", "forgetting_s"),
        ("detection_s = nan", "detection_s"),
        ("detection_s = 2.0", "at most"),
        ("reversal_s = -1", "reversal_s"),
        ("max_sd_kg = 0", "max_sd_kg"),
        ("prior_sd_kg = inf", "prior_sd_kg"),
        ("forget = 1", "forget"),
    ] {
        let e = make(config).unwrap_err().to_string();
        assert!(e.contains(word), "{config}: {e}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Joints have no order; torque has no unit of its own: with torques and columns in other units the mass stays.
    #[test]
    fn estimate_is_invariant(seed in 0u64..1000, mass in -2.0..5.0f64, unit in 0.01..100.0f64) {
        let input = Motion { seed, ..Motion::new(600) }.torques(|t| if t < 0.3 { 0.0 } else { mass });
        let out = run(&mut make("").unwrap(), &input);
        let turned: Vec<FrictionTorque> = input.iter().map(|m| {
            let mut o = *m;
            for list in [&mut o.qd_rad_s, &mut o.tau_nm, &mut o.tau_rigid_nm, &mut o.tau_friction_nm, &mut o.payload_column_nm_kg] {
                list[..3].rotate_left(1);
            }
            o
        }).collect();
        let scaled: Vec<FrictionTorque> = input.iter().map(|m| {
            let mut o = *m;
            for list in [&mut o.tau_nm, &mut o.tau_rigid_nm, &mut o.tau_friction_nm, &mut o.payload_column_nm_kg] {
                list.iter_mut().for_each(|v| *v *= unit);
            }
            o
        }).collect();
        for (other, tolerance) in [(turned, 1e-9), (scaled, 1e-6)] {
            let other = run(&mut make("").unwrap(), &other);
            for (a, b) in out.iter().zip(&other).skip(100) {
                prop_assert!((a.mass_kg - b.mass_kg).abs() < tolerance, "{} {}", a.mass_kg, b.mass_kg);
            }
            prop_assert_eq!(steps(&out), steps(&other));
        }
    }

    /// No input makes it panic, and the mass stays a number.
    #[test]
    fn survives_anything(
        values in prop::collection::vec((prop::num::f64::ANY, prop::num::f64::ANY, prop::num::f64::ANY, any::<i64>(), any::<u32>(), any::<u32>()), 0..200)
    ) {
        let mut stage = make("").unwrap();
        for (a, b, c, stamp, flags, standstill) in values {
            let mut m = FrictionTorque { tau_nm: [a; 8], payload_column_nm_kg: [b; 8], qd_rad_s: [c; 8], standstill, ..FrictionTorque::default() };
            m.header.stamp_ns = stamp;
            m.header.flags = flags;
            let mut emitted = 0;
            stage.step(&m, &mut |o| {
                emitted += 1;
                assert!(!o.mass_kg.is_nan() && !o.sd_mass_kg.is_nan(), "{o:?}");
            });
            prop_assert_eq!(emitted, 1);
        }
    }
}
