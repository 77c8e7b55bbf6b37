//! Effects against physics computed another way: robots that truly are what the effect says, power balances,
//! closed forms.

mod common;
#[path = "common/effects.rs"]
mod support;

use common::{ARM, DELTA, DELTA_TILTED, relative};
use lacuna_interfaces::RobotFile;
use lacuna_physics::delta::Forearm;
use lacuna_physics::effects::{Effect, EffectContext, Regime, find};
use lacuna_physics::{Motion, Vec3, build};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use support::{Robot, Signals, centre, map, regime, rms, shaking, torque_of};

fn effect(id: &str) -> &'static Effect {
    find(id).unwrap()
}

/// Greatest difference over all joints and samples, relative to the greatest of `expected`.
fn differ(found: &[Vec<f64>], expected: &[Vec<f64>]) -> f64 {
    relative(&found.concat(), &expected.concat(), 1e-9)
}

fn minus(a: &[Vec<f64>], b: &[Vec<f64>]) -> Vec<Vec<f64>> {
    a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(x, y)| x - y).collect()).collect()
}

fn tau(id: &str, joints: &[usize], p: &[(&str, f64)], c: &EffectContext<'_>, s: &Signals) -> Vec<Vec<f64>> {
    torque_of(effect(id), joints, &map(p), c, s)
}

/// Torque of another robot along the same motion, with its own nominal parameters.
fn of_robot(file: &RobotFile, urdf: Option<&str>, s: &Signals) -> Vec<Vec<f64>> {
    let body = build(file, urdf).unwrap();
    s.torque(body.as_ref(), &body.nominal())
}

/// Σ τ q̇ at every sample.
fn power(tau: &[Vec<f64>], s: &Signals) -> Vec<f64> {
    (0..s.t.len()).map(|k| (0..tau.len()).map(|j| tau[j][k] * s.qd[j][k]).sum()).collect()
}

#[test]
fn tilt_is_gravity_turned() {
    for text in [DELTA, DELTA_TILTED, ARM] {
        let robot = Robot::new(text);
        let (c, tilt) = (robot.context(), 2e-3);
        let s = regime(&c, Regime::Shaking);
        let g = Vec3::from(robot.body.gravity_m_s2());
        let pair = [("tilt_1", tilt), ("tilt_2", 0.0)];
        let found = [tau("base_tilt", &[], &pair, &c, &s), tau("base_tilt", &[], &[("tilt_2", tilt)], &c, &s)];
        let down = g.normalize();
        // Gravity is along z or nearly so in these robots: the axes across it come from x and y, in this order.
        let first = (Vec3::x() - down * down.x).normalize();
        let second = (Vec3::y() - down * down.y - first * first.y).normalize();
        for (towards, found) in [first, second].iter().zip(&found) {
            let turned = g.norm() * (down * tilt.cos() + towards * tilt.sin());
            let body = robot.body.with_gravity(turned.into());
            let expected = minus(&s.torque(body.as_ref(), &robot.pi), &s.drive);
            let e = differ(found, &expected);
            assert!(e < 3.0 * tilt, "{}: {e:.2e}", robot.file.name);
        }
    }
}

#[test]
fn offset_is_the_torque_in_the_true_pose() {
    for text in [DELTA, ARM] {
        let robot = Robot::new(text);
        let (c, q_0) = (robot.context(), 1e-4);
        let s = regime(&c, Regime::Shaking);
        let mut true_motion = s.clone();
        true_motion.q[1].iter_mut().for_each(|q| *q += q_0);
        let expected = minus(&true_motion.torque(robot.body.as_ref(), &robot.pi), &s.drive);
        let e = differ(&tau("encoder_offset", &[1], &[("q_0", q_0)], &c, &s), &expected);
        assert!(e < 2e-3, "{}: {e:.2e}", robot.file.name);
    }
}

#[test]
fn lengths_are_those_of_a_robot_so_built() {
    let step = 1e-6;
    // A Delta whose three legs are all longer.
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    for (symbol, upper, fore) in [("dl", step, 0.0), ("dl_2", 0.0, step)] {
        let mut file = robot.file.clone();
        let g = file.geometry.as_mut().unwrap();
        (g.l1, g.l2) = (g.l1 + upper, g.l2 + fore);
        let expected = minus(&of_robot(&file, None, &s), &s.drive);
        let e = differ(&tau("link_length", &[0, 1, 2], &[(symbol, step)], &c, &s), &expected);
        assert!(e < 1e-4, "{symbol}: {e:.2e}");
        // One leg at a time adds up to all three.
        let mut sum = vec![vec![0.0; s.t.len()]; 3];
        for j in 0..3 {
            for (sum, part) in sum.iter_mut().zip(tau("link_length", &[j], &[(symbol, step)], &c, &s)) {
                sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
            }
        }
        assert!(differ(&sum, &expected) < 1e-4, "{symbol}: the legs do not add up");
    }
    // A serial arm by DH rows.
    let robot = Robot::new(ARM);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let mut file = robot.file.clone();
    let (a, d) = (file.dh[1].a, file.dh[1].d);
    file.dh[1].a += step * a / a.hypot(d);
    file.dh[1].d += step * d / a.hypot(d);
    let expected = minus(&of_robot(&file, None, &s), &s.drive);
    let e = differ(&tau("link_length", &[1], &[("dl", step)], &c, &s), &expected);
    assert!(e < 1e-4, "dh: {e:.2e}");
}

/// Two links hanging in series, as URDF.
fn urdf(elbow: f64) -> String {
    let link = |name: &str, mass: f64| {
        format!(
            "<link name=\"{name}\"><inertial><origin xyz=\"0.1 0.02 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"0.01\" ixy=\"0\" ixz=\"0\" iyy=\"0.02\" iyz=\"0\" izz=\"0.03\"/></inertial></link>"
        )
    };
    let joint = |name: &str, parent: &str, child: &str, xyz: &str| {
        format!(
            "<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <origin xyz=\"{xyz}\" rpy=\"0.1 0.2 0.3\"/><axis xyz=\"0 1 0\"/></joint>"
        )
    };
    let (ox, oz) = (0.6 * elbow, 0.8 * elbow);
    let origin = format!("{ox:.12} 0 {oz:.12}");
    let parts = [
        "<robot name=\"two\"><link name=\"base\"/>".to_owned(),
        link("upper", 2.0),
        link("lower", 1.0),
        joint("shoulder", "base", "upper", "0 0 0.3"),
        joint("elbow", "upper", "lower", &origin),
        "</robot>".to_owned(),
    ];
    parts.concat()
}

#[test]
fn lengths_in_a_urdf() {
    let (length, step) = (0.4, 1e-6);
    let text = "kind = \"serial\"\nname = \"two\"\njoints = [\"shoulder\", \"elbow\"]\nurdf = \"two.urdf\"\n";
    let file = RobotFile::parse(text).unwrap();
    let xml = urdf(length);
    let body = build(&file, Some(&xml)).unwrap();
    let pi = body.nominal();
    let c = EffectContext { robot: &file, urdf: Some(&xml), body: body.as_ref(), pi: &pi };
    let s = regime(&c, Regime::Shaking);
    let expected = minus(&of_robot(&file, Some(&urdf(length + step)), &s), &s.drive);
    let e = differ(&tau("link_length", &[0], &[("dl", step)], &c, &s), &expected);
    assert!(e < 1e-4, "{e:.2e}");
    let last = effect("link_length").term(&[1], &map(&[("dl", step)]), &c).unwrap_err();
    assert!(last.what.contains("is the last"), "{last}");
}

#[test]
fn forearm_columns_are_the_distributed_forearm() {
    for text in [DELTA, DELTA_TILTED] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let delta = robot.body.as_delta().unwrap();
        let m2 = robot.file.mass.as_ref().unwrap().forearm_point;
        let l2 = delta.l2_m();
        for (xi, turning, dm) in [(0.5, 1.0 / 12.0, 0.0), (0.57, 0.078, 0.0), (0.45, 0.1, 0.0), (0.48, 0.09, 0.3 * m2)]
        {
            let m_f = 2.0 * m2 + dm;
            let rod = Forearm { mass_kg: m_f, com_fraction: xi, inertia_kg_m2: turning * m_f * l2 * l2 };
            let truth = s.torque(delta, &delta.distributed_forearms(&rod));
            let p = [("ds_1", m_f * xi - m2), ("ds_2", m_f * (xi * xi + turning) - m2), ("dm", dm)];
            let e = differ(&tau("forearm_rod", &[], &p, &c, &s), &minus(&truth, &s.drive));
            assert!(e < 1e-9, "ξ = {xi}: {e:.2e}");
        }
    }
}

#[test]
fn payload_is_a_heavier_robot() {
    let kg = 0.7;
    let mut delta = RobotFile::parse(DELTA).unwrap();
    delta.mass.as_mut().unwrap().platform += kg;
    // The tip of a DH chain is its last frame: a mass there adds to the last link's mass and to nothing else.
    let arm = RobotFile::parse(ARM).unwrap();
    for (text, heavier) in [(DELTA, Some(delta)), (ARM, None)] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let truth = match &heavier {
            Some(file) => of_robot(file, None, &s),
            None => {
                let mut pi = robot.pi.clone();
                pi[c.index_of("m", arm.joint_count() - 1).unwrap()] += kg;
                s.torque(robot.body.as_ref(), &pi)
            }
        };
        let e = differ(&tau("payload", &[], &[("m", kg)], &c, &s), &minus(&truth, &s.drive));
        assert!(e < 1e-10, "{}: {e:.2e}", robot.file.name);
        // Carried from 0.1 s to before 0.3 s only.
        let timed = tau("payload", &[], &[("m", kg), ("t_on", 0.1), ("t_off", 0.3)], &c, &s);
        let always = tau("payload", &[], &[("m", kg)], &c, &s);
        for (k, t) in s.t.iter().enumerate() {
            let expected = if (0.1..0.3).contains(t) { always[0][k] } else { 0.0 };
            assert_eq!(timed[0][k], expected, "t = {t}");
        }
    }
}

/// First moments of a payload on a serial arm: mass at +r and −r leaves twice the moment and nothing else.
#[test]
fn eccentric_payload_of_an_arm() {
    let robot = Robot::new(ARM);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let r = 0.05;
    let column = |row: &dyn Fn(&mut RobotFile)| {
        let mut file = robot.file.clone();
        row(&mut file);
        let body = build(&file, None).unwrap();
        let mut out = vec![vec![0.0; s.t.len()]; 6];
        let mut tau = [0.0; 6];
        for k in 0..s.t.len() {
            let [q, qd, qdd] = s.at(k);
            body.payload_column(&Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, &mut tau).unwrap();
            (0..6).for_each(|j| out[j][k] = tau[j]);
        }
        out
    };
    for (symbol, plus, less) in [
        ("m_x", column(&|f| f.dh[5].a += r), column(&|f| f.dh[5].a -= r)),
        ("m_z", column(&|f| f.dh[5].d += r), column(&|f| f.dh[5].d -= r)),
    ] {
        let e = differ(&tau("payload_ecc", &[], &[(symbol, 2.0 * r)], &c, &s), &minus(&plus, &less));
        assert!(e < 1e-10, "{symbol}: {e:.2e}");
    }
}

/// On a Delta the platform holds the mass on its circle: Jᵀ m r̈, r̈ by differences.
#[test]
fn eccentric_payload_of_a_delta() {
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let omega = 12.0;
    let found = tau("payload_ecc", &[], &[("m_x", 0.06), ("m_y", -0.08), ("omega", omega)], &c, &s);
    let place = |t: f64| {
        let phase = omega * t + (-0.08_f64).atan2(0.06);
        Vec3::new(0.1 * phase.cos(), 0.1 * phase.sin(), 0.0)
    };
    let mut expected = vec![vec![0.0; s.t.len()]; 3];
    for (k, t) in s.t.iter().enumerate() {
        let h = 1e-4;
        let force = (place(t + h) - 2.0 * place(*t) + place(t - h)) / (h * h);
        let mut j = [0.0; 9];
        robot.body.jacobian(&s.at(k)[0], &mut j).unwrap();
        (0..3).for_each(|i| expected[i][k] = (0..3).map(|row| j[3 * row + i] * force[row]).sum());
    }
    assert!(differ(&found, &expected) < 1e-5);
}

/// The motors' power is what the air, the ball joints and the surroundings take.
#[test]
fn powers_balance() {
    for text in [DELTA, ARM] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let speed = |k: usize| {
            let [q, qd, qdd] = s.at(k);
            let motion = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
            Vec3::from(robot.body.tip_motion(&motion).unwrap().velocity_m_s)
        };
        let drag = power(&tau("air_drag", &[], &[("c", 0.4)], &c, &s), &s);
        let push = [("F_x", 5.0), ("F_y", -7.0), ("F_z", 11.0), ("t_0", 0.05), ("T", 0.2)];
        let hit = power(&tau("collision", &[], &push, &c, &s), &s);
        for k in 0..s.t.len() {
            let v = speed(k);
            assert!((drag[k] - 0.4 * v.norm().powi(3)).abs() < 1e-9 * (1.0 + drag[k]), "drag, sample {k}");
            let phase = (s.t[k] - 0.05) / 0.2;
            let size = if (0.0..=1.0).contains(&phase) { (TAU / 2.0 * phase).sin() } else { 0.0 };
            let given = -size * Vec3::new(5.0, -7.0, 11.0).dot(&v);
            assert!((hit[k] - given).abs() < 1e-9 * (1.0 + given.abs()), "collision, sample {k}");
        }
    }
}

/// Power of the ball joints = Σ μ |ω|²/√(|ω|² + ω_0²) + b |ω|², ω by differences of the forearms' directions.
#[test]
fn ball_joints_take_what_their_rates_say() {
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let s = Signals::new(&c, 400, 1e-4, shaking);
    let (mu, b, omega_0) = (0.3, 0.05, 0.02);
    let taken = power(&tau("ball_friction", &[], &[("mu", mu), ("b", b), ("omega_0", omega_0)], &c, &s), &s);
    let delta = robot.body.as_delta().unwrap();
    let alpha: [f64; 3] = [0.0, 120f64.to_radians(), 240f64.to_radians()];
    let direction = |k: usize, i: usize| {
        let pose = delta.pose(&[s.q[0][k], s.q[1][k], s.q[2][k]]).unwrap();
        pose.s[i].normalize()
    };
    for k in 1..s.t.len() - 1 {
        let mut expected = 0.0;
        for i in 0..3 {
            let rate = (direction(k + 1, i) - direction(k - 1, i)) / (s.t[k + 1] - s.t[k - 1]);
            let forearm = direction(k, i).cross(&rate);
            // A positive angle lowers the elbow: the arm turns about the tangent of the base circle.
            let arm = s.qd[i][k] * Vec3::new(-alpha[i].sin(), alpha[i].cos(), 0.0);
            for omega in [forearm, forearm - arm] {
                let w = omega.norm();
                expected += mu * w * w / w.hypot(omega_0) + b * w * w;
            }
        }
        assert!((taken[k] - expected).abs() < 2e-4 * (1.0 + expected), "sample {k}: {} {expected}", taken[k]);
    }
}

/// Inertia about a joint's axis added to the robot file is the arm_inertia column; so is a first moment.
#[test]
fn arm_inertia_of_a_serial_link() {
    let robot = Robot::new(ARM);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    for j in 0..6 {
        // The axis in the frame behind the row is Rx(α)ᵀ z.
        let alpha = robot.file.dh[j].alpha;
        let a = Vec3::new(0.0, alpha.sin(), alpha.cos());
        let mut file = robot.file.clone();
        let add = 0.02 * a * a.transpose();
        let i = &mut file.link[j].inertia;
        for (slot, v) in i.iter_mut().zip([add.m11, add.m12, add.m13, add.m22, add.m23, add.m33]) {
            *slot += v;
        }
        let expected = minus(&of_robot(&file, None, &s), &s.drive);
        let e = differ(&tau("arm_inertia", &[j], &[("I", 0.02)], &c, &s), &expected);
        assert!(e < 1e-9, "joint {j}: {e:.2e}");
        // Both first moments are across the axis: with gravity along it they weigh nothing at the joint.
        let still = Signals::new(&c, 2, 1e-3, |j, _| [centre(j), 0.0, 0.0]);
        let pose = common::body(ARM);
        let mut up = [0.0; 6];
        let moments = tau("arm_inertia", &[j], &[("m_1", 1.0), ("m_2", 1.0)], &c, &still);
        pose.payload_column(&Motion { q_rad: &still.at(0)[0], qd_rad_s: &[0.0; 6], qdd_rad_s2: &[0.0; 6] }, &mut up)
            .unwrap();
        if j == 0 {
            assert!(moments[0][0].abs() < 1e-9, "the first axis is along gravity: {}", moments[0][0]);
        } else {
            assert!(moments.iter().any(|m| m[0].abs() > 0.1), "joint {j}: no moment weighs anything");
        }
    }
}

/// Closed forms of the laws of friction.
#[test]
fn friction_by_hand() {
    let robot = Robot::new(ARM);
    let c = robot.context();
    let at = |id: &str, p: &[(&str, f64)], qd: f64, link: f64| -> f64 {
        let mut s = Signals::new(&c, 1, 1e-3, |_, _| [0.2, qd, 0.0]);
        s.link.iter_mut().flatten().for_each(|v| *v = link);
        s.drive.clone_from(&s.link);
        s.temperature.iter_mut().flatten().for_each(|v| *v = 30.0);
        tau(id, &[2], p, &c, &s)[2][0]
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    near(at("stribeck", &[("f_sc", 2.0), ("v_s", 0.1)], -0.1, 0.0), -2.0 * (-1.0_f64).exp());
    near(at("viscous_power", &[("a", 0.5), ("p", 2.0)], -3.0, 0.0), -4.5);
    near(at("load_friction", &[("mu", 0.1), ("mu_v", 0.02)], -2.0, -30.0), -0.1 * 30.0 - 0.02 * 30.0 * 2.0);
    near(at("coulomb_asym", &[("a_c", 0.7)], -2.0, 0.0), 0.7);
    near(at("cable_spring", &[("k_1", 1.0), ("k_3", 2.0), ("q_0", -0.3)], 0.0, 0.0), 0.5 + 2.0 * 0.125);
    near(at("gravity_spring", &[("a_s", 1.0), ("a_c", 2.0)], 0.0, 0.0), 0.2f64.sin() + 2.0 * 0.2f64.cos());
    near(at("torque_saturation", &[("a", 0.2), ("tau_k", 10.0), ("p", 1.0)], 1.0, -15.0), -0.2 * 15.0 * 0.5);
    near(at("torque_saturation", &[("a", 0.2), ("tau_k", 10.0), ("p", 2.0)], 1.0, 9.9), 0.0);
    near(at("kt_scale", &[("g", -0.1)], 1.0, 15.0), -1.5);
    let robot = Robot::new(&support::with_drive(ARM));
    let c = robot.context();
    let mut s = Signals::new(&c, 1, 1e-3, |_, _| [0.2, 2.0, 0.0]);
    s.start = 30.0;
    let p = [("b", 0.5), ("b_T", -0.01), ("tau_w", 60.0), ("T_ref", 20.0)];
    near(tau("thermal_viscous", &[2], &p, &c, &s)[2][0], 0.5 * (-0.5_f64).exp() * 2.0 - 0.01 * 5.0 * 2.0);
    // Dry friction of -0.03 Nm/K, five kelvin warmer, forwards.
    near(tau("thermal_viscous", &[2], &[("c_T", -0.03), ("T_ref", 20.0)], &c, &s)[2][0], -0.03 * 5.0);
}

/// Ripple repeats after one wave, N·h of them in a turn of the joint.
#[test]
fn ripple_counts_per_motor_revolution() {
    let robot = Robot::new(&support::with_drive(ARM));
    let c = robot.context();
    let (gear, order) = (10.0, 3.0);
    let s = Signals::new(&c, 61, 1e-3, |_, t| [0.1 + t * 1e3 * TAU / (gear * order) / 30.0, 1.0, 0.0]);
    let wave = &tau("cogging", &[1], &[("a_s", 0.3), ("a_c", -0.4), ("h", order)], &c, &s)[1];
    for k in 0..30 {
        assert!((wave[k] - wave[k + 30]).abs() < 1e-12 && (wave[k] + wave[k + 15]).abs() < 1e-12, "sample {k}");
    }
    let peak = wave.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    assert!((peak - 0.5).abs() < 0.01, "amplitude √(0.3² + 0.4²): {peak}");
}

/// One-way motion after a reset: f (1 − e^(−x/δ)) − f. A closed loop takes what Dahl's law takes:
/// between z = ±z_m over a half width x, δ ln-free closed form of ∮ f z dx.
#[test]
fn dahl_hysteresis_loop() {
    let robot = Robot::new(ARM);
    let c = robot.context();
    let (f, delta, half) = (2.0, 0.01, 0.02);
    let path = |t: f64| half * (TAU * t).sin();
    let s = Signals::new(&c, 6001, 5e-4, |_, t| {
        [path(t), half * TAU * (TAU * t).cos(), -half * TAU * TAU * (TAU * t).sin()]
    });
    let found = &tau("presliding", &[1], &[("f", f), ("delta", delta)], &c, &s)[1];
    // f z = term + f s.
    let bend: Vec<f64> = (0..s.t.len()).map(|k| found[k] / f + s.direction[1][k]).collect();
    let quarter = 500;
    for k in 1..quarter {
        assert!((bend[k] - (1.0 - (-path(s.t[k]) / delta).exp())).abs() < 1e-9, "sample {k}");
    }
    // The third loop is steady: with z_m = tanh(half/δ), its area is 2 f (2 half − 2 δ z_m).
    let loop_range = 4000..6000;
    let area: f64 = loop_range.map(|k| f * 0.5 * (bend[k] + bend[k + 1]) * (s.q[1][k + 1] - s.q[1][k])).sum();
    let closed = 4.0 * f * (half - delta * (half / delta).tanh());
    assert!((area - closed).abs() < 1e-4 * closed, "{area} {closed}");
}

/// k → ∞ is the rigid robot, and the spring carries what the motors' torque says: e = (τ_link + Δτ)/k.
#[test]
fn stiff_joints_are_rigid() {
    for text in [DELTA, ARM] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let size = |k: f64| rms(&tau("elasticity", &[1], &[("k", k), ("zeta", 0.1)], &c, &s));
        let (soft, stiff, stiffer) = (size(1e4), size(1e6), size(1e8));
        assert!(soft > 10.0 * stiff && stiff > 10.0 * stiffer, "{soft:.2e} {stiff:.2e} {stiffer:.2e}");
        assert!(stiffer < 1e-3 * rms(&s.drive));
        // A gap of nothing is a spring.
        let p: BTreeMap<&str, f64> = [("k", 1e4), ("zeta", 0.1)].into();
        let list: Vec<(&str, f64)> = p.into_iter().collect();
        let gap: Vec<(&str, f64)> = list.iter().copied().chain([("b", 0.0)]).collect();
        assert_eq!(tau("elasticity", &[1], &list, &c, &s), tau("backlash", &[1], &gap, &c, &s));
    }
}
