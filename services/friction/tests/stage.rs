//! Viscous and Coulomb friction on the stream: sliding, standing, and what is passed on.

use lacuna_friction::{Config, Friction};
use lacuna_interfaces::{BadInput, FrictionTorque, ModelFile, RobotFile, Stage, StageContext, TorqueModel, flag};
use proptest::prelude::*;

fn robot() -> RobotFile {
    RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
         [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n",
    )
    .unwrap()
}

fn model() -> ModelFile {
    let mut model = ModelFile::nominal(&robot());
    model.friction.f_v = vec![0.5, 0.4, 0.3];
    model.friction.f_c = vec![2.0, 1.5, 1.0];
    model.friction.offset = vec![0.1, 0.0, -0.2];
    model
}

fn make(model: Option<&ModelFile>, config: Config) -> Result<Friction, BadInput> {
    Friction::new(config, &StageContext { robot: &robot(), urdf: None, model })
}

fn one(stage: &mut Friction, input: &TorqueModel) -> FrictionTorque {
    let mut out = Vec::new();
    stage.step(input, &mut |o| out.push(*o));
    stage.finish(&mut |o| out.push(*o));
    assert_eq!(out.len(), 1);
    out[0]
}

fn sample(qd: [f64; 3], tau: [f64; 3], rigid: [f64; 3]) -> TorqueModel {
    let mut m = TorqueModel::default();
    m.header.seq = 7;
    m.header.stamp_ns = 5_000_000;
    m.header.joints = 3;
    m.header.flags = flag::REPAIRED;
    m.q_rad[..3].copy_from_slice(&[0.3, 0.4, 0.5]);
    m.qd_rad_s[..3].copy_from_slice(&qd);
    m.tau_nm[..3].copy_from_slice(&tau);
    m.tau_rigid_nm[..3].copy_from_slice(&rigid);
    m.tau_nominal_nm[..3].copy_from_slice(&[9.0, 8.0, 7.0]);
    m.payload_column_nm_kg[..3].copy_from_slice(&[1.0, 2.0, 3.0]);
    m
}

#[test]
fn sliding_joints_by_hand() {
    let input = sample([2.0, -1.0, 0.02], [0.0; 3], [0.0; 3]);
    let out = one(&mut make(Some(&model()), Config::default()).unwrap(), &input);
    let expected = [0.1 + 0.5 * 2.0 + 2.0, -0.4 - 1.5, -0.2 + 0.3 * 0.02 + 1.0];
    for (found, expected) in out.tau_friction_nm.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-15, "{found} {expected}");
    }
    assert_eq!(out.tau_friction_nm[3..], [0.0; 5]);
    assert_eq!((out.standstill, out.header), (0, input.header));
    assert_eq!((out.q_rad, out.qd_rad_s, out.tau_nm), (input.q_rad, input.qd_rad_s, input.tau_nm));
    assert_eq!((out.tau_rigid_nm, out.tau_nominal_nm), (input.tau_rigid_nm, input.tau_nominal_nm));
    assert_eq!(out.payload_column_nm_kg, input.payload_column_nm_kg);
    // Without a model file there is no friction, and nothing holds a standing joint.
    let out = one(&mut make(None, Config::default()).unwrap(), &sample([2.0, 0.0, 0.0], [5.0; 3], [1.0; 3]));
    assert_eq!(out.tau_friction_nm, [0.0; 8]);
    assert_eq!(out.standstill, 0b110);
}

#[test]
fn a_standing_joint_holds_what_it_can() {
    // Joint 1 needs 1.4 Nm of its 2.0; joint 2 would need 5 but holds 1.5; joint 3 slides.
    let input = sample([0.0, 0.01, -1.0], [6.5, 9.004, 3.0], [5.0, 4.0, 3.0]);
    let out = one(&mut make(Some(&model()), Config::default()).unwrap(), &input);
    assert_eq!(out.standstill, 0b011);
    assert_eq!(out.header.flags, flag::REPAIRED | flag::STANDSTILL);
    let residual = |i: usize| out.tau_nm[i] - out.tau_rigid_nm[i] - out.tau_friction_nm[i];
    assert!(residual(0).abs() < 1e-15);
    assert!((residual(1) - 3.5).abs() < 1e-12, "what friction cannot hold stays in the residual");
    assert!((out.tau_friction_nm[2] - (-0.2 - 0.3 - 1.0)).abs() < 1e-15);
    // Drive off: only gravity to hold. No model torque: nothing to balance.
    let mut off = input;
    off.header.flags = flag::DRIVE_OFF;
    let out = one(&mut make(Some(&model()), Config::default()).unwrap(), &off);
    assert!((out.tau_friction_nm[0] - (0.1 - 2.0)).abs() < 1e-15);
    off.header.flags = flag::UNREACHABLE;
    let out = one(&mut make(Some(&model()), Config::default()).unwrap(), &off);
    assert_eq!(out.tau_friction_nm[0], 0.1);
}

#[test]
fn standstill_speed_comes_from_the_model_first() {
    let mut model = model();
    let input = sample([0.05; 3], [0.0; 3], [0.0; 3]);
    let standing = |model: &ModelFile, v: f64| {
        one(&mut make(Some(model), Config { standstill_rad_s: v }).unwrap(), &input).standstill
    };
    assert_eq!(standing(&model, 0.02), 0);
    assert_eq!(standing(&model, 0.1), 0b111);
    model.friction.standstill_rad_s = vec![0.1, 0.02, 0.1];
    assert_eq!(standing(&model, 0.02), 0b101);
}

#[test]
fn bad_input_is_refused_in_words() {
    for v in [f64::NAN, -0.1, f64::INFINITY] {
        assert!(make(None, Config { standstill_rad_s: v }).is_err_and(|e| e.what.contains("standstill_rad_s")));
    }
    assert!(toml::from_str::<Config>("standstil = 1").is_err());
    let mut negative = model();
    negative.friction.f_c[1] = -0.5;
    let e = make(Some(&negative), Config::default()).err().unwrap();
    assert!(e.what.contains("f_c") && e.what.contains("-0.5") && e.what.contains("joint 2"), "{e}");
    let mut short = model();
    short.friction.f_v.pop();
    assert!(make(Some(&short), Config::default()).is_err());
}

#[test]
fn nothing_is_allocated_after_new() {
    let mut stage = make(Some(&model()), Config::default()).unwrap();
    let mut sum = 0.0;
    let counted = allocation_counter::measure(|| {
        for k in 0..10_000 {
            let t = f64::from(k) * 1e-3;
            let input = sample([t.sin(), (3.0 * t).cos(), 0.0], [1.0; 3], [0.5; 3]);
            stage.step(&input, &mut |o| sum += o.tau_friction_nm[0]);
        }
        stage.finish(&mut |_| ());
    });
    assert_eq!(counted.count_total, 0);
    assert!(sum.is_finite());
}

proptest! {
    /// Friction takes energy out of motion, never puts it in; its hold never exceeds f_c; and no input gives NaN
    /// where torques are numbers.
    #[test]
    fn friction_dissipates(
        qd in prop::array::uniform3(prop_oneof![-10.0..10.0f64, -0.03..0.03f64, Just(0.0), Just(f64::NAN), Just(f64::INFINITY)]),
        tau in prop::array::uniform3(-50.0..50.0f64),
        rigid in prop::array::uniform3(-50.0..50.0f64),
    ) {
        let mut model = model();
        model.friction.offset.clear();
        let out = one(&mut make(Some(&model), Config::default()).unwrap(), &sample(qd, tau, rigid));
        for i in 0..3 {
            let friction = out.tau_friction_nm[i];
            prop_assert!(friction.is_finite());
            let stands = out.standstill >> i & 1 == 1;
            if stands {
                let v = if qd[i].is_finite() { qd[i] } else { 0.0 };
                let held = friction - model.friction.f_v[i] * v;
                prop_assert!(held.abs() <= model.friction.f_c[i] + 1e-12);
                // Never more than is asked for: the residual does not change its sign.
                let (before, after) = (tau[i] - rigid[i] - model.friction.f_v[i] * v, tau[i] - rigid[i] - friction);
                prop_assert!(before * after >= -1e-12);
            } else {
                prop_assert!(friction * qd[i] >= model.friction.f_c[i] * qd[i].abs() - 1e-12);
            }
        }
    }
}
