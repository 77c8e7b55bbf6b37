//! Robots and helpers that the tests share.
#![allow(dead_code, reason = "each test file uses a part")]

use lacuna_interfaces::RobotFile;
use lacuna_physics::{Motion, RigidBody, build};

/// A Delta of the paper's class.
pub const DELTA: &str = "kind = \"delta\"\nname = \"even\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";

/// A smaller one with uneven legs, counted clockwise, on a tilted base.
pub const DELTA_TILTED: &str = "kind = \"delta\"\nname = \"tilted\"\n[geometry]\nl1 = 0.22\nl2 = 0.6\nra = 0.16\nrb = 0.06\n\
    alpha_deg = [250.0, 125.0, 10.0]\n[mass]\nplatform = 0.4\nupper_arm = 0.7\nforearm_point = 0.1\n\
    rotor_inertia = 0.01\n[env]\ngravity = [1.2, -0.7, -9.6]\n";

/// Six revolute joints with a spherical wrist.
pub const ARM: &str = "kind = \"serial\"\nname = \"arm\"\njoints = [\"1\", \"2\", \"3\", \"4\", \"5\", \"6\"]\n\
    [[dh]]\nd = 0.32\nalpha = 1.5707963267948966\n[[dh]]\na = 0.225\nd = 0.035\n\
    [[dh]]\na = 0.02\nalpha = -1.5707963267948966\n[[dh]]\nd = 0.225\nalpha = 1.5707963267948966\n\
    [[dh]]\nalpha = -1.5707963267948966\n[[dh]]\nd = 0.065\n\
    [[link]]\nmass = 6.0\ncom = [0.01, -0.06, 0.04]\ninertia = [0.05, 0.001, -0.002, 0.04, 0.003, 0.02]\nrotor_inertia = 0.2\n\
    [[link]]\nmass = 5.0\ncom = [-0.1, 0.01, 0.08]\ninertia = [0.02, -0.003, 0.002, 0.06, 0.001, 0.05]\nrotor_inertia = 0.15\n\
    [[link]]\nmass = 3.0\ncom = [0.01, 0.02, 0.03]\ninertia = [0.02, 0.001, 0.0, 0.02, 0.001, 0.01]\nrotor_inertia = 0.1\n\
    [[link]]\nmass = 2.0\ncom = [0.0, -0.08, 0.01]\ninertia = [0.015, 0.0, 0.001, 0.01, 0.0, 0.015]\nrotor_inertia = 0.05\n\
    [[link]]\nmass = 1.0\ncom = [0.0, 0.01, 0.02]\ninertia = [0.004, 0.0, 0.0, 0.003, 0.0, 0.004]\nrotor_inertia = 0.03\n\
    [[link]]\nmass = 0.4\ncom = [0.005, 0.0, -0.02]\ninertia = [0.001, 0.0, 0.0, 0.001, 0.0, 0.0015]\nrotor_inertia = 0.02\n";

/// Turning and sliding joints mixed, axes skew, on a base that hangs askew.
pub const MIXED: &str = "kind = \"serial\"\nname = \"mixed\"\njoints = [\"1\", \"2\", \"3\", \"4\"]\n\
    [env]\ngravity = [3.0, -5.0, 7.0]\n\
    [[dh]]\na = 0.2\nd = 0.1\nalpha = 0.7\noffset = 0.3\n[[dh]]\na = 0.15\nd = 0.05\nalpha = -1.1\njoint = \"prismatic\"\n\
    [[dh]]\na = -0.1\nd = 0.2\nalpha = 2.0\noffset = -1.0\n[[dh]]\na = 0.05\nalpha = 0.4\njoint = \"prismatic\"\n\
    [[link]]\nmass = 3.0\ncom = [0.05, 0.02, -0.03]\ninertia = [0.03, 0.002, 0.001, 0.02, -0.001, 0.04]\nrotor_inertia = 0.1\n\
    [[link]]\nmass = 2.0\ncom = [-0.04, 0.01, 0.06]\ninertia = [0.01, 0.001, 0.0, 0.02, 0.002, 0.015]\nrotor_inertia = 0.4\n\
    [[link]]\nmass = 1.5\ncom = [0.02, -0.05, 0.01]\ninertia = [0.01, 0.0, 0.001, 0.008, 0.001, 0.012]\nrotor_inertia = 0.05\n\
    [[link]]\nmass = 1.0\ncom = [0.03, 0.03, 0.03]\ninertia = [0.004, 0.0, 0.0, 0.004, 0.0, 0.005]\nrotor_inertia = 0.2\n";

/// All of them.
pub const ROBOTS: [&str; 4] = [DELTA, DELTA_TILTED, ARM, MIXED];

pub fn body(robot: &str) -> Box<dyn RigidBody> {
    build(&RobotFile::parse(robot).unwrap(), None).unwrap()
}

/// q, q̇, q̈ of up to eight joints.
pub type State = [[f64; 8]; 3];

/// The first n joints of a state; a Delta's angles are scaled into its workspace.
pub fn motion<'a>(body: &dyn RigidBody, state: &'a mut State) -> Motion<'a> {
    if body.as_delta().is_some() {
        state[0].iter_mut().for_each(|q| *q = 0.25 + 0.3 * *q);
    }
    let n = body.joint_count();
    Motion { q_rad: &state[0][..n], qd_rad_s: &state[1][..n], qdd_rad_s2: &state[2][..n] }
}

/// Greatest difference relative to the greatest magnitude of `expected` (at least `floor`).
pub fn relative(found: &[f64], expected: &[f64], floor: f64) -> f64 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(floor, |m, v| m.max(v.abs()));
    found.iter().zip(expected).fold(0.0, |m, (a, b)| {
        let d = (a - b).abs() / scale;
        if d.is_nan() { f64::INFINITY } else { f64::max(m, d) }
    })
}

/// d/dt at t = 0 along q(t) = q + q̇ t + q̈ t²/2 of any function of (q, q̇): fourth-order differences.
pub fn along(m: &Motion<'_>, f: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> Vec<f64> {
    let h = 1e-3 / (1.0 + m.qd_rad_s.iter().fold(0.0, |s: f64, v| s.max(v.abs())));
    let at = |t: f64| {
        let q: Vec<f64> =
            (0..m.q_rad.len()).map(|i| m.q_rad[i] + t * (m.qd_rad_s[i] + 0.5 * t * m.qdd_rad_s2[i])).collect();
        let qd: Vec<f64> = (0..m.q_rad.len()).map(|i| m.qd_rad_s[i] + t * m.qdd_rad_s2[i]).collect();
        f(&q, &qd)
    };
    let (a, b, c, d) = (at(-2.0 * h), at(-h), at(h), at(2.0 * h));
    (0..a.len()).map(|i| (a[i] - 8.0 * b[i] + 8.0 * c[i] - d[i]) / (12.0 * h)).collect()
}

pub fn torque(body: &dyn RigidBody, m: &Motion<'_>, pi: &[f64]) -> Vec<f64> {
    let mut tau = vec![0.0; body.joint_count()];
    body.torque(m, pi, &mut tau).unwrap();
    tau
}
