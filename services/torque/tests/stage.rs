//! The torque stage as the graph sees it: configuration, messages, flags, allocations.

use lacuna_interfaces::{BadInput, JointSmoothed, ModelFile, RobotFile, Stage, StageContext, TorqueModel, flag};
use lacuna_physics::{Motion, build, parameters_of};
use lacuna_torque::{Config, Torque};

const DELTA: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
    [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";

const ARM: &str = "kind = \"serial\"\nname = \"a\"\njoints = [\"1\", \"2\"]\n[env]\ngravity = [9.81, 0.0, 0.0]\n\
    [[dh]]\na = 0.3\n[[dh]]\na = 0.2\n\
    [[link]]\nmass = 1.0\ncom = [-0.1, 0.0, 0.0]\n[[link]]\nmass = 0.5\ncom = [-0.05, 0.0, 0.0]\n";

fn config(text: &str) -> Result<Config, BadInput> {
    toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))
}

fn model(robot: &RobotFile, rigid_body: &str) -> ModelFile {
    let text = format!("schema = \"lacuna.model/1\"\nrobot = \"{}\"\n{rigid_body}", robot.name);
    ModelFile::parse(&text).unwrap()
}

fn stage(robot: &RobotFile, model: Option<&ModelFile>, text: &str) -> Result<Torque, BadInput> {
    Torque::new(config(text)?, &StageContext { robot, urdf: None, model })
}

fn sample(n: usize, seq: u64) -> JointSmoothed {
    let mut s = JointSmoothed::default();
    s.header.joints = n as u32;
    s.header.seq = seq;
    s.header.stamp_ns = 1_000_000 * seq as i64;
    s.header.flags = flag::GAP;
    for i in 0..n {
        let phase = seq as f64 * 0.01 + i as f64;
        s.q_rad[i] = 0.3 + 0.3 * phase.sin();
        s.qd_rad_s[i] = 2.0 * phase.cos();
        s.qdd_rad_s2[i] = -15.0 * phase.sin();
        s.tau_nm[i] = phase;
        s.temperature_degc[i] = f64::NAN;
    }
    s
}

fn step(stage: &mut Torque, input: &JointSmoothed) -> TorqueModel {
    let mut out = Vec::new();
    stage.step(input, &mut |o| out.push(*o));
    assert_eq!(out.len(), 1, "one output a sample");
    out[0]
}

#[test]
fn fills_nominal_rigid_and_payload() {
    for (text, rigid) in [
        (DELTA, "[rigid_body]\nrho1 = 1.2\nrho2 = 0.9\n"),
        (DELTA, "[rigid_body.parameters]\nI1 = 0.3\nm_gr = 2.0\n"),
        (ARM, "[rigid_body.parameters]\nmx1 = 0.4\nIa2 = 0.1\n"),
    ] {
        let robot = RobotFile::parse(text).unwrap();
        let body = build(&robot, None).unwrap();
        let n = body.joint_count();
        let model = model(&robot, rigid);
        let identified = parameters_of(body.as_ref(), &model.rigid_body).unwrap();
        let input = sample(n, 7);
        let motion =
            Motion { q_rad: &input.q_rad[..n], qd_rad_s: &input.qd_rad_s[..n], qdd_rad_s2: &input.qdd_rad_s2[..n] };
        let torque = |pi: &[f64]| {
            let mut tau = [0.0; 8];
            body.torque(&motion, pi, &mut tau[..n]).unwrap();
            tau
        };
        let mut column = [0.0; 8];
        body.payload_column(&motion, &mut column[..n]).unwrap();

        let out = step(&mut stage(&robot, Some(&model), "").unwrap(), &input);
        assert_eq!(out.header, input.header);
        assert_eq!((out.q_rad, out.qd_rad_s, out.qdd_rad_s2), (input.q_rad, input.qd_rad_s, input.qdd_rad_s2));
        assert_eq!(out.tau_nm, input.tau_nm);
        assert!(out.temperature_degc[0].is_nan());
        assert_eq!(out.tau_nominal_nm, torque(&body.nominal()));
        assert_eq!(out.tau_rigid_nm, torque(&identified));
        assert_ne!(out.tau_rigid_nm, out.tau_nominal_nm);
        assert_eq!(out.payload_column_nm_kg, column);

        // Told to keep to the robot file, or without a model, rigid is nominal.
        for mut other in
            [stage(&robot, Some(&model), "rigid_body = \"nominal\"").unwrap(), stage(&robot, None, "").unwrap()]
        {
            let out = step(&mut other, &input);
            assert_eq!(out.tau_rigid_nm, out.tau_nominal_nm);
            assert_eq!(out.tau_nominal_nm, torque(&body.nominal()));
        }
    }
}

#[test]
fn samples_without_a_torque_are_flagged_and_zero() {
    let robot = RobotFile::parse(&DELTA.replace("l2 = 0.88", "l2 = 0.45")).unwrap();
    let mut stage = stage(&robot, None, "").unwrap();
    let mut out_of_reach = sample(3, 1);
    out_of_reach.q_rad = [0.0; 8];
    let mut not_a_number = sample(3, 2);
    not_a_number.q_rad[..3].fill(1.0);
    not_a_number.qdd_rad_s2[1] = f64::NAN;
    let mut other_robot = sample(4, 3);
    other_robot.q_rad[..3].fill(1.0);
    let mut absurd = sample(3, 4);
    absurd.q_rad[..3].fill(1.0);
    absurd.header.joints = u32::MAX;
    for input in [out_of_reach, not_a_number, other_robot, absurd] {
        let out = step(&mut stage, &input);
        assert!(out.header.has(flag::UNREACHABLE | flag::GAP), "seq {}", input.header.seq);
        assert_eq!(out.header.seq, input.header.seq);
        for field in [out.tau_nominal_nm, out.tau_rigid_nm, out.payload_column_nm_kg] {
            assert_eq!(field, [0.0; 8]);
        }
        assert_eq!(out.q_rad, input.q_rad);
    }
    // It recovers at once.
    let mut good = sample(3, 5);
    good.q_rad[..3].fill(1.0);
    let out = step(&mut stage, &good);
    assert!(!out.header.has(flag::UNREACHABLE) && out.tau_nominal_nm[0] != 0.0);
}

#[test]
fn bad_configurations_and_models_are_refused_in_words() {
    let robot = RobotFile::parse(DELTA).unwrap();
    let arm = RobotFile::parse(ARM).unwrap();
    let refused = |result: Result<Torque, BadInput>, words: &[&str]| {
        let error = result.unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "'{word}' not in: {error}");
        }
        assert!(!error.contains('\n'), "{error}");
    };
    refused(stage(&robot, None, "rigid = 1"), &["rigid"]);
    refused(stage(&robot, None, "rigid_body = \"guessed\""), &["guessed", "identified"]);
    let unknown = model(&robot, "[rigid_body.parameters]\nI9 = 0.3\n");
    refused(stage(&robot, Some(&unknown), ""), &["I9", "I1", "m_JE"]);
    let grey = model(&arm, "[rigid_body]\nrho1 = 1.2\n");
    refused(stage(&arm, Some(&grey), ""), &["rho1", "Delta"]);
    refused(stage(&robot, Some(&grey), ""), &["\"a\"", "\"d\""]);
}

#[test]
fn steps_do_not_allocate() {
    // The counter counts at all.
    assert_eq!(allocation_counter::measure(|| drop(std::hint::black_box(vec![1.0_f64; 3]))).count_total, 1);
    let mixed = ARM.replacen("a = 0.3", "a = 0.3\njoint = \"prismatic\"", 1);
    for text in [DELTA, ARM, &mixed] {
        let robot = RobotFile::parse(text).unwrap();
        let n = robot.joint_count();
        let mut stage = stage(&robot, None, "").unwrap();
        let mut sum = 0.0;
        let mut flagged = 0;
        let counted = allocation_counter::measure(|| {
            for seq in 1..2000 {
                let mut input = sample(n, seq);
                if seq % 10 == 0 {
                    input.q_rad[0] = f64::NAN; // the way of a bad sample must not allocate either
                }
                stage.step(&input, &mut |out| {
                    sum += out.tau_rigid_nm[0];
                    flagged += u32::from(out.header.has(flag::UNREACHABLE));
                });
            }
            stage.finish(&mut |_| {});
        });
        assert!(sum.is_finite() && sum != 0.0);
        assert_eq!(flagged, 199);
        assert_eq!(counted.count_total, 0, "{}", robot.name);
    }
}
