//! Every effect that plant and estimator both know: simulated here as a contact, spring, body or sensor, and
//! computed there as a torque along the motion. Ids, symbols and sizes must agree.

use lacuna_interfaces::model::Term;
use lacuna_interfaces::{Joints, RobotFile};
use lacuna_physics::Motion;
use lacuna_physics::effects::{EffectContext, TermInput, Terms};
use lacuna_simulate::config::{FrictionConfig, NoiseConfig, TrajectoryGroup};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::log::Logged;
use lacuna_simulate::random::Random;
use lacuna_simulate::reference::Kinds;
use lacuna_simulate::{Simulation, SimulationConfig, TrueEffect, simulate};

fn quiet(robot: &RobotFile, effect: &TrueEffect, fc: &[f64], fv: &[f64]) -> Simulation {
    let n = robot.joint_count();
    let group = |kind| TrajectoryGroup { kind, duration_s: 4.0, count: 1, intensity: 0.9 };
    let config = SimulationConfig {
        seed: 5,
        trajectories: vec![group(Kinds::Fourier), group(Kinds::PointToPoint)],
        friction: FrictionConfig { none: false, f_c: fc.to_vec(), f_v: fv.to_vec() },
        noise: NoiseConfig {
            torque_nm: vec![0.0; n],
            encoder_steps: 0.0,
            process_share: 0.0,
            spikes_per_s: 0.0,
            encoder_step_rad: Some(0.0),
        },
        // One start time for all, so that "since switch-on" and the recording's clock are the same.
        log: lacuna_simulate::config::LogConfig { pause_s: 0.0, ..Default::default() },
        effects: vec![effect.clone()],
        ..SimulationConfig::default()
    };
    simulate(robot, None, &config).unwrap()
}

/// Torque of the estimator's term along a noise-free motion, per joint.
fn term_torque(
    robot: &RobotFile,
    effect: &TrueEffect,
    fc: &[f64],
    fv: &[f64],
    l: &Logged,
    start_s: f64,
) -> Vec<Joints> {
    let body = lacuna_physics::build(robot, None).unwrap();
    let pi: Vec<f64> = body.parameters().iter().map(|p| p.nominal).collect();
    let context = EffectContext { robot, urdf: None, body: body.as_ref(), pi: &pi };
    let mut parameters = effect.params.clone();
    if effect.id == "presliding" {
        // There the level that bends is a parameter, here it is the joint's own.
        parameters.insert("f".to_owned(), fc[robot.joints.iter().position(|j| *j == effect.joints[0]).unwrap()]);
    }
    let term = Term { effect: effect.id.clone(), joints: effect.joints.clone(), parameters };
    let mut terms = Terms::new(&[term], &context).unwrap();
    let n = robot.joint_count();
    let mut out = Vec::new();
    for k in 0..l.t_s.len() {
        let at = |c: &Vec<Vec<f64>>| {
            let mut j = Joints::default();
            (0..n).for_each(|i| j[i] = c[i][k]);
            j
        };
        let (q, qd, qdd) = (at(&l.q_rad), at(&l.qd_rad_s), at(&l.qdd_rad_s2));
        let direction = qd.map(|v| if v == 0.0 { 0.0 } else { v.signum() });
        let mut rigid = Joints::default();
        let motion = Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] };
        body.torque(&motion, &pi, &mut rigid[..n]).unwrap();
        let mut tau = Joints::default();
        (0..n).for_each(|i| tau[i] = fc[i] * direction[i] + fv[i] * qd[i]);
        let before = tau;
        terms.add_torque(
            &TermInput {
                stamp_ns: ((start_s + l.t_s[k]) * 1e9).round() as i64,
                q_rad: &q,
                qd_rad_s: &qd,
                qdd_rad_s2: &qdd,
                direction: &direction,
                ramp_rad_s: 0.0,
                tau_rigid_nm: &rigid,
                temperature_degc: &[f64::NAN; 8],
            },
            &mut tau,
        );
        (0..n).for_each(|i| tau[i] -= before[i]);
        out.push(tau);
    }
    out
}

/// Compares on samples at which every joint slides; returns (error, size) in Nm RMS over all joints.
fn compare(robot: &RobotFile, effect: &TrueEffect, fc: &[f64], fv: &[f64]) -> (f64, f64) {
    let s = quiet(robot, effect, fc, fv);
    let n = robot.joint_count();
    let (mut error, mut size, mut count) = (0.0, 0.0, 0.0);
    for (l, file) in s.behind.iter().zip(&s.manifest.files) {
        // Event times are each recording's own; slow memories count from the cold start.
        let start = if effect.id == "thermal_viscous" { file.start_time_s } else { 0.0 };
        let law = term_torque(robot, effect, fc, fv, l, start);
        // Springs and bristles begin at rest there, with their load here.
        for k in 400..l.t_s.len() - 5 {
            let slides = |i: usize| {
                let v = &l.qd_rad_s[i];
                v[k].abs() > 0.05 && (k - 4..=k + 4).all(|j| v[j] * v[k] > 0.0)
            };
            let edge = s
                .truth
                .events
                .values()
                .flatten()
                .any(|e| (l.t_s[k] - e.t_on).abs() < 3e-3 || (l.t_s[k] - e.t_off).abs() < 3e-3);
            if edge || !(0..n).all(slides) {
                continue;
            }
            for i in 0..n {
                let v = l.qd_rad_s[i][k];
                let found = l.hidden_nm[i][k] - fc[i] * v.signum() - fv[i] * v;
                error += (found - law[k][i]).powi(2);
                size += law[k][i].powi(2);
                count += 1.0;
            }
        }
    }
    assert!(count > 500.0, "{}: only {count} values", effect.id);
    (f64::sqrt(error / count), f64::sqrt(size / count))
}

#[test]
fn the_estimators_terms_say_the_torque_that_the_plant_needs() {
    let robot = RobotFile::parse(DEMO_ROBOT).unwrap();
    let (fc, fv) = ([2.0, 2.2, 1.8], [0.5, 0.6, 0.4]);
    // (effect, relative error allowed). First-order columns and springs are allowed more.
    let cases = [
        (TrueEffect::new("coulomb", &["q2"], &[("f_c", 0.7)]), 0.01),
        (TrueEffect::new("viscous", &["q2"], &[("f_v", 0.3)]), 0.01),
        (TrueEffect::new("coulomb_asym", &["q1"], &[("a_c", 0.7)]), 0.01),
        (TrueEffect::new("torque_offset", &["q1"], &[("tau_0", -0.7)]), 0.01),
        (TrueEffect::new("stribeck", &["q3"], &[("f_sc", 1.5), ("v_s", 0.4)]), 0.01),
        (TrueEffect::new("viscous_power", &["q3"], &[("a", 0.1), ("p", 1.8)]), 0.01),
        (TrueEffect::new("load_friction", &["q1"], &[("mu", 0.08), ("mu_v", 0.02)]), 0.03),
        (TrueEffect::new("thermal_viscous", &["q2"], &[("b", 0.5), ("tau_w", 6.0)]), 0.01),
        (TrueEffect::new("presliding", &["q2"], &[("delta", 0.03)]), 0.03),
        (TrueEffect::new("cogging", &["q3"], &[("a_s", 0.3), ("a_c", -0.4), ("h", 1.0)]), 0.02),
        (TrueEffect::new("rotor_inertia", &["q1"], &[("J", 0.05)]), 0.01),
        (TrueEffect::new("arm_inertia", &["q1"], &[("I", 0.05), ("m_1", 0.1), ("m_2", -0.06)]), 0.01),
        (TrueEffect::new("forearm_rod", &[], &[("ds_1", 0.02), ("ds_2", -0.06)]), 0.01),
        (TrueEffect::new("kt_scale", &["q2"], &[("g", 0.1)]), 0.02),
        (TrueEffect::new("torque_saturation", &["q2"], &[("a", 0.3), ("tau_k", 6.0)]), 0.02),
        (TrueEffect::new("torque_saturation", &["q2"], &[("a", 0.3), ("tau_k", 6.0), ("p", 2.0)]), 0.02),
        (TrueEffect::new("torque_delay", &[], &[("D", 1e-3)]), 0.1),
        (TrueEffect::new("base_tilt", &[], &[("tilt_1", 0.02), ("tilt_2", -0.03)]), 0.03),
        (TrueEffect::new("encoder_offset", &["q2"], &[("q_0", 0.005)]), 0.05),
        (TrueEffect::new("link_length", &["q1"], &[("dl", 0.002)]), 0.05),
        (TrueEffect::new("link_length", &["q1"], &[("dl_2", 0.004)]), 0.05),
        (TrueEffect::new("gravity_spring", &["q3"], &[("a_s", 1.5), ("a_c", 0.8)]), 0.01),
        (TrueEffect::new("cable_spring", &["q3"], &[("k_1", 1.0), ("k_3", 2.0), ("q_0", 0.3)]), 0.01),
        (TrueEffect::new("air_drag", &[], &[("c", 1.0)]), 0.01),
        (TrueEffect::new("ball_friction", &[], &[("mu", 0.3), ("b", 0.05)]), 0.03),
        (TrueEffect::new("payload", &[], &[("m", 1.5), ("t_on", 1.0), ("t_off", 3.0)]), 0.01),
        (
            TrueEffect::new(
                "payload_ecc",
                &[],
                &[("m_x", 0.05), ("m_y", 0.03), ("omega", 15.0), ("t_on", 1.0), ("t_off", 3.0)],
            ),
            0.01,
        ),
        (TrueEffect::new("collision", &[], &[("F_x", 60.0), ("F_z", -40.0), ("t_0", 1.5), ("T", 0.2)]), 0.02),
        (TrueEffect::new("elasticity", &["q1"], &[("k", 4000.0), ("zeta", 0.05)]), 0.1),
        (TrueEffect::new("backlash", &["q1"], &[("b", 2e-3), ("k", 20_000.0), ("zeta", 0.1)]), 0.3),
    ];
    let mut failed = Vec::new();
    for (effect, allowed) in cases {
        let (error, size) = compare(&robot, &effect, &fc, &fv);
        println!("{:18} {size:.3} Nm, off by {error:.4} Nm ({:.1} %)", effect.id, 100.0 * error / size);
        if !(size > 0.01 && error < allowed * size + 0.004) {
            failed.push(effect.id.clone());
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn coupled_axes_agree_on_a_chain() {
    let mut robot =
        lacuna_simulate::case::draw_robot(lacuna_interfaces::robot::Kind::Serial, &mut Random::new(1, 0)).unwrap();
    for seed in 2..40 {
        if robot.joint_count() == 3 {
            break;
        }
        robot = lacuna_simulate::case::draw_robot(lacuna_interfaces::robot::Kind::Serial, &mut Random::new(seed, 0))
            .unwrap();
    }
    assert_eq!(robot.joint_count(), 3);
    // The motor's own inertia is already the joint's rotor: the coupling moves it, so take it from there.
    let inertia = 0.5 * robot.link[2].rotor_inertia;
    let effect = TrueEffect::new(
        "axis_coupling",
        &["joint_2", "joint_3"],
        &[("J", inertia), ("rho", 1.0), ("f_v", 0.4), ("f_c", 0.6)],
    );
    let (fc, fv) = ([1.0, 1.0, 0.5], [0.3, 0.4, 0.2]);
    let s = quiet(&robot, &effect, &fc, &fv);
    let (mut error, mut size, mut count) = (0.0, 0.0, 0.0);
    for l in &s.behind {
        let law = term_torque(&robot, &effect, &fc, &fv, l, 0.0);
        for k in 10..l.t_s.len() - 10 {
            let w = |j: usize| l.qd_rad_s[1][j] + l.qd_rad_s[2][j];
            let steady = |v: &dyn Fn(usize) -> f64| v(k).abs() > 0.05 && (k - 4..=k + 4).all(|j| v(j) * v(k) > 0.0);
            let of = |i: usize| move |j: usize| l.qd_rad_s[i][j];
            if !steady(&w) || !(0..3).all(|i| steady(&of(i))) {
                continue;
            }
            let (v2, v3) = (l.qd_rad_s[1][k], l.qd_rad_s[2][k]);
            // What the catalogue leaves to each joint's own terms: the motor's inertia on the felt joint, its
            // viscous friction on both.
            let own = [0.0, inertia * l.qdd_rad_s2[1][k] + 0.4 * v2, 0.4 * v3];
            for i in 1..3 {
                let v = l.qd_rad_s[i][k];
                let found = l.hidden_nm[i][k] - fc[i] * v.signum() - fv[i] * v - own[i];
                error += (found - law[k][i]).powi(2);
                size += law[k][i].powi(2);
                count += 1.0;
            }
        }
    }
    let (error, size) = (f64::sqrt(error / count), f64::sqrt(size / count));
    assert!(count > 300.0 && error < 0.02 * size + 0.003, "off by {error} of {size} Nm");
}
