//! The plant against the estimator's equations: two derivations that share no code must say the same torque.

use lacuna_interfaces::{Joints, ModelFile, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use lacuna_simulate::config::{FrictionConfig, NoiseConfig};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::plant::TrueRobot;
use lacuna_simulate::random::Random;
use lacuna_simulate::twin::{Twin, TwinConfig};
use lacuna_simulate::{SimulationConfig, simulate};

const URDF: &str = include_str!("goldens/arm.urdf");
const SKEW: &str = "kind = \"serial\"\nname = \"skew\"\nurdf = \"arm.urdf\"\njoints = [\"j1\", \"j2\", \"slide\", \"j4\"]\n[limits]\nq_max_rad = 1.0\nq_min_rad = -1.0\n";

fn dh_arm() -> RobotFile {
    lacuna_simulate::case::draw_robot(lacuna_interfaces::robot::Kind::Serial, &mut Random::new(9, 0)).unwrap()
}

fn robots() -> Vec<(RobotFile, Option<&'static str>)> {
    vec![(RobotFile::parse(DEMO_ROBOT).unwrap(), None), (dh_arm(), None), (RobotFile::parse(SKEW).unwrap(), Some(URDF))]
}

fn plant_torque(robot: &TrueRobot, q: &Joints, qd: &Joints, qdd: &Joints) -> Joints {
    let mut tau = robot.mechanism.inverse(q, qd, qdd, &robot.loads(0.0, &[])).unwrap();
    for (i, joint) in robot.joints.iter().enumerate() {
        tau[i] += joint.rotor * qdd[i];
    }
    tau
}

fn compare(robot: &TrueRobot, body: &dyn RigidBody, pi: &[f64], random: &mut Random) -> f64 {
    let n = robot.joints.len();
    let mut worst = 0.0f64;
    for _ in 0..100 {
        let (mut q, mut qd, mut qdd) = (Joints::default(), Joints::default(), Joints::default());
        for i in 0..n {
            q[i] = random.uniform(-0.3, 1.1);
            qd[i] = random.uniform(-6.0, 6.0);
            qdd[i] = random.uniform(-80.0, 80.0);
        }
        let mut tau = vec![0.0; n];
        let motion = Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] };
        body.torque(&motion, pi, &mut tau).unwrap();
        let plant = plant_torque(robot, &q, &qd, &qdd);
        let scale = tau.iter().fold(1.0f64, |m, t| m.max(t.abs()));
        worst = (0..n).map(|i| (plant[i] - tau[i]).abs() / scale).fold(worst, f64::max);
    }
    worst
}

#[test]
fn nominal_robots_agree() {
    for (file, urdf) in robots() {
        let body = lacuna_physics::build(&file, urdf).unwrap();
        let pi: Vec<f64> = body.parameters().iter().map(|p| p.nominal).collect();
        let plant = TrueRobot::nominal(&file, urdf).unwrap();
        let worst = compare(&plant, body.as_ref(), &pi, &mut Random::new(1, 0));
        println!("{}: {worst:.1e}", file.name);
        assert!(worst < 1e-11, "{}: {worst:.1e}", file.name);
    }
}

#[test]
fn twins_of_fitted_parameters_agree() {
    for (file, urdf) in robots() {
        let body = lacuna_physics::build(&file, urdf).unwrap();
        let mut random = Random::new(2, 0);
        let mut model = ModelFile::nominal(&file);
        // Every parameter off by a fifth and a little, as a fit may come out, physical or not.
        let pi: Vec<f64> = body
            .parameters()
            .iter()
            .map(|p| p.nominal * random.uniform(0.8, 1.2) + 0.01 * random.uniform(-1.0, 1.0))
            .collect();
        for (p, v) in body.parameters().iter().zip(&pi) {
            model.rigid_body.parameters.insert(p.symbol.clone(), *v);
        }
        let n = file.joint_count();
        let twin = Twin::new(&file, urdf, &model, TwinConfig::new(vec![0.0; n], 1000.0)).unwrap();
        let worst = compare(twin.plant(), body.as_ref(), &pi, &mut random);
        println!("{}: {worst:.1e}", file.name);
        assert!(worst < 1e-10, "{}: {worst:.1e}", file.name);
    }
}

#[test]
fn simulated_motion_needs_the_torque_that_was_recorded() {
    for (file, urdf) in robots() {
        let n = file.joint_count();
        let mut config = SimulationConfig {
            friction: FrictionConfig { none: true, ..FrictionConfig::default() },
            noise: NoiseConfig {
                torque_nm: vec![0.0; n],
                encoder_steps: 0.0,
                process_share: 0.0,
                spikes_per_s: 0.0,
                encoder_step_rad: Some(0.0),
            },
            ..SimulationConfig::default()
        };
        config.trajectories.truncate(3);
        config.trajectories.iter_mut().for_each(|t| (t.count, t.duration_s) = (1, 3.0));
        let s = simulate(&file, urdf, &config).unwrap();
        let body = lacuna_physics::build(&file, urdf).unwrap();
        let pi: Vec<f64> = body.parameters().iter().map(|p| p.nominal).collect();
        let (mut error, mut size, mut count) = (0.0, 0.0, 0.0);
        for l in &s.behind {
            for k in 0..l.t_s.len() {
                let at = |c: &Vec<Vec<f64>>| c.iter().map(|c| c[k]).collect::<Vec<f64>>();
                let (q, qd, qdd) = (at(&l.q_rad), at(&l.qd_rad_s), at(&l.qdd_rad_s2));
                let mut tau = vec![0.0; n];
                let motion = Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd };
                body.torque(&motion, &pi, &mut tau).unwrap();
                for i in 0..n {
                    error += (tau[i] - l.tau_nm[i][k]).powi(2);
                    size += l.tau_nm[i][k].powi(2);
                    count += 1.0;
                }
            }
        }
        let relative = f64::sqrt(error / size);
        println!("{}: {relative:.1e} of {:.1} Nm", file.name, f64::sqrt(size / f64::max(count, 1.0)));
        assert!(relative < 3e-4, "{}: {relative:.1e}", file.name);
    }
}

#[test]
fn forearms_with_distributed_mass_agree() {
    let file = RobotFile::parse(DEMO_ROBOT).unwrap();
    let delta = lacuna_physics::Delta::new(&file).unwrap();
    let rod = lacuna_physics::delta::Forearm { mass_kg: 0.55, com_fraction: 0.46, inertia_kg_m2: 0.03 };
    let pi = delta.distributed_forearms(&rod);
    let mut plant = TrueRobot::nominal(&file, None).unwrap();
    let lacuna_simulate::plant::Mechanism::Delta(d) = &mut plant.mechanism else { panic!("a Delta") };
    for f in &mut d.forearm {
        (f.mass, f.centre, f.inertia) = (0.55, 0.46, 0.03);
    }
    let worst = compare(&plant, &delta, &pi, &mut Random::new(3, 0));
    assert!(worst < 1e-11, "{worst:.1e}");
}
