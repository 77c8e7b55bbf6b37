//! What is special to the Delta: closed-form kinematics, its energy, the grey box and the forearm's parameters.

mod common;

use common::{DELTA, DELTA_TILTED, along, body, relative, torque};
use lacuna_interfaces::RobotFile;
use lacuna_interfaces::model::RigidBodyModel;
use lacuna_physics::delta::{Forearm, LegAngles, PARAMETERS, grey_box};
use lacuna_physics::{Delta, Motion, RigidBody, Unreachable, Vec3, parameters_of};
use proptest::prelude::*;

/// A Delta of any sensible proportions.
fn geometries() -> impl Strategy<Value = Delta> {
    (0.1..0.6_f64, 1.6..3.5_f64, 0.02..0.3_f64, 0.01..0.1_f64, -20.0..20.0_f64, any::<bool>()).prop_map(
        |(l1, ratio, ra, rb, turn, clockwise)| {
            let step = if clockwise { -120.0 } else { 120.0 };
            let robot = format!(
                "kind = \"delta\"\nname = \"any\"\n[geometry]\nl1 = {l1:?}\nl2 = {:?}\nra = {:?}\nrb = {rb:?}\n\
                 alpha_deg = [{turn:?}, {:?}, {:?}]\n[mass]\nplatform = 1.0\nupper_arm = 1.0\nforearm_point = 0.1\n",
                l1 * ratio,
                ra + rb,
                turn + step + 3.0,
                turn + 2.0 * step
            );
            Delta::new(&RobotFile::parse(&robot).unwrap()).unwrap()
        },
    )
}

/// Angle differences across the ±π seam.
fn apart(a: f64, b: f64) -> f64 {
    (a - b).sin().hypot(1.0 - (a - b).cos())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// θ → x → θ. Which solution of a leg comes back follows from the sign of k: a knee points outward where
    /// lowering it lowers the platform.
    #[test]
    fn forward_then_inverse(delta in geometries(), q in prop::array::uniform3(-0.9..1.4_f64)) {
        let Ok(pose) = delta.pose(&q) else { return Ok(()) };
        let legs = delta.inverse(pose.x.into()).unwrap();
        for i in 0..3 {
            prop_assert!((pose.s[i].norm() - delta.l2_m()).abs() < 1e-12);
            let found = if pose.k[i] < 0.0 { legs[i].knee_out } else { legs[i].knee_in };
            // Where both solutions meet (k = 0) the angle has only half the digits.
            let conditioning = delta.l1_m() * delta.l2_m() / pose.k[i].abs();
            prop_assert!(apart(found, q[i]) < 1e-14 * (1.0 + conditioning * conditioning) + 1e-12, "{found} {}", q[i]);
        }
    }

    /// x → θ → x with the knees out, and both solutions close every leg.
    #[test]
    fn inverse_then_forward(delta in geometries(), at in prop::array::uniform3(-1.0..1.0_f64)) {
        let (l1, l2) = (delta.l1_m(), delta.l2_m());
        let x = [0.3 * l2 * at[0], 0.3 * l2 * at[1], -l2 + 0.3 * l1 * at[2]];
        let Ok(legs) = delta.inverse(x) else { return Ok(()) };
        for (i, leg) in legs.iter().enumerate() {
            for angle in [leg.knee_out, leg.knee_in] {
                prop_assert!(angle > -std::f64::consts::PI && angle <= std::f64::consts::PI);
                let mut q = legs.map(|l: LegAngles| l.knee_out);
                q[i] = angle;
                if let Ok(pose) = delta.pose(&q) {
                    // The elbow, from the definition of u: J' = (r cos α, r sin α, 0) − w.
                    let elbow = pose.x - pose.s[i];
                    prop_assert!(((Vec3::from(x) - elbow).norm() - l2).abs() < 1e-11);
                }
            }
        }
        let q = legs.map(|l| l.knee_out);
        let pose = delta.pose(&q).unwrap();
        // Below the elbow plane the answer is the point asked for; above it, its mirror image would come back.
        let normal = (pose.s[0] - pose.s[1]).cross(&(pose.s[0] - pose.s[2]));
        let height = normal.dot(&pose.s[0]) * normal.z.signum();
        prop_assert!(height <= 0.0);
        if (Vec3::from(x) - pose.x).norm() > 1e-9 {
            let elbow = pose.x - pose.s[0];
            prop_assert!(normal.dot(&(Vec3::from(x) - elbow)) * normal.z.signum() >= 0.0, "{:?} {x:?}", pose.x);
        }
    }

    /// |τ·θ̇ − dE/dt| with the energy written down from positions and velocities of the masses.
    #[test]
    fn energy_balance(
        q in prop::array::uniform3(-0.5..1.0_f64),
        qd in prop::array::uniform3(-9.0..9.0_f64),
        qdd in prop::array::uniform3(-90.0..90.0_f64),
        pi in prop::array::uniform12(0.05..2.0_f64),
        tilted in any::<bool>(),
    ) {
        let text = if tilted { DELTA_TILTED } else { DELTA };
        let robot = RobotFile::parse(text).unwrap();
        let delta = Delta::new(&robot).unwrap();
        let alpha = robot.geometry.unwrap().alpha_deg.map(f64::to_radians);
        let gravity = Vec3::from(delta.gravity_m_s2());
        let m = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
        let energy = |q: &[f64], qd: &[f64]| {
            let tip = delta.tip_motion(&Motion { q_rad: q, qd_rad_s: qd, qdd_rad_s2: qd }).unwrap();
            let (x, xd) = (Vec3::from(tip.position_m), Vec3::from(tip.velocity_m_s));
            let mut e = 0.5 * pi[9] * xd.norm_squared() - pi[10] * gravity.dot(&x);
            for i in 0..3 {
                let (s, c) = q[i].sin_cos();
                let along_arm = Vec3::new(c * alpha[i].cos(), c * alpha[i].sin(), -s);
                let across_arm = Vec3::new(-s * alpha[i].cos(), -s * alpha[i].sin(), -c);
                let elbow_rate = delta.l1_m() * qd[i] * across_arm;
                e += 0.5 * pi[i] * qd[i] * qd[i] - gravity.dot(&(pi[3 + i] * along_arm + pi[6 + i] * across_arm));
                e += pi[11] * elbow_rate.dot(&xd);
            }
            vec![e]
        };
        let power: Vec<f64> = torque(&delta, &m, &pi).iter().zip(&qd).map(|(t, v)| t * v).collect();
        let scale: f64 = power.iter().map(|p| p.abs()).sum();
        let error = (power.iter().sum::<f64>() - along(&m, energy)[0]).abs();
        prop_assert!(error < 1e-8 * (1.0 + scale), "{error:e} of {scale}");
    }
}

#[test]
fn knees_out_in_a_middle_pose() {
    let delta = Delta::new(&RobotFile::parse(DELTA).unwrap()).unwrap();
    let legs = delta.inverse([0.0, 0.0, -0.85]).unwrap();
    for leg in legs {
        // Elbow radius r + l1 cos θ: outside for one solution, inside for the other.
        assert!(leg.knee_out.cos() > leg.knee_in.cos(), "{leg:?}");
    }
    let pose = delta.pose(&legs.map(|l| l.knee_out)).unwrap();
    assert!((pose.x - Vec3::new(0.0, 0.0, -0.85)).norm() < 1e-14);
    // Lowering all elbows lowers the platform: the sign convention, seen from outside.
    let lower = delta.pose(&legs.map(|l| l.knee_out + 0.1)).unwrap();
    assert!(lower.x.z < pose.x.z);
}

#[test]
fn unreachable_poses_say_why() {
    // Forearms hardly longer than the upper arms: raised elbows spread wider than they reach.
    let short = DELTA.replace("l2 = 0.88", "l2 = 0.4").replace("ra = 0.2", "ra = 0.4");
    let delta = Delta::new(&RobotFile::parse(&short).unwrap()).unwrap();
    let error = delta.pose(&[0.0; 3]).unwrap_err();
    let Unreachable::ForearmsTooShort { circumradius_m, l2_m } = error else { panic!("{error:?}") };
    assert!((circumradius_m - 0.7).abs() < 1e-12 && l2_m == 0.4);
    assert!(error.to_string().contains("0.700000 m") && error.to_string().contains("0.400000 m"), "{error}");

    let error = delta.inverse([0.0, 0.0, -3.0]).unwrap_err();
    assert!(matches!(error, Unreachable::Leg { leg: 0, .. }), "{error:?}");
    assert!(matches!(delta.inverse([f64::NAN, 0.0, -0.3]), Err(Unreachable::Leg { .. })));

    // Elbows on a circle of exactly the forearms' length: all forearms in one plane.
    let flat = DELTA.replace("l2 = 0.88", "l2 = 0.5");
    let delta = Delta::new(&RobotFile::parse(&flat).unwrap()).unwrap();
    assert!(delta.pose(&[0.0; 3]).is_err());
    assert!(matches!(
        delta.pose(&[1e-15; 3]),
        Err(Unreachable::Singular { .. } | Unreachable::ForearmsTooShort { .. })
    ));
    assert!(delta.pose(&[0.3; 3]).is_ok());
}

#[test]
fn grey_box_is_the_papers_equation_six() {
    let delta = body(DELTA);
    let pi: [f64; PARAMETERS] = delta.nominal().try_into().unwrap();
    let (rho1, rho2) = (1.17, 0.83);
    let (q, qd, qdd) = ([0.3, 0.1, 0.5], [1.0, -2.0, 3.0], [20.0, 30.0, -10.0]);
    let m = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
    let found = torque(delta.as_ref(), &m, &grey_box(&pi, rho1, rho2));
    // ρ1 I θ̈ + ρ2 G + Jᵀ M γ, with Jᵀγ from the payload column.
    let mut column = [0.0; 3];
    delta.payload_column(&m, &mut column).unwrap();
    let expected: Vec<f64> = (0..3)
        .map(|i| {
            let inertia = (1.8 / 3.0 + 0.22) * 0.35 * 0.35 + 0.06;
            let gravity = -(1.8 / 2.0 + 0.22) * 9.81 * 0.35 * q[i].cos();
            rho1 * inertia * qdd[i] + rho2 * gravity + (1.1 + 3.0 * 0.22) * column[i]
        })
        .collect();
    assert!(relative(&found, &expected, 1.0) < 1e-13, "{found:?} {expected:?}");
}

/// Uniform rods: m_JJ, m_JE, m_EE are 1/3, 1/6, 1/3 of the forearm's mass, m_J and m_E one half.
#[test]
fn uniform_forearm_shares() {
    let delta = Delta::new(&RobotFile::parse(DELTA).unwrap()).unwrap();
    let pi = delta.distributed_forearms(&Forearm::uniform(0.6, delta.l2_m()));
    let value = |symbol: &str| pi[delta.parameters().iter().position(|p| p.symbol == symbol).unwrap()];
    for (symbol, expected) in [
        ("I2", (0.6 + 0.2) * 0.35 * 0.35 + 0.06),
        ("gc3", (0.9 + 0.3) * 0.35),
        ("gs1", 0.0),
        ("m_in", 1.1 + 3.0 * 0.2),
        ("m_gr", 1.1 + 3.0 * 0.3),
        ("m_JE", 0.1),
    ] {
        assert!((value(symbol) - expected).abs() < 1e-15, "{symbol}: {}", value(symbol));
    }
}

#[test]
fn model_file_parameters() {
    let (delta, arm) = (body(DELTA), body(common::ARM));
    let rho = RigidBodyModel { rho1: Some(1.1), rho2: None, ..RigidBodyModel::default() };
    let pi = parameters_of(delta.as_ref(), &rho).unwrap();
    assert_eq!((pi[0], pi[3]), (1.1 * delta.nominal()[0], delta.nominal()[3]));
    let by = |symbol: &str, value: f64| RigidBodyModel {
        parameters: [(symbol.to_owned(), value)].into(),
        ..RigidBodyModel::default()
    };
    let pi = parameters_of(arm.as_ref(), &by("Ixx2", 7.0)).unwrap();
    let changed: Vec<usize> = (0..pi.len()).filter(|&i| pi[i] != arm.nominal()[i]).collect();
    assert_eq!(changed, [15]);
    assert_eq!(arm.parameters()[15].symbol, "Ixx2");
    let error = parameters_of(delta.as_ref(), &by("Ixx2", 7.0)).unwrap_err().to_string();
    for word in ["Ixx2", "gc1", "m_JE"] {
        assert!(error.contains(word), "{error}");
    }
    assert!(parameters_of(arm.as_ref(), &rho).unwrap_err().what.contains("Delta"));
    assert!(parameters_of(delta.as_ref(), &by("I1", f64::NAN)).is_err());
    let both = RigidBodyModel { rho1: Some(1.0), ..by("I1", 1.0) };
    assert!(parameters_of(delta.as_ref(), &both).is_err());
}
