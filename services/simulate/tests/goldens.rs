//! The plant against Pinocchio (`tests/oracles/simulate_goldens.py`): a closed chain with real parallelograms
//! for the Delta, ABA, CRBA and bias for chains from DH rows and from a URDF.

use lacuna_interfaces::{Joints, RobotFile};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::plant::delta::{Arm, Forearm};
use lacuna_simulate::plant::{Delta, Dynamics, Loads, Mechanism, TrueRobot};
use nalgebra::{DMatrix, DVector, Vector3};

struct Golden(Vec<(String, Vec<f64>)>);

impl Golden {
    fn parse(text: &str) -> Self {
        let lines = text.lines().filter(|l| !l.starts_with('#'));
        Self(
            lines
                .map(|l| {
                    let (key, numbers) = l.split_once(": ").unwrap();
                    (key.to_owned(), numbers.split(' ').map(|n| n.parse().unwrap()).collect())
                })
                .collect(),
        )
    }

    fn all(&self, key: &str) -> Vec<&[f64]> {
        let found: Vec<&[f64]> = self.0.iter().filter(|(k, _)| k == key).map(|(_, v)| v.as_slice()).collect();
        assert!(!found.is_empty(), "no {key}");
        found
    }

    fn one(&self, key: &str) -> &[f64] {
        self.all(key)[0]
    }
}

fn joints(v: &[f64]) -> Joints {
    let mut j = Joints::default();
    j[..v.len()].copy_from_slice(v);
    j
}

fn gravity(g: &Golden) -> [f64; 3] {
    g.one("gravity").try_into().unwrap()
}

#[test]
fn delta_against_a_closed_chain_of_six_rods() {
    let g = Golden::parse(include_str!("goldens/delta.txt"));
    let pick = |key: &str, i: usize| g.one(key)[i];
    let mut delta = Delta::nominal(&RobotFile::parse(DEMO_ROBOT).unwrap()).unwrap();
    delta.platform_kg = pick("platform", 0);
    for i in 0..3 {
        let alpha = pick("alpha_rad", i);
        delta.radial[i] = Vector3::new(alpha.cos(), alpha.sin(), 0.0);
        delta.offset[i] = pick("offset", 0);
        delta.arm[i] = Arm {
            length: pick("l1", i),
            inertia: pick("arm_inertia", i),
            moment_along: pick("arm_along", i),
            moment_across: pick("arm_across", i),
        };
        delta.forearm[i] = Forearm {
            length: pick("l2", i),
            mass: pick("forearm_mass", i),
            centre: pick("forearm_centre", i),
            inertia: pick("forearm_inertia", i),
        };
    }
    let mechanism = Mechanism::Delta(Box::new(delta));
    let loads = Loads::gravity(gravity(&g));
    let mut worst = 0.0f64;
    for state in g.all("state") {
        let [q, qd, qdd] = [0, 3, 6].map(|k| joints(&state[k..k + 3]));
        let tau = mechanism.inverse(&q, &qd, &qdd, &loads).unwrap();
        let mut d = Dynamics::default();
        mechanism.dynamics(&q, &qd, &loads, &mut d).unwrap();
        let scale = state[9..12].iter().fold(1.0f64, |m, t| m.max(t.abs()));
        for i in 0..3 {
            worst = worst.max((tau[i] - state[9 + i]).abs() / scale);
            assert!((d.tip[i] - state[12 + i]).abs() < 1e-12);
            assert!((d.tip_velocity[i] - state[15 + i]).abs() < 1e-11);
        }
    }
    println!("Delta inverse dynamics against Pinocchio: {worst:.1e} of the torque");
    assert!(worst < 1e-11, "{worst:.1e}");
}

fn check_chain(robot: &TrueRobot, states: &[&[f64]], gravity: [f64; 3]) -> f64 {
    let n = robot.joints.len();
    let loads = Loads::gravity(gravity);
    let mut worst = 0.0f64;
    for state in states {
        let part = |k: usize| &state[k * n..(k + 1) * n];
        let mut d = Dynamics::default();
        robot.mechanism.dynamics(&joints(part(0)), &joints(part(1)), &loads, &mut d).unwrap();
        let (tau, qdd) = (part(2), part(3));
        let inertia = &state[4 * n..4 * n + n * n];
        let bias = &state[4 * n + n * n..];
        let mut m = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in 0..n {
                m[(i, j)] = d.inertia[i][j] + if i == j { robot.joints[i].rotor } else { 0.0 };
                worst = worst.max((m[(i, j)] - inertia[i * n + j]).abs() / (1.0 + inertia[i * n + i].abs()));
            }
            worst = worst.max((d.bias[i] - bias[i]).abs() / (1.0 + bias[i].abs()));
        }
        let force = DVector::from_fn(n, |i, _| tau[i] - d.bias[i]);
        let found = m.cholesky().unwrap().solve(&force);
        let scale = qdd.iter().fold(1.0f64, |m, a| m.max(a.abs()));
        worst = (0..n).map(|i| (found[i] - qdd[i]).abs() / scale).fold(worst, f64::max);
    }
    worst
}

#[test]
fn dh_chain_against_aba_crba_and_bias() {
    let g = Golden::parse(include_str!("goldens/serial.txt"));
    let mut text = format!(
        "kind = \"serial\"\nname = \"golden\"\njoints = [\"1\", \"2\", \"3\", \"4\", \"5\", \"6\"]\n[env]\ngravity = {:?}\n",
        gravity(&g)
    );
    for row in g.all("dh") {
        let joint = if row[4] == 1.0 { "prismatic" } else { "revolute" };
        let [a, d, alpha, offset] = [0, 1, 2, 3].map(|k| row[k]);
        text += &format!("[[dh]]\na = {a:?}\nd = {d:?}\nalpha = {alpha:?}\noffset = {offset:?}\njoint = \"{joint}\"\n");
    }
    for l in g.all("link") {
        text += &format!(
            "[[link]]\nmass = {:?}\ncom = {:?}\ninertia = {:?}\nrotor_inertia = {:?}\n",
            l[0],
            &l[1..4],
            &l[4..10],
            l[10]
        );
    }
    let robot = TrueRobot::nominal(&RobotFile::parse(&text).unwrap(), None).unwrap();
    let worst = check_chain(&robot, &g.all("dh_state"), gravity(&g));
    println!("DH chain against Pinocchio: {worst:.1e}");
    assert!(worst < 1e-9, "{worst:.1e}");
}

#[test]
fn urdf_chain_against_aba_crba_and_bias() {
    let g = Golden::parse(include_str!("goldens/serial.txt"));
    let file =
        "kind = \"serial\"\nname = \"skew_arm\"\nurdf = \"arm.urdf\"\njoints = [\"j1\", \"j2\", \"slide\", \"j4\"]\n";
    let robot = TrueRobot::nominal(&RobotFile::parse(file).unwrap(), Some(include_str!("goldens/arm.urdf"))).unwrap();
    let worst = check_chain(&robot, &g.all("urdf_state"), gravity(&g));
    println!("URDF chain against Pinocchio: {worst:.1e}");
    assert!(worst < 1e-9, "{worst:.1e}");
}

#[test]
fn unusable_urdfs_are_refused_in_words() {
    let text = include_str!("goldens/arm.urdf");
    let robot = |joints: &str| {
        RobotFile::parse(&format!("kind = \"serial\"\nname = \"skew_arm\"\nurdf = \"arm.urdf\"\njoints = [{joints}]\n"))
            .unwrap()
    };
    let all = "\"j1\", \"j2\", \"slide\", \"j4\"";
    let cases = [
        (all, Some(text.replace("</robot>", "")), ""),
        (all, Some(text.replace("xyz=\"0 0.6 0.8\"", "xyz=\"0 0 0\"")), "axis"),
        (all, Some(text.replace("mass value=\"7.5\"", "mass value=\"heavy\"")), "heavy"),
        (all, Some(text.replace("<child link=\"l1\"/>", "<child link=\"nowhere\"/>")), "nowhere"),
        (all, Some(text.replace("<parent link=\"world\"/>", "<parent link=\"tool\"/>")), "circle"),
        ("\"j1\", \"slide\", \"j2\", \"j4\"", Some(text.to_owned()), "hang"),
        ("\"j1\", \"elbow\"", Some(text.to_owned()), "elbow"),
        ("\"j1\", \"tool_joint\"", Some(text.to_owned()), "fixed"),
        (all, None, "URDF"),
    ];
    for (joints, urdf, expect) in cases {
        let e = TrueRobot::nominal(&robot(joints), urdf.as_deref()).unwrap_err();
        assert!(e.what.contains(expect), "{expect}: {e}");
        assert!(!e.to_string().contains('\n'), "{e}");
    }
}
