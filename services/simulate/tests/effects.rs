//! Every effect does to the recordings what its law says, and nothing where the law says nothing. Laws are
//! written out here in closed form; the plant has them as contacts, springs, bodies and sensors.

use lacuna_interfaces::RobotFile;
use lacuna_simulate::config::{FrictionConfig, NoiseConfig, TrajectoryGroup};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::effects::{Scales, draw_effect, registry};
use lacuna_simulate::plant::TrueRobot;
use lacuna_simulate::random::Random;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{Simulation, SimulationConfig, TrueEffect, simulate};

const FC: [f64; 3] = [2.0, 2.2, 1.8];
const FV: [f64; 3] = [0.5, 0.6, 0.4];
/// Slower than this a joint may be sticking, and its friction is any torque within the level.
const SLIDING: f64 = 0.05;

fn quiet(kinds: &[Kinds], effects: Vec<TrueEffect>) -> SimulationConfig {
    let group = |kind: &Kinds| TrajectoryGroup { kind: *kind, duration_s: 4.0, count: 1, intensity: 0.9 };
    SimulationConfig {
        seed: 3,
        trajectories: kinds.iter().map(group).collect(),
        friction: FrictionConfig { none: false, f_c: FC.to_vec(), f_v: FV.to_vec() },
        noise: NoiseConfig {
            torque_nm: vec![0.0; 3],
            encoder_steps: 0.0,
            process_share: 0.0,
            spikes_per_s: 0.0,
            encoder_step_rad: Some(0.0),
        },
        effects,
        ..SimulationConfig::default()
    }
}

fn robot() -> RobotFile {
    RobotFile::parse(DEMO_ROBOT).unwrap()
}

fn run(kinds: &[Kinds], effects: Vec<TrueEffect>) -> Simulation {
    simulate(&robot(), None, &quiet(kinds, effects)).unwrap()
}

/// One noise-free log sample of one joint.
struct Sample {
    t: f64,
    q: f64,
    v: f64,
    a: f64,
    tau: f64,
    hidden: f64,
}

/// Visits every sample of joint `i` that slides steadily: neither sticking nor about to.
fn sliding(s: &Simulation, i: usize, mut visit: impl FnMut(&Sample)) {
    let mut count = 0;
    for (l, r) in s.behind.iter().zip(&s.recordings) {
        for k in 3..r.len() - 3 {
            let v = &l.qd_rad_s[i];
            if (k - 3..=k + 3).any(|j| v[j] * v[k] <= 0.0) || v[k].abs() <= SLIDING {
                continue;
            }
            count += 1;
            visit(&Sample {
                t: r.t_s[k],
                q: l.q_rad[i][k],
                v: l.qd_rad_s[i][k],
                a: l.qdd_rad_s2[i][k],
                tau: l.tau_nm[i][k],
                hidden: l.hidden_nm[i][k],
            });
        }
    }
    assert!(count > 1000, "only {count} samples slide");
}

/// Holds hidden torque minus base friction against `law` on joint `i` and returns the law's RMS.
fn holds(s: &Simulation, i: usize, tolerance: f64, law: impl Fn(&Sample) -> f64) -> f64 {
    let (mut square, mut error, mut worst, mut n) = (0.0, 0.0, 0.0f64, 0.0);
    sliding(s, i, |x| {
        let expected = law(x);
        let found = x.hidden - FC[i] * x.v.signum() - FV[i] * x.v;
        square += expected * expected;
        error += (found - expected).powi(2);
        worst = worst.max((found - expected).abs());
        n += 1.0;
    });
    let (rms, error) = (f64::sqrt(square / n), f64::sqrt(error / n));
    assert!(error < tolerance, "joint {}: law off by {error:.1e} Nm RMS (worst {worst:.1e}) of {rms:.2} Nm", i + 1);
    rms
}

const ALL: &[Kinds] = &[Kinds::PointToPoint, Kinds::Fourier, Kinds::Sweep];

#[test]
fn without_effects_nothing_but_base_friction_is_hidden() {
    let s = run(ALL, Vec::new());
    for i in 0..3 {
        holds(&s, i, 0.01, |_| 0.0);
    }
}

#[test]
fn pointwise_laws_hold_on_their_joint_and_nowhere_else() {
    type Law = fn(&Sample) -> f64;
    type Parameters = Vec<(&'static str, f64)>;
    let cases: Vec<(&str, Parameters, Law)> = vec![
        ("coulomb", vec![("f_c", 0.7)], |x| 0.7 * x.v.signum()),
        ("viscous", vec![("f_v", 0.3)], |x| 0.3 * x.v),
        ("coulomb_asym", vec![("a_c", 0.6)], |_| 0.6),
        ("torque_offset", vec![("tau_0", -0.8)], |_| -0.8),
        ("stribeck", vec![("f_sc", 1.5), ("v_s", 0.2)], |x| 1.5 * (-(x.v / 0.2).powi(2)).exp() * x.v.signum()),
        ("viscous_power", vec![("a", 0.05), ("p", 2.2)], |x| 0.05 * x.v.abs().powf(2.2) * x.v.signum()),
        ("viscous_power", vec![("a", 0.9), ("p", 0.5)], |x| 0.9 * x.v.abs().sqrt() * x.v.signum()),
        ("cogging", vec![("a_s", 0.4), ("a_c", -0.3), ("h", 2.0)], |x| {
            // The log's 1 ms mean takes part of a ripple that turns h N θ̇ in a second.
            let half = 0.5e-3 * 66.0 * x.v;
            let mean = if half.abs() > 1e-9 { half.sin() / half } else { 1.0 };
            mean * (0.4 * (66.0 * x.q).sin() - 0.3 * (66.0 * x.q).cos())
        }),
        ("rotor_inertia", vec![("J", 0.03)], |x| 0.03 * x.a),
        ("gravity_spring", vec![("a_s", 1.5), ("a_c", 0.8)], |x| 1.5 * x.q.sin() + 0.8 * x.q.cos()),
        ("cable_spring", vec![("k_1", 1.0), ("k_3", 2.0), ("q_0", 0.3)], |x| (x.q - 0.3) + 2.0 * (x.q - 0.3).powi(3)),
        ("kt_scale", vec![("g", 0.08)], |x| x.tau * 0.08 / 1.08),
        ("torque_saturation", vec![("a", 0.3), ("tau_k", 6.0)], |x| {
            // τ (1 + a (τ − τ_k)/τ_k) = u is a quadratic in τ: a τ² + (1 − a) τ_k τ − u τ_k = 0.
            let (a, k, u) = (0.3f64, 6.0f64, x.tau.abs());
            let root = ((k * (1.0 - a)).powi(2) + 4.0 * a * u * k).sqrt();
            let true_torque = if u > k { (root - k * (1.0 - a)) / (2.0 * a) } else { u };
            (x.tau.abs() - true_torque) * x.tau.signum()
        }),
        ("dent", vec![("height", 2.0), ("at", 0.5), ("width", 0.1)], |x| {
            2.0 * (-((x.q - 0.5) / 0.1).powi(2)).exp() * x.v.signum()
        }),
        ("eddy_brake", vec![("peak", 1.5), ("v_c", 2.0)], |x| 2.0 * 1.5 * x.v * 2.0 / (x.v * x.v + 4.0)),
    ];
    for (id, params, law) in cases {
        let s = run(ALL, vec![TrueEffect::new(id, &["q2"], &params)]);
        println!("{id}");
        let rms = holds(&s, 1, 0.02, law);
        assert!(rms > 0.05, "{id} does almost nothing: {rms} Nm");
        holds(&s, 0, 0.01, |_| 0.0);
        holds(&s, 2, 0.01, |_| 0.0);
    }
}

#[test]
fn load_friction_follows_what_the_gear_passes_on() {
    let s = run(ALL, vec![TrueEffect::new("load_friction", &["q1"], &[("mu", 0.08), ("mu_v", 0.01)])]);
    // What the gear passes: executed torque less friction less rotor; solved for the load, whose sign is that
    // of what is left.
    let rms = holds(&s, 0, 0.03, |x| {
        let rest = x.tau - FC[0] * x.v.signum() - FV[0] * x.v - 0.06 * x.a;
        let b = 0.08 * x.v.signum() + 0.01 * x.v;
        let load = if rest / (1.0 + b) >= 0.0 { rest / (1.0 + b) } else { rest / (1.0 - b) };
        load.abs() * b
    });
    assert!(rms > 0.1, "{rms}");
    holds(&s, 1, 0.01, |_| 0.0);
}

#[test]
fn thermal_friction_fades_with_time_since_the_cold_start() {
    let mut config = quiet(
        &[Kinds::Fourier, Kinds::Fourier, Kinds::Fourier],
        vec![TrueEffect::new("thermal_viscous", &[], &[("b", 0.6), ("tau_w", 12.0)])],
    );
    config.log.pause_s = 6.0;
    config.log.temperature = true;
    let s = simulate(&robot(), None, &config).unwrap();
    assert!(s.manifest.files[2].start_time_s > 10.0);
    for (k, (r, l)) in s.recordings.iter().zip(&s.behind).enumerate() {
        let start = s.manifest.files[k].start_time_s;
        let mut error = 0.0f64;
        for j in 10..r.len() {
            let v = l.qd_rad_s[2][j];
            if v.abs() > 0.3 {
                let law = 0.6 * (-(start + r.t_s[j]) / 12.0).exp() * v;
                error = error.max((l.hidden_nm[2][j] - FC[2] * v.signum() - FV[2] * v - law).abs());
            }
        }
        assert!(error < 0.05, "recording {k}: {error}");
        assert!(r.extra["temp3"].iter().all(|t| (23.0..45.0).contains(t)));
    }
    let mean = |k: usize| s.recordings[k].extra["temp1"].iter().sum::<f64>() / 4000.0;
    assert!(mean(2) > mean(0) + 3.0, "a drive that is used gets warm");
}

#[test]
fn rubbing_is_on_for_its_duty_and_off_otherwise() {
    let effect = TrueEffect::new("rubbing", &["q1"], &[("level", 1.2), ("period", 1.0), ("duty", 0.4)]);
    let s = run(&[Kinds::Fourier], vec![effect]);
    let rms = holds(&s, 0, 0.06, |x| if x.t.rem_euclid(1.0) < 0.4 { 1.2 * x.v.signum() } else { 0.0 });
    assert!(rms > 0.3);
}

#[test]
fn presliding_vanishes_in_steady_sliding_and_bends_after_reversals() {
    for law in [0.0, 1.0, 2.0] {
        let travel = 0.02;
        let effect = TrueEffect::new("presliding", &["q2"], &[("delta", travel), ("law", law)]);
        let s = run(ALL, vec![effect]);
        let (mut bent, mut missing) = (0, 0.0f64);
        for l in &s.behind {
            let mut since = 0.0;
            let mut last = 0.0f64;
            for k in 1..l.t_s.len() {
                let v = l.qd_rad_s[1][k];
                if v * last < 0.0 || v == 0.0 {
                    since = 0.0;
                }
                last = v;
                since += (l.q_rad[1][k] - l.q_rad[1][k - 1]).abs();
                let friction = l.hidden_nm[1][k] - FV[1] * v;
                if since > 12.0 * travel {
                    missing = missing.max((friction - FC[1] * v.signum()).abs());
                } else if since > 0.0 && since < 0.3 * travel && v.abs() > 0.02 && friction * v.signum() < 0.5 * FC[1] {
                    bent += 1;
                }
            }
        }
        assert!(missing < 0.03, "law {law}: {missing} Nm are missing while sliding");
        assert!(bent > 20, "law {law}: only {bent} samples are bent after reversals");
    }
}

#[test]
fn elasticity_satisfies_the_spring_and_the_link_equation() {
    let (k, zeta) = (4000.0, 0.05);
    let s = run(&[Kinds::Fourier], vec![TrueEffect::new("elasticity", &["q1"], &[("k", k), ("zeta", zeta)])]);
    // q_link = θ − (τ − friction − J_r θ̈)/k, then the rigid robot at the links must need that torque.
    let l = &s.behind[0];
    let n = l.t_s.len();
    let spring: Vec<f64> = (0..n)
        .map(|j| {
            let v = l.qd_rad_s[0][j];
            l.tau_nm[0][j] - FC[0] * v.signum() - FV[0] * v - 0.06 * l.qdd_rad_s2[0][j]
        })
        .collect();
    // The spring's damper takes its share: d = 2 ζ √(k M), M the link side's inertia at mid-range.
    let nominal = TrueRobot::nominal(&robot(), None).unwrap();
    let scales = Scales::of(&robot(), &nominal).unwrap();
    let damping = 2.0 * zeta * (k * (scales.inertia[0] - 0.06)).sqrt();
    let bend: Vec<f64> = {
        let mut bend: Vec<f64> = spring.iter().map(|t| t / k).collect();
        for _ in 0..4 {
            let rate: Vec<f64> =
                (0..n).map(|j| (bend[(j + 1).min(n - 1)] - bend[j.saturating_sub(1)]) / 2e-3).collect();
            bend = (0..n).map(|j| (spring[j] - damping * rate[j]) / k).collect();
        }
        bend
    };
    let link: Vec<f64> = (0..n).map(|j| l.q_rad[0][j] - bend[j]).collect();
    let (mut error, mut naive, mut size, mut count) = (0.0, 0.0, 0.0, 0.0);
    for j in 10..n - 10 {
        // A reversal of any joint jerks all of them within one sample of the log.
        if (0..3).any(|i| (j - 6..j + 6).any(|k| l.qd_rad_s[i][k].abs() < 0.05)) {
            continue;
        }
        let d = |x: &[f64]| (8.0 * (x[j + 1] - x[j - 1]) - x[j + 2] + x[j - 2]) / 12e-3;
        let dd = |x: &[f64]| (-x[j + 2] + 16.0 * x[j + 1] - 30.0 * x[j] + 16.0 * x[j - 1] - x[j - 2]) / 12e-6;
        let (mut q, mut qd, mut qdd) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for i in 0..3 {
            q[i] = l.q_rad[i][j];
            qd[i] = l.qd_rad_s[i][j];
            qdd[i] = l.qdd_rad_s2[i][j];
        }
        let loads = nominal.loads(0.0, &[]);
        naive += (nominal.mechanism.inverse(&q, &qd, &qdd, &loads).unwrap()[0] - spring[j]).powi(2);
        (q[0], qd[0], qdd[0]) = (link[j], d(&link), dd(&link));
        error += (nominal.mechanism.inverse(&q, &qd, &qdd, &loads).unwrap()[0] - spring[j]).powi(2);
        size += spring[j] * spring[j];
        count += 1.0;
    }
    assert!(count > 1000.0);
    let (error, naive, size) = ((error / count).sqrt(), f64::sqrt(naive / count), (size / count).sqrt());
    assert!(error < 0.02 * naive && error < 2e-3 * size, "{error} with the spring, {naive} without, of {size} Nm");
}

#[test]
fn backlash_shows_when_the_load_changes_flanks_and_not_while_it_rests_on_one() {
    let effect = || vec![TrueEffect::new("backlash", &["q1"], &[("b", 3e-3), ("k", 20_000.0), ("zeta", 0.2)])];
    let size = |kind: Kinds, intensity: f64| {
        let mut config = quiet(&[kind], effect());
        config.trajectories[0].intensity = intensity;
        config.measure_effects = true;
        simulate(&robot(), None, &config).unwrap().truth.effects[0].rms_nm[0]
    };
    // Slow: gravity keeps the gear on one flank. Fast: the link swings through the gap.
    let (slow, fast) = (size(Kinds::PointToPoint, 0.1), size(Kinds::PointToPoint, 1.0));
    assert!(slow < 0.1 && fast > 5.0 * slow, "slow {slow} Nm, fast {fast} Nm");
}

#[test]
fn late_torque_is_the_same_torque_later() {
    let on_time = run(&[Kinds::Fourier], Vec::new());
    let late = run(&[Kinds::Fourier], vec![TrueEffect::new("torque_delay", &[], &[("D", 2e-3)])]);
    assert_eq!(on_time.recordings[0].q_rad, late.recordings[0].q_rad);
    for i in 0..3 {
        let (a, b) = (&on_time.recordings[0].tau_nm[i], &late.recordings[0].tau_nm[i]);
        assert!((2..a.len()).all(|k| (b[k] - a[k - 2]).abs() < 2e-5));
        assert_ne!(a, b);
    }
}

#[test]
fn homing_error_moves_the_readings_and_nothing_else() {
    let s = run(&[Kinds::PointToPoint], vec![TrueEffect::new("encoder_offset", &["q3"], &[("q_0", 0.02)])]);
    // Standing at the start, the torque is that of the true pose: readings plus q_0 on joint 3.
    let nominal = TrueRobot::nominal(&robot(), None).unwrap();
    let l = &s.behind[0];
    let k = 300;
    let mut q = [0.0; 8];
    (0..3).for_each(|i| q[i] = l.q_rad[i][k]);
    q[2] += 0.02;
    let loads = nominal.loads(0.0, &[]);
    let (mut qd, mut qdd) = ([0.0; 8], [0.0; 8]);
    (0..3).for_each(|i| (qd[i], qdd[i]) = (l.qd_rad_s[i][k], l.qdd_rad_s2[i][k]));
    let tau = nominal.mechanism.inverse(&q, &qd, &qdd, &loads).unwrap();
    for i in 0..3 {
        let friction = FC[i] * qd[i].signum() + FV[i] * qd[i];
        if qd[i].abs() > SLIDING {
            let rotor = nominal.joints[i].rotor * qdd[i];
            assert!((l.tau_nm[i][k] - tau[i] - rotor - friction).abs() < 0.02);
        } else {
            assert!((l.tau_nm[i][k] - tau[i]).abs() <= FC[i] + 0.05);
        }
    }
}

#[test]
fn payload_is_carried_between_its_events_only_and_weighs_what_it_says() {
    let s = run(&[Kinds::PickPlace], vec![TrueEffect::new("payload", &[], &[("m", 2.0)])]);
    let events = &s.truth.events["traj_01.csv"];
    assert!(events.len() >= 2 && events.iter().all(|e| e.kind == "payload" && e.mass == 2.0));
    let carried = |t: f64| events.iter().any(|e| t > e.t_on + 2e-3 && t < e.t_off - 2e-3);
    let free = |t: f64| events.iter().all(|e| t < e.t_on - 2e-3 || t > e.t_off + 2e-3);
    let l = &s.behind[0];
    let nominal = TrueRobot::nominal(&robot(), None).unwrap();
    let lacuna_simulate::plant::Mechanism::Delta(delta) = &nominal.mechanism else { panic!("a Delta") };
    let (mut with, mut without) = (0, 0);
    for k in 10..l.t_s.len() - 10 {
        if (0..3).any(|i| (k - 3..=k + 3).any(|j| l.qd_rad_s[i][j].abs() < SLIDING)) {
            continue;
        }
        let rest: Vec<f64> =
            (0..3).map(|i| l.hidden_nm[i][k] - FC[i] * l.qd_rad_s[i][k].signum() - FV[i] * l.qd_rad_s[i][k]).collect();
        if free(l.t_s[k]) {
            without += 1;
            assert!(rest.iter().all(|r| r.abs() < 0.05), "t {}: {rest:?}", l.t_s[k]);
        } else if carried(l.t_s[k]) {
            with += 1;
            // Virtual work with differences of the platform's path: m (ẍ + g)·∂x/∂θ.
            let x = |k: usize, i: Option<usize>, d: f64| {
                let mut q = [0.0; 8];
                (0..3).for_each(|j| q[j] = l.q_rad[j][k] + if i == Some(j) { d } else { 0.0 });
                delta.forward(&q).unwrap()
            };
            let mut pull = (x(k + 5, None, 0.0) - 2.0 * x(k, None, 0.0) + x(k - 5, None, 0.0)) / 25e-6;
            pull.z += 9.81;
            for i in 0..3 {
                let column = (x(k, Some(i), 1e-5) - x(k, Some(i), -1e-5)) / 2e-5;
                let expected = 2.0 * column.dot(&pull);
                assert!((rest[i] - expected).abs() < 0.3 + 0.05 * expected.abs(), "{} {expected}", rest[i]);
            }
        }
    }
    assert!(with > 300 && without > 100, "{with} {without}");
}

#[test]
fn turning_payload_swings_with_the_wrist_and_collision_is_over_when_it_is_over() {
    let ecc = [("m_x", 0.06), ("omega", 20.0), ("t_on", 1.0), ("t_off", 3.0)];
    let s = run(&[Kinds::Fourier], vec![TrueEffect::new("payload_ecc", &[], &ecc)]);
    let hit = [("F_z", 80.0), ("t_0", 1.5), ("T", 0.05)];
    let c = run(&[Kinds::Fourier], vec![TrueEffect::new("collision", &[], &hit)]);
    for (s, on, off, least) in [(&s, 1.0, 3.0, 1.0), (&c, 1.5, 1.55, 3.0)] {
        let mut inside = 0.0f64;
        for i in 0..3 {
            sliding(s, i, |x| {
                let rest = (x.hidden - FC[i] * x.v.signum() - FV[i] * x.v).abs();
                if x.t > on + 2e-3 && x.t < off - 2e-3 {
                    inside = inside.max(rest);
                } else if x.t < on - 2e-3 || x.t > off + 2e-3 {
                    assert!(rest < 0.05, "joint {} t {}: {rest}", i + 1, x.t);
                }
            });
        }
        assert!(inside > least, "{inside}");
    }
}

#[test]
fn tilt_and_drag_and_ball_friction_act_where_their_cause_is() {
    // Tilt: at rest, torque of gravity turned by a known angle; level again for zero.
    let tilted = run(&[Kinds::PointToPoint], vec![TrueEffect::new("base_tilt", &[], &[("tilt_1", 0.05)])]);
    let nominal = TrueRobot::nominal(&robot(), None).unwrap();
    let mut leaning = nominal.clone();
    leaning.gravity = nalgebra::Vector3::new(9.81 * 0.05f64.sin(), 0.0, -9.81 * 0.05f64.cos());
    let l = &tilted.behind[0];
    let mut checked = 0;
    for k in (100..l.t_s.len() - 100).step_by(7) {
        if (0..3).any(|i| l.qd_rad_s[i][k].abs() < SLIDING) {
            continue;
        }
        let (mut q, mut qd, mut qdd) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        (0..3).for_each(|i| (q[i], qd[i], qdd[i]) = (l.q_rad[i][k], l.qd_rad_s[i][k], l.qdd_rad_s2[i][k]));
        let torque = |r: &TrueRobot| r.mechanism.inverse(&q, &qd, &qdd, &r.loads(0.0, &[])).unwrap();
        let (a, b) = (torque(&leaning), torque(&nominal));
        for i in 0..3 {
            let rest = l.hidden_nm[i][k] - FC[i] * qd[i].signum() - FV[i] * qd[i];
            assert!((rest - (a[i] - b[i])).abs() < 0.02);
        }
        checked += 1;
    }
    assert!(checked > 50, "{checked}");
    // Drag and ball friction take energy: the hidden torque's power is positive in sum over joints, and the
    // drag's grows with the third power of the speed.
    for effect in [
        TrueEffect::new("air_drag", &[], &[("c", 3.0)]),
        TrueEffect::new("ball_friction", &[], &[("mu", 0.3), ("b", 0.05)]),
    ] {
        let s = run(&[Kinds::Fourier], vec![effect.clone()]);
        let l = &s.behind[0];
        let mut taken = 0;
        for k in 5..l.t_s.len() - 5 {
            if (0..3).any(|i| (k - 3..=k + 3).any(|j| l.qd_rad_s[i][j].abs() < SLIDING)) {
                continue;
            }
            let power: f64 = (0..3)
                .map(|i| {
                    let v = l.qd_rad_s[i][k];
                    (l.hidden_nm[i][k] - FC[i] * v.signum() - FV[i] * v) * v
                })
                .sum();
            assert!(power > -0.05, "{} gives energy: {power} W", effect.id);
            taken += usize::from(power > 0.1);
        }
        assert!(taken > 500, "{}: {taken}", effect.id);
    }
}

#[test]
fn drawn_effects_fit_their_own_registry_and_robot() {
    let serial =
        lacuna_simulate::case::draw_robot(lacuna_interfaces::robot::Kind::Serial, &mut Random::new(4, 0)).unwrap();
    for robot in [robot(), serial] {
        let nominal = TrueRobot::nominal(&robot, None).unwrap();
        let scales = Scales::of(&robot, &nominal).unwrap();
        let mut random = Random::new(1, 1);
        for effect in registry() {
            if effect.kind.is_some_and(|k| k != robot.kind) {
                assert!(draw_effect(effect.id, &robot, &scales, 1.0, &mut random).is_err());
                continue;
            }
            for severity in [0.3, 1.0, 2.0] {
                let drawn = draw_effect(effect.id, &robot, &scales, severity, &mut random).unwrap();
                let mut config = SimulationConfig { effects: vec![drawn.clone()], ..SimulationConfig::default() };
                config.trajectories.truncate(1);
                config.trajectories[0].duration_s = 0.5;
                config.log.pause_s = 0.0;
                simulate(&robot, None, &config).unwrap_or_else(|e| panic!("{drawn:?}: {e}"));
            }
        }
    }
}

#[test]
fn effects_that_cannot_be_are_refused_in_words() {
    let cases = [
        (TrueEffect::new("gravity_leak", &[], &[]), "gravity_leak"),
        (TrueEffect::new("stribeck", &["q4"], &[("f_sc", 1.0), ("v_s", 0.1)]), "q4"),
        (TrueEffect::new("stribeck", &["q1"], &[("f_sc", 1.0)]), "v_s"),
        (TrueEffect::new("stribeck", &["q1"], &[("f_sc", -1.0), ("v_s", 0.1)]), "f_sc"),
        (TrueEffect::new("stribeck", &["q1"], &[("f_sc", f64::NAN), ("v_s", 0.1)]), "f_sc"),
        (TrueEffect::new("stribeck", &["q1"], &[("f_sc", 1.0), ("v_s", 0.1), ("v", 1.0)]), "\"v\""),
        (TrueEffect::new("base_tilt", &["q1"], &[("tilt_1", 0.1)]), "whole robot"),
        (TrueEffect::new("cross_ripple", &["q1"], &[("amplitude", 0.1), ("w1", 3.0), ("w2", 3.0)]), "two"),
        (TrueEffect::new("axis_coupling", &["q1", "q2"], &[("J", 0.1)]), "erial"),
        (TrueEffect::new("payload", &[], &[("m", 1.0), ("t_on", 2.0), ("t_off", 1.0)]), "after"),
        (TrueEffect::new("rotor_inertia", &["q1"], &[("J", -1.0)]), "zero or more"),
        (TrueEffect::new("forearm_rod", &[], &[("dm", -5.0)]), "rod"),
        (TrueEffect::new("collision", &[], &[]), "F_x"),
    ];
    for (effect, expect) in cases {
        let e = simulate(&robot(), None, &quiet(&[Kinds::Fourier], vec![effect])).unwrap_err();
        assert!(e.what.contains(expect) && e.what.contains("effect[0]"), "{expect}: {e}");
        assert!(!e.to_string().contains('\n'), "{e}");
    }
}
