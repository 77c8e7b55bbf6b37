//! Terms of a model file on the stream of the friction stage.

use lacuna_friction::{Config, Friction};
use lacuna_interfaces::{
    BadInput, FrictionTorque, Joints, MAX_JOINTS, ModelFile, RobotFile, Stage, StageContext, TorqueModel, flag,
};
use lacuna_physics::{Motion, build};
use std::f64::consts::TAU;

const ROBOT: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";
const FRICTION: &str = "schema = \"lacuna.model/1\"\nrobot = \"d\"\n\
    [friction]\nf_v = [0.5, 0.5, 0.5]\nf_c = [2.0, 2.0, 2.0]\n";

fn stage(terms: &str) -> Result<Friction, BadInput> {
    let robot = RobotFile::parse(ROBOT).unwrap();
    let model = ModelFile::parse(&format!("{FRICTION}{terms}")).unwrap();
    Friction::new(Config::default(), &StageContext { robot: &robot, urdf: None, model: Some(&model) })
}

/// A motion as the torque stage hands it on: all joints swing `size` about 0.3 rad, out of step.
fn input(k: usize, size: f64) -> TorqueModel {
    let mut m = TorqueModel::default();
    m.header.joints = 3;
    m.header.stamp_ns = 1_000_000 * k as i64;
    let w = TAU * 1.5;
    for j in 0..3 {
        let (s, c) = (w * k as f64 * 1e-3 + j as f64).sin_cos();
        (m.q_rad[j], m.qd_rad_s[j], m.qdd_rad_s2[j]) = (0.3 + size * s, size * w * c, -size * w * w * s);
    }
    m.temperature_degc = [f64::NAN; MAX_JOINTS];
    let robot = RobotFile::parse(ROBOT).unwrap();
    let body = build(&robot, None).unwrap();
    let motion = Motion { q_rad: &m.q_rad[..3], qd_rad_s: &m.qd_rad_s[..3], qdd_rad_s2: &m.qdd_rad_s2[..3] };
    body.torque(&motion, &body.nominal(), &mut m.tau_rigid_nm[..3]).unwrap();
    m.tau_nm = m.tau_rigid_nm;
    m
}

fn run(stage: &mut Friction, inputs: &[TorqueModel]) -> Vec<FrictionTorque> {
    let mut out = Vec::with_capacity(inputs.len());
    for m in inputs {
        stage.step(m, &mut |o| out.push(*o));
    }
    out
}

fn inputs(samples: usize) -> Vec<TorqueModel> {
    (0..samples).map(|k| input(k, 0.1)).collect()
}

#[test]
fn a_stribeck_term_adds_its_law_to_one_joint() {
    let with = "[[term]]\neffect = \"stribeck\"\njoints = [\"q2\"]\nparameters = { f_sc = 1.5, v_s = 0.3 }\n";
    let motion = inputs(700);
    let (plain, found) = (run(&mut stage("").unwrap(), &motion), run(&mut stage(with).unwrap(), &motion));
    let mut slid = 0;
    for ((m, a), b) in motion.iter().zip(&plain).zip(&found) {
        for j in 0..3 {
            let qd = m.qd_rad_s[j];
            let added = b.tau_friction_nm[j] - a.tau_friction_nm[j];
            let standing = qd.abs() < Config::default().standstill_rad_s;
            let law = 1.5 * (-(qd / 0.3).powi(2)).exp() * qd.signum();
            let expected = if j == 1 && !standing { law } else { 0.0 };
            assert!((added - expected).abs() < 1e-12, "joint {j} at {qd} rad/s: {added}");
            slid += usize::from(expected.abs() > 0.1);
        }
        assert_eq!(a.standstill, b.standstill);
    }
    assert!(slid > 100);
}

/// A standing joint's hold balances what terms leave, within ± f_c.
#[test]
fn standstill_holds_what_terms_leave() {
    let tilt = "[[term]]\neffect = \"torque_offset\"\njoints = [\"q1\"]\nparameters = { tau_0 = 0.7 }\n";
    let mut m = input(0, 0.0);
    (m.qd_rad_s, m.qdd_rad_s2) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    m.tau_nm[0] = m.tau_rigid_nm[0] + 1.2;
    m.tau_nm[1] = m.tau_rigid_nm[1] + 9.0;
    let o = run(&mut stage(tilt).unwrap(), &[m])[0];
    assert_eq!(o.standstill, 0b111);
    assert!((o.tau_friction_nm[0] - 1.2).abs() < 1e-12, "0.7 of the term, 0.5 held");
    assert!((o.tau_friction_nm[1] - 2.0).abs() < 1e-12, "no more than f_c is held");
}

/// Drive terms see rigid body and friction: a scale of 10 % is 10 % of both.
#[test]
fn drive_terms_see_the_friction_of_the_file() {
    let scale = "[[term]]\neffect = \"kt_scale\"\njoints = [\"q3\"]\nparameters = { g = 0.1 }\n";
    let motion = inputs(400);
    let (plain, found) = (run(&mut stage("").unwrap(), &motion), run(&mut stage(scale).unwrap(), &motion));
    let mut moving = 0;
    for (a, b) in plain.iter().zip(&found).filter(|(a, _)| a.standstill & 0b100 == 0) {
        let expected = 0.1 * (a.tau_rigid_nm[2] + a.tau_friction_nm[2]);
        assert!((b.tau_friction_nm[2] - a.tau_friction_nm[2] - expected).abs() < 1e-12);
        moving += 1;
    }
    assert!(moving > 300);
}

/// Memories start anew at a reset and at a gap, and stay silent where there is no model.
#[test]
fn memories_follow_the_flags() {
    let dahl = "[[term]]\neffect = \"presliding\"\njoints = [\"q1\"]\nparameters = { f = 2.0, delta = 0.02 }\n";
    let mut motion = inputs(300);
    for (at, flags) in [(100, flag::GAP), (200, flag::STATE_RESET)] {
        motion[at].header.flags = flags;
    }
    let found = run(&mut stage(dahl).unwrap(), &motion);
    for at in [100, 200] {
        let fresh = run(&mut stage(dahl).unwrap(), &motion[at..at + 50]);
        let of = |list: &[FrictionTorque]| list.iter().map(|o| o.tau_friction_nm).collect::<Vec<Joints>>();
        assert_eq!(of(&found[at..at + 50]), of(&fresh), "from sample {at} on");
    }
    motion[50].header.flags = flag::UNREACHABLE;
    motion[50].tau_rigid_nm = [0.0; MAX_JOINTS];
    let (lost, plain) = (run(&mut stage(dahl).unwrap(), &motion[..60]), run(&mut stage("").unwrap(), &motion[..60]));
    assert_eq!(lost[50].tau_friction_nm, plain[50].tau_friction_nm);
}

#[test]
fn terms_stream_without_allocating_and_twice_alike() {
    let joint = "[[term]]\njoints = [\"q2\"]\neffect = ";
    let whole = "[[term]]\neffect = ";
    let terms = [
        format!("{joint}\"stribeck\"\nparameters = {{ f_sc = 1.5, v_s = 0.1 }}\n"),
        format!("{joint}\"load_friction\"\nparameters = {{ mu = 0.08 }}\n"),
        format!("{joint}\"presliding\"\nparameters = {{ f = 2.0, delta = 0.01 }}\n"),
        format!("{joint}\"elasticity\"\nparameters = {{ k = 8000.0 }}\n"),
        format!("{joint}\"cogging\"\nparameters = {{ a_s = 0.4, h = 2.0 }}\n"),
        format!("{whole}\"base_tilt\"\nparameters = {{ tilt_1 = 0.02 }}\n"),
        format!("{whole}\"air_drag\"\nparameters = {{ c = 0.3 }}\n"),
        format!("{whole}\"torque_delay\"\nparameters = {{ D = 0.0015 }}\n"),
        format!("{whole}\"payload\"\nparameters = {{ m = 1.0, t_on = 0.1, t_off = 0.3 }}\n"),
    ]
    .concat();
    let mut first = stage(&terms).unwrap();
    let motion = inputs(500);
    let mut sum = 0.0;
    let counted = allocation_counter::measure(|| {
        for m in &motion {
            first.step(m, &mut |o| sum += o.tau_friction_nm[1].abs());
        }
    });
    assert_eq!(counted.count_total, 0, "allocations in 500 samples");
    assert!(sum.is_finite() && sum > 500.0);
    let again = run(&mut stage(&terms).unwrap(), &motion);
    assert_eq!(run(&mut stage(&terms).unwrap(), &motion), again);
}

#[test]
fn a_term_that_cannot_run_is_refused_with_its_place() {
    for (terms, expected) in [
        ("[[term]]\neffect = \"rust\"\n", "term[0]: found effect \"rust\"; expected one of coulomb"),
        ("[[term]]\neffect = \"stribeck\"\njoints = [\"q2\"]\n", "term[0]: stribeck: found no v_s"),
        ("[[term]]\neffect = \"stribeck\"\njoints = [\"q9\"]\n", "joint 'q9' is not one of q1, q2, q3"),
        (
            "[[term]]\neffect = \"air_drag\"\nparameters = { c = 0.1 }\n[[term]]\neffect = \"coulomb\"\njoints = [\"q1\"]\n",
            "term[1]: coulomb: found no f_c",
        ),
    ] {
        let e = stage(terms).err().expect(terms).to_string();
        assert!(e.contains(expected) && !e.contains('\n'), "'{expected}' not in '{e}'");
    }
}
