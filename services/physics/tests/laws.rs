//! Laws that hold for every robot: each test runs over Deltas and serial chains alike.

mod common;

use common::{ROBOTS, State, along, body, motion, relative, torque};
use lacuna_physics::{Motion, RigidBody, Unreachable};
use nalgebra::DMatrix;
use proptest::prelude::*;

fn states() -> impl Strategy<Value = State> {
    let joints = |span: f64| prop::array::uniform8(-span..span);
    (joints(2.0), joints(6.0), joints(60.0)).prop_map(|(q, qd, qdd)| [q, qd, qdd])
}

/// Mass matrix M(q), column by column: torque of a unit acceleration without gravity.
fn mass_matrix(body: &dyn RigidBody, q: &[f64], pi: &[f64]) -> DMatrix<f64> {
    let weightless = body.with_gravity([0.0; 3]);
    let n = body.joint_count();
    let zero = vec![0.0; n];
    let mut m = DMatrix::zeros(n, n);
    for j in 0..n {
        let mut unit = zero.clone();
        unit[j] = 1.0;
        let column = torque(weightless.as_ref(), &Motion { q_rad: q, qd_rad_s: &zero, qdd_rad_s2: &unit }, pi);
        m.column_mut(j).copy_from_slice(&column);
    }
    m
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// τ = Y π for any π, by two separate paths.
    #[test]
    fn regressor_times_parameters_is_torque(
        mut s in states(), pi in prop::collection::vec(-3.0..3.0_f64, 66), robot in 0..ROBOTS.len()
    ) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let (n, p) = (body.joint_count(), body.parameters().len());
        let pi = &pi[..p];
        let mut y = vec![0.0; n * p];
        body.regressor(&m, &mut y).unwrap();
        let product: Vec<f64> = y.chunks(p).map(|row| row.iter().zip(pi).map(|(a, b)| a * b).sum()).collect();
        // Terms of both signs cancel in a sum, so the rounding is held against their magnitudes.
        let scale = y.chunks(p).map(|row| row.iter().zip(pi).map(|(a, b)| (a * b).abs()).sum()).fold(0.0, f64::max);
        prop_assert!(relative(&torque(body.as_ref(), &m, pi), &product, scale) < 1e-12);
    }

    /// Power balance: τ·q̇ = d/dt (½ q̇ᵀ M q̇) + G·q̇.
    #[test]
    fn torque_and_inertia_balance_energy(mut s in states(), robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let pi = body.nominal();
        let still = vec![0.0; body.joint_count()];
        let gravity = torque(body.as_ref(), &Motion { q_rad: m.q_rad, qd_rad_s: &still, qdd_rad_s2: &still }, &pi);
        let tau = torque(body.as_ref(), &m, &pi);
        let kinetic_rate = along(&m, |q, qd| {
            let qd = nalgebra::DVector::from_row_slice(qd);
            vec![0.5 * qd.dot(&(mass_matrix(body.as_ref(), q, &pi) * &qd))]
        })[0];
        let power: f64 = (0..tau.len()).map(|i| (tau[i] - gravity[i]) * m.qd_rad_s[i]).sum();
        let scale: f64 = (0..tau.len()).map(|i| (tau[i] * m.qd_rad_s[i]).abs()).sum();
        prop_assert!((power - kinetic_rate).abs() < 1e-8 * (1.0 + scale), "{power} {kinetic_rate}");
    }

    #[test]
    fn mass_matrix_is_symmetric_positive_definite(mut s in states(), robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let q = motion(body.as_ref(), &mut s).q_rad;
        let m = mass_matrix(body.as_ref(), q, &body.nominal());
        prop_assert!((&m - m.transpose()).norm() < 1e-12 * m.norm());
        prop_assert!(m.cholesky().is_some());
    }

    /// J q̇, J̇ and ẍ against differences of position, J and velocity along the path.
    #[test]
    fn jacobian_and_its_rate_by_differences(mut s in states(), robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let n = body.joint_count();
        let tip = body.tip_motion(&m).unwrap();
        let jacobian = |q: &[f64]| {
            let mut j = vec![0.0; 3 * n];
            body.jacobian(q, &mut j).unwrap();
            j
        };
        prop_assert!(relative(&tip.position_m, &body.tip(m.q_rad).unwrap().position_m, 0.1) < 1e-13);
        let velocity = along(&m, |q, _| body.tip(q).unwrap().position_m.to_vec());
        prop_assert!(relative(&tip.velocity_m_s, &velocity, 1.0) < 1e-8);
        let j = jacobian(m.q_rad);
        let product: Vec<f64> = j.chunks(n).map(|r| r.iter().zip(m.qd_rad_s).map(|(a, b)| a * b).sum()).collect();
        prop_assert!(relative(&tip.velocity_m_s, &product, 1.0) < 1e-12);
        let acceleration = along(&m, |q, qd| {
            let m = Motion { q_rad: q, qd_rad_s: qd, qdd_rad_s2: qd };
            body.tip_motion(&m).unwrap().velocity_m_s.to_vec()
        });
        prop_assert!(relative(&tip.acceleration_m_s2, &acceleration, 1.0) < 1e-7);
        let mut rate = vec![0.0; 3 * n];
        body.jacobian_rate(m.q_rad, m.qd_rad_s, &mut rate).unwrap();
        prop_assert!(relative(&rate, &along(&m, |q, _| jacobian(q)), 1.0) < 1e-7);
    }

    /// Columns of J one joint at a time: no velocity can hide a wrong column.
    #[test]
    fn jacobian_columns_by_differences(mut s in states(), robot in 0..ROBOTS.len(), joint in 0..8_usize) {
        let body = body(ROBOTS[robot]);
        let q = motion(body.as_ref(), &mut s).q_rad;
        let n = body.joint_count();
        let joint = joint % n;
        let zero = vec![0.0; n];
        let mut unit = zero.clone();
        unit[joint] = 1.0;
        let moved = along(&Motion { q_rad: q, qd_rad_s: &unit, qdd_rad_s2: &zero }, |q, _| {
            body.tip(q).unwrap().position_m.to_vec()
        });
        let mut j = vec![0.0; 3 * n];
        body.jacobian(q, &mut j).unwrap();
        let column: Vec<f64> = (0..3).map(|r| j[r * n + joint]).collect();
        prop_assert!(relative(&column, &moved, 1.0) < 1e-9);
    }

    /// A force's torque does the force's work, with the opposite sign; a weight at rest is the payload column.
    #[test]
    fn external_force_does_its_work(mut s in states(), f in prop::array::uniform3(-40.0..40.0_f64), robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let n = body.joint_count();
        let mut tau = vec![0.0; n];
        body.external_force(m.q_rad, f, &mut tau).unwrap();
        let velocity = body.tip_motion(&m).unwrap().velocity_m_s;
        let by_joints: f64 = tau.iter().zip(m.qd_rad_s).map(|(t, v)| t * v).sum();
        let by_force: f64 = f.iter().zip(&velocity).map(|(f, v)| f * v).sum();
        prop_assert!((by_joints + by_force).abs() < 1e-11 * (1.0 + by_force.abs() + by_joints.abs()) * 40.0);

        let zero = vec![0.0; n];
        let mut column = vec![0.0; n];
        body.payload_column(&Motion { q_rad: m.q_rad, qd_rad_s: &zero, qdd_rad_s2: &zero }, &mut column).unwrap();
        body.external_force(m.q_rad, body.gravity_m_s2(), &mut tau).unwrap();
        prop_assert!(relative(&column, &tau, 1.0) < 1e-12);
    }

    /// The payload column is the torque with the mass less the torque without it.
    #[test]
    fn payload_column_is_a_torque_difference(mut s in states(), mass in 0.1..5.0_f64, robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let pi = body.nominal();
        let mut loaded = pi.clone();
        // A DH chain's tip is its last frame's origin: the payload has no moment or inertia there.
        let carriers = if body.as_delta().is_some() { vec!["m_in".to_owned(), "m_gr".to_owned()] } else { vec![format!("m{}", body.joint_count())] };
        for (value, p) in loaded.iter_mut().zip(body.parameters()) {
            if carriers.contains(&p.symbol) {
                *value += mass;
            }
        }
        let (with, without) = (torque(body.as_ref(), &m, &loaded), torque(body.as_ref(), &m, &pi));
        let difference: Vec<f64> = with.iter().zip(&without).map(|(a, b)| (a - b) / mass).collect();
        let mut column = vec![0.0; body.joint_count()];
        body.payload_column(&m, &mut column).unwrap();
        prop_assert!(relative(&column, &difference, with.iter().fold(1.0, |s, v| s.max(v.abs()))) < 1e-12);
    }

    /// One pass gives what the separate calls give, bit by bit.
    #[test]
    fn evaluate_equals_separate_calls(mut s in states(), scale in 0.5..1.5_f64, robot in 0..ROBOTS.len()) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let n = body.joint_count();
        let pi = body.nominal();
        let other: Vec<f64> = pi.iter().map(|v| v * scale + 0.01).collect();
        let all = body.evaluate(&m, &pi, &other).unwrap();
        let mut column = vec![0.0; n];
        body.payload_column(&m, &mut column).unwrap();
        prop_assert_eq!(&all.tau_nominal_nm[..n], torque(body.as_ref(), &m, &pi));
        prop_assert_eq!(&all.tau_rigid_nm[..n], torque(body.as_ref(), &m, &other));
        prop_assert_eq!(&all.payload_column_nm_kg[..n], column);
        prop_assert!(all.tau_rigid_nm[n..].iter().all(|v| *v == 0.0));
    }

    /// τ is affine in gravity.
    #[test]
    fn torque_is_affine_in_gravity(
        mut s in states(), a in prop::array::uniform3(-9.0..9.0_f64), b in prop::array::uniform3(-9.0..9.0_f64), robot in 0..ROBOTS.len()
    ) {
        let body = body(ROBOTS[robot]);
        let m = motion(body.as_ref(), &mut s);
        let pi = body.nominal();
        let under = |g: [f64; 3]| torque(body.with_gravity(g).as_ref(), &m, &pi);
        let both = under([a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
        let (ta, tb, t0) = (under(a), under(b), under([0.0; 3]));
        let sum: Vec<f64> = (0..both.len()).map(|i| ta[i] + tb[i] - t0[i]).collect();
        prop_assert!(relative(&both, &sum, 10.0) < 1e-11);
    }

    /// Whatever the numbers, there is a finite answer or an error, never a panic or a NaN.
    #[test]
    fn any_number_gives_an_answer_or_an_error(
        values in prop::collection::vec(prop::num::f64::ANY, 24),
        which in prop::collection::vec(0..6_u8, 24),
        robot in 0..ROBOTS.len()
    ) {
        let body = body(ROBOTS[robot]);
        let n = body.joint_count();
        // Mostly ordinary numbers, or hardly a sample would pass the first check.
        let values: Vec<f64> = values.iter().zip(&which).map(|(v, w)| if *w == 0 { *v } else { f64::from(*w) * 0.1 }).collect();
        let m = Motion { q_rad: &values[..n], qd_rad_s: &values[n..2 * n], qdd_rad_s2: &values[2 * n..3 * n] };
        let bad = values[..3 * n].iter().any(|v| !v.is_finite());
        let pi = body.nominal();
        let mut y = vec![0.0; n * pi.len()];
        let mut check = |name: &str, call: &mut dyn FnMut(&mut [f64]) -> Option<usize>| {
            if let Some(len) = call(&mut y) {
                assert!(y[..len].iter().all(|v| v.is_finite()), "{name}: {:?}", &y[..len]);
            }
        };
        check("torque", &mut |y| {
            let result = body.torque(&m, &pi, &mut y[..n]);
            assert!(!bad || result.is_err());
            result.ok().map(|()| n)
        });
        check("regressor", &mut |y| body.regressor(&m, y).ok().map(|()| y.len()));
        check("payload", &mut |y| body.payload_column(&m, &mut y[..n]).ok().map(|()| n));
        check("jacobian", &mut |y| body.jacobian(m.q_rad, &mut y[..3 * n]).ok().map(|()| 3 * n));
        check("rate", &mut |y| body.jacobian_rate(m.q_rad, m.qd_rad_s, &mut y[..3 * n]).ok().map(|()| 3 * n));
        check("force", &mut |y| body.external_force(m.q_rad, [values[0], 1.0, values[23]], &mut y[..n]).ok().map(|()| n));
        check("tip", &mut |y| {
            y[..3].copy_from_slice(&body.tip(m.q_rad).ok()?.position_m);
            Some(3)
        });
        check("tip motion", &mut |y| {
            y[..3].copy_from_slice(&body.tip_motion(&m).ok()?.acceleration_m_s2);
            Some(3)
        });
    }
}

#[test]
fn wrong_lengths_are_refused() {
    for robot in ROBOTS {
        let body = body(robot);
        let (n, p) = (body.joint_count(), body.parameters().len());
        let (good, short) = (vec![0.1; n], vec![0.1; n - 1]);
        let m = Motion { q_rad: &good, qd_rad_s: &good, qdd_rad_s2: &good };
        let pi = body.nominal();
        let mut out = vec![0.0; n * p];
        let shape = |r: Result<(), Unreachable>| assert!(matches!(r, Err(Unreachable::Shape { .. })), "{r:?}");
        for bad in [Motion { q_rad: &short, ..m }, Motion { qd_rad_s: &short, ..m }, Motion { qdd_rad_s2: &short, ..m }]
        {
            shape(body.torque(&bad, &pi, &mut out[..n]));
            shape(body.regressor(&bad, &mut out));
            shape(body.payload_column(&bad, &mut out[..n]));
            shape(body.tip_motion(&bad).map(|_| ()));
            shape(body.evaluate(&bad, &pi, &pi).map(|_| ()));
        }
        shape(body.torque(&m, &pi[1..], &mut out[..n]));
        shape(body.torque(&m, &pi, &mut out[..n - 1]));
        shape(body.regressor(&m, &mut out[1..]));
        shape(body.payload_column(&m, &mut out[..n - 1]));
        shape(body.evaluate(&m, &pi[1..], &pi).map(|_| ()));
        shape(body.evaluate(&m, &pi, &pi[1..]).map(|_| ()));
        shape(body.tip(&short).map(|_| ()));
        shape(body.jacobian(&good, &mut out[..n]));
        shape(body.jacobian(&short, &mut out[..3 * n]));
        shape(body.jacobian_rate(&good, &short, &mut out[..3 * n]));
        shape(body.jacobian_rate(&good, &good, &mut out[..n]));
        shape(body.external_force(&good, [0.0; 3], &mut out[..n - 1]));
    }
}

#[test]
fn values_that_are_not_finite_are_refused() {
    for robot in ROBOTS {
        let body = body(robot);
        let n = body.joint_count();
        let good = vec![0.2; n];
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut bad = good.clone();
            bad[n - 1] = value;
            let m = Motion { q_rad: &good, qd_rad_s: &good, qdd_rad_s2: &good };
            for bad in [Motion { q_rad: &bad, ..m }, Motion { qd_rad_s: &bad, ..m }, Motion { qdd_rad_s2: &bad, ..m }] {
                let mut tau = vec![0.0; n];
                let found = body.torque(&bad, &body.nominal(), &mut tau);
                assert_eq!(found, Err(Unreachable::NotFinite { joint: n - 1 }), "{robot}");
            }
        }
    }
}

#[test]
fn symbols_are_unique_and_explained() {
    for robot in ROBOTS {
        let body = body(robot);
        let parameters = body.parameters();
        for (i, p) in parameters.iter().enumerate() {
            assert!(parameters[..i].iter().all(|o| o.symbol != p.symbol), "{}", p.symbol);
            assert!(!p.unit.is_empty() && !p.meaning.is_empty() && p.nominal.is_finite());
        }
    }
}
