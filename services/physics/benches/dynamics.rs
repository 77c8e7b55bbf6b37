//! Nanoseconds per sample of inverse dynamics, one thread: `cargo bench -p lacuna-physics`.
//!
//! The baselines run in the same process on the same motions: the Delta written as its matrix equations stand
//! (general 3 × 3 inverse, J̇ as a matrix), the arm with 6 × 6 spatial matrices (Featherstone 2008, table 5.1).
//! Each figure is the median of several rounds over the same motions; every baseline's torque is held
//! against ours first, so that equal work is compared.

use lacuna_interfaces::RobotFile;
use lacuna_physics::delta::PARAMETERS;
use lacuna_physics::{Delta, Mat3, Motion, RigidBody, SerialChain, Vec3};
use nalgebra::{Matrix6, Vector6};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::hint::black_box;
use std::time::Instant;

const SAMPLES: usize = 4096;
const ROUNDS: usize = 41;

const DELTA: &str = "kind = \"delta\"\nname = \"bench\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";

/// q, q̇, q̈ of one sample.
type Sample<const N: usize> = [[f64; N]; 3];

/// Smooth, fast and incommensurable motions about a middle position.
fn motions<const N: usize>(middle: f64, swing: f64) -> Vec<Sample<N>> {
    let joint = |k: usize, i: usize| {
        let w = TAU * (0.7 + 0.31 * i as f64);
        let (s, c) = (w * k as f64 * 1e-3 + i as f64).sin_cos();
        [middle + swing * s, swing * w * c, -swing * w * w * s]
    };
    (0..SAMPLES).map(|k| std::array::from_fn(|d| std::array::from_fn(|i| joint(k, i)[d]))).collect()
}

fn motion<const N: usize>(m: &Sample<N>) -> Motion<'_> {
    Motion { q_rad: &m[0], qd_rad_s: &m[1], qdd_rad_s2: &m[2] }
}

/// Median and least nanoseconds per sample.
fn time<const N: usize>(samples: &[Sample<N>], mut run: impl FnMut(&Sample<N>)) -> (f64, f64) {
    let mut rounds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            samples.iter().for_each(|m| run(black_box(m)));
            start.elapsed().as_secs_f64() * 1e9 / samples.len() as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    (rounds[ROUNDS / 2], rounds[0])
}

fn report(name: &str, (median, least): (f64, f64)) {
    println!("{name:<62} {median:>8.1} {least:>8.1}");
}

/// Runs `body` through all its paths.
fn paths<const N: usize>(name: &str, body: &dyn RigidBody, samples: &[Sample<N>]) {
    let pi = body.nominal();
    let mut tau = [0.0; N];
    let mut y = vec![0.0; N * pi.len()];
    let inverse = time(samples, |m| {
        body.torque(&motion(m), black_box(&pi), &mut tau).unwrap();
        black_box(&tau);
    });
    report(&format!("{name}: inverse dynamics with kinematics"), inverse);
    let both = time(samples, |m| {
        black_box(body.evaluate(&motion(m), black_box(&pi), black_box(&pi)).unwrap());
    });
    report(&format!("{name}: two models and payload column (torque stage)"), both);
    let regressor = time(samples, |m| {
        body.regressor(&motion(m), &mut y).unwrap();
        black_box(&y);
    });
    report(&format!("{name}: regressor {N} x {}", pi.len()), regressor);
}

/// The Delta's equations as they stand in NOTATION.md, with general matrices.
fn delta_by_matrices(robot: &RobotFile, m: &Sample<3>, pi: &[f64]) -> Option<Vec3> {
    let g = robot.geometry.as_ref()?;
    let gravity = Vec3::from(robot.env.gravity);
    let r = g.ra - g.rb;
    let (qd, qdd) = (Vec3::from(m[1]), Vec3::from(m[2]));
    let alpha = g.alpha_deg.map(f64::to_radians);
    let arm = |i: usize| {
        let (s, c) = m[0][i].sin_cos();
        let (ca, sa) = (alpha[i].cos(), alpha[i].sin());
        (
            Vec3::new((r + g.l1 * c) * ca, (r + g.l1 * c) * sa, -g.l1 * s),
            Vec3::new(-g.l1 * s * ca, -g.l1 * s * sa, -g.l1 * c),
            Vec3::new(-g.l1 * c * ca, -g.l1 * c * sa, g.l1 * s),
        )
    };
    let arms = [arm(0), arm(1), arm(2)];
    // Two spheres subtracted from the third leave two planes: their line, then the sphere again.
    let planes = Mat3::from_rows(&[
        (arms[1].0 - arms[0].0).transpose(),
        (arms[2].0 - arms[0].0).transpose(),
        (arms[1].0 - arms[0].0).cross(&(arms[2].0 - arms[0].0)).transpose(),
    ]);
    let half = |i: usize| 0.5 * (arms[i].0 - arms[0].0).norm_squared();
    let a = planes.try_inverse()? * Vec3::new(half(1), half(2), 0.0);
    let normal = planes.row(2).transpose().normalize();
    let x = arms[0].0 + a - normal * normal.z.signum() * (g.l2 * g.l2 - a.norm_squared()).sqrt();
    let s = [x - arms[0].0, x - arms[1].0, x - arms[2].0];
    let a_inv_t = Mat3::from_columns(&s).transpose().try_inverse()?;
    let k = Mat3::from_diagonal(&Vec3::from_fn(|i, _| -s[i].dot(&arms[i].1)));
    let j = -a_inv_t * k;
    let xd = j * qd;
    let s_rate = Mat3::from_columns(&[xd - arms[0].1 * qd[0], xd - arms[1].1 * qd[1], xd - arms[2].1 * qd[2]]);
    let k_rate =
        Mat3::from_diagonal(&Vec3::from_fn(|i, _| -s_rate.column(i).dot(&arms[i].1) - s[i].dot(&arms[i].2) * qd[i]));
    let j_rate = -a_inv_t * (k_rate + s_rate.transpose() * j);
    let xdd = j * qdd + j_rate * qd;
    let legs = Vec3::from_fn(|i, _| pi[i] * qdd[i] - pi[3 + i] * gravity.dot(&arms[i].1) / g.l1);
    Some(legs + j.transpose() * (pi[9] * xdd - pi[10] * gravity))
}

/// Featherstone's RNEA with 6 × 6 matrices, classic DH, revolute.
struct Spatial {
    rows: Vec<[f64; 4]>,
    inertia: Vec<Matrix6<f64>>,
    gravity: Vec3,
}

impl Spatial {
    fn new(robot: &RobotFile, pi: &[f64]) -> Self {
        let inertia = pi
            .chunks(11)
            .map(|p| {
                let mc = Vec3::new(p[1], p[2], p[3]).cross_matrix();
                let mut out = Matrix6::zeros();
                out.fixed_view_mut::<3, 3>(0, 0)
                    .copy_from(&Mat3::new(p[4], p[5], p[6], p[5], p[7], p[8], p[6], p[8], p[9]));
                out.fixed_view_mut::<3, 3>(0, 3).copy_from(&mc);
                out.fixed_view_mut::<3, 3>(3, 0).copy_from(&mc.transpose());
                out.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Mat3::identity() * p[0]));
                out
            })
            .collect();
        let rows = robot.dh.iter().map(|d| [d.a, d.d, d.alpha, d.offset]).collect();
        Self { rows, inertia, gravity: Vec3::from(robot.env.gravity) }
    }

    fn torque(&self, m: &Sample<6>, rotor: f64) -> [f64; 6] {
        let mut x = [Matrix6::zeros(); 6];
        let mut s = [Vector6::zeros(); 6];
        let mut f = [Vector6::zeros(); 6];
        let mut v = Vector6::zeros();
        let mut acc = Vector6::new(0.0, 0.0, 0.0, -self.gravity.x, -self.gravity.y, -self.gravity.z);
        for i in 0..6 {
            let [a, d, alpha, offset] = self.rows[i];
            let (st, ct) = (m[0][i] + offset).sin_cos();
            let (sa, ca) = alpha.sin_cos();
            let e = Mat3::new(ct, -st * ca, st * sa, st, ct * ca, -ct * sa, 0.0, sa, ca).transpose();
            x[i].fixed_view_mut::<3, 3>(0, 0).copy_from(&e);
            x[i].fixed_view_mut::<3, 3>(3, 3).copy_from(&e);
            x[i].fixed_view_mut::<3, 3>(3, 0).copy_from(&(-e * Vec3::new(a * ct, a * st, d).cross_matrix()));
            let axis = Vec3::new(0.0, sa, ca);
            let slide = axis.cross(&Vec3::new(a, d * sa, d * ca));
            s[i] = Vector6::new(axis.x, axis.y, axis.z, slide.x, slide.y, slide.z);
            v = x[i] * v + s[i] * m[1][i];
            acc = x[i] * acc + s[i] * m[2][i] + motion_cross(&v) * s[i] * m[1][i];
            f[i] = self.inertia[i] * acc - motion_cross(&v).transpose() * (self.inertia[i] * v);
        }
        let mut tau = [0.0; 6];
        for i in (0..6).rev() {
            tau[i] = s[i].dot(&f[i]) + rotor * m[2][i];
            if i > 0 {
                f[i - 1] += x[i].transpose() * f[i];
            }
        }
        tau
    }
}

fn motion_cross(v: &Vector6<f64>) -> Matrix6<f64> {
    let w = Vec3::new(v[0], v[1], v[2]).cross_matrix();
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&w);
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&w);
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&Vec3::new(v[3], v[4], v[5]).cross_matrix());
    out
}

/// Six revolute joints with all link parameters given.
fn arm() -> RobotFile {
    use std::fmt::Write;
    let mut text = "kind = \"serial\"\nname = \"bench\"\njoints = [\"1\",\"2\",\"3\",\"4\",\"5\",\"6\"]\n".to_owned();
    for (a, d, alpha) in [
        (0.0, 0.32, FRAC_PI_2),
        (0.225, 0.035, 0.0),
        (0.02, 0.0, -FRAC_PI_2),
        (0.0, 0.225, FRAC_PI_2),
        (0.0, 0.0, -FRAC_PI_2),
        (0.0, 0.065, 0.0),
    ] {
        let _ = write!(text, "[[dh]]\na = {a:?}\nd = {d:?}\nalpha = {alpha:?}\n");
    }
    for i in 0..6 {
        let m = 5.0 - 0.7 * f64::from(i);
        let _ = write!(
            text,
            "[[link]]\nmass = {m:?}\ncom = [0.01, -0.06, 0.04]\ninertia = [0.05, 0.001, -0.002, 0.04, 0.003, 0.02]\n\
             rotor_inertia = 0.1\n"
        );
    }
    RobotFile::parse(&text).unwrap()
}

fn main() {
    println!("{:<62} {:>8} {:>8}", "ns per sample, one thread", "median", "least");

    let robot = RobotFile::parse(DELTA).unwrap();
    let delta = Delta::new(&robot).unwrap();
    let samples = motions::<3>(0.2, 0.4);
    let pi = delta.nominal();
    assert_eq!(pi.len(), PARAMETERS);
    paths("delta", &delta, &samples);
    let mut tau = [0.0; 3];
    for m in &samples {
        delta.torque(&motion(m), &pi, &mut tau).unwrap();
        let other = delta_by_matrices(&robot, m, &pi).unwrap();
        assert!((Vec3::from(tau) - other).norm() < 1e-9 * (1.0 + other.norm()), "{tau:?} {other}");
    }
    let naive = time(&samples, |m| {
        black_box(delta_by_matrices(&robot, m, black_box(&pi)));
    });
    report("baseline: delta by general matrices, inverse dynamics", naive);

    let robot = arm();
    let chain = SerialChain::new(&robot, None).unwrap();
    let samples = motions::<6>(0.2, 1.0);
    let pi = chain.nominal();
    paths("six joints", &chain, &samples);
    let spatial = Spatial::new(&robot, &pi);
    let mut tau = [0.0; 6];
    for m in &samples {
        chain.torque(&motion(m), &pi, &mut tau).unwrap();
        let other = spatial.torque(m, 0.1);
        for (a, b) in tau.iter().zip(&other) {
            assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{tau:?} {other:?}");
        }
    }
    let naive = time(&samples, |m| {
        black_box(spatial.torque(m, 0.1));
    });
    report("baseline: six joints by 6 x 6 spatial matrices", naive);
}
