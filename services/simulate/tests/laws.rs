//! Laws of mechanics that the plant must keep, whatever its derivation.

use lacuna_interfaces::{Joints, RobotFile};
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::plant::friction::JointFriction;
use lacuna_simulate::plant::{Mechanism, Stepper, TrueRobot};
use lacuna_simulate::random::Random;

/// A six-joint arm with full inertias, one of the joints sliding.
fn arm() -> RobotFile {
    let mut text =
        String::from("kind = \"serial\"\nname = \"arm\"\njoints = [\"a\", \"b\", \"c\", \"d\", \"e\", \"f\"]\n");
    let rows = [
        "a = 0.1\nd = 0.4\nalpha = -1.5707963",
        "a = 0.45\noffset = -1.57",
        "a = 0.04\nalpha = -1.5707963\njoint = \"prismatic\"",
        "d = 0.42\nalpha = 1.5707963",
        "alpha = -1.5707963",
        "d = 0.08",
    ];
    rows.iter().for_each(|r| text.push_str(&format!("[[dh]]\n{r}\n")));
    for k in 0..6 {
        let m = 9.0 / f64::from(k + 1);
        text.push_str(&format!(
            "[[link]]\nmass = {m}\ncom = [-0.05, 0.02, 0.03]\ninertia = [{}, 0.003, -0.002, {}, 0.004, {}]\nrotor_inertia = 0.2\n",
            0.04 * m,
            0.05 * m,
            0.03 * m
        ));
    }
    RobotFile::parse(&text).unwrap()
}

fn delta() -> (TrueRobot, Joints) {
    let mut robot = TrueRobot::nominal(&RobotFile::parse(DEMO_ROBOT).unwrap(), None).unwrap();
    let Mechanism::Delta(d) = &mut robot.mechanism else { panic!("a Delta") };
    for rod in &mut d.forearm {
        rod.inertia /= 3.0;
        rod.centre = 0.44;
    }
    d.arm[1].moment_across = 0.07;
    let mut q = Joints::default();
    q[..3].copy_from_slice(&[0.3, 0.7, 0.5]);
    (robot, q)
}

fn serial() -> (TrueRobot, Joints) {
    let robot = TrueRobot::nominal(&arm(), None).unwrap();
    let mut q = Joints::default();
    q[..6].copy_from_slice(&[0.3, -0.7, 0.1, 1.1, 0.4, -0.2]);
    (robot, q)
}

fn energy(robot: &TrueRobot, q: &Joints, qd: &Joints) -> f64 {
    let rotors: f64 = robot.joints.iter().zip(qd).map(|(j, v)| 0.5 * j.rotor * v * v).sum();
    robot.mechanism.energy(q, qd, &robot.loads(0.0, &[])).unwrap() + rotors
}

#[test]
fn free_motion_keeps_its_energy() {
    for (robot, q) in [delta(), serial()] {
        let mut qd = Joints::default();
        qd[..3].copy_from_slice(&[0.8, -0.5, 0.3]);
        let swing = |steps: u32| {
            let dt = 0.2 / f64::from(steps);
            let mut plant = Stepper::at_rest(&robot, &[], 0.0, dt, &q).unwrap();
            plant.set_velocity(&qd);
            let before = energy(&robot, &q, &qd);
            let mut worst = 0.0f64;
            let mut kinetic = 0.0f64;
            for k in 0..steps {
                plant.step(f64::from(k) * dt, &Joints::default()).unwrap();
                let now = energy(&robot, plant.link(), &plant.link_speed());
                worst = worst.max((now - before).abs());
                let still = energy(&robot, plant.link(), &Joints::default());
                kinetic = kinetic.max(now - still);
            }
            worst / kinetic
        };
        // At the simulator's own step the error is small; at half the step it is a quarter: second order.
        let (coarse, fine) = (swing(3200), swing(6400));
        assert!(coarse < 2e-6, "energy drifts by {coarse:.1e} of the kinetic energy");
        assert!((3.0..5.5).contains(&(coarse / fine)), "order: {coarse:.2e} → {fine:.2e}");
    }
}

#[test]
fn power_of_the_torque_is_the_energy_rate() {
    let mut random = Random::new(5, 0);
    for (robot, base) in [delta(), serial()] {
        let n = robot.joints.len();
        for _ in 0..50 {
            let (mut q, mut qd, mut qdd) = (base, Joints::default(), Joints::default());
            for i in 0..n {
                q[i] += random.uniform(-0.3, 0.3);
                qd[i] = random.uniform(-3.0, 3.0);
                qdd[i] = random.uniform(-20.0, 20.0);
            }
            let loads = robot.loads(0.0, &[]);
            let tau = robot.mechanism.inverse(&q, &qd, &qdd, &loads).unwrap();
            let power: f64 = (0..n).map(|i| tau[i] * qd[i]).sum();
            let at = |t: f64| {
                let (mut q, mut qd) = (q, qd);
                for i in 0..n {
                    q[i] += t * qd[i] + 0.5 * t * t * qdd[i];
                    qd[i] += t * qdd[i];
                }
                robot.mechanism.energy(&q, &qd, &loads).unwrap()
            };
            let h = 2e-4;
            let rate = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
            assert!((power - rate).abs() < 1e-6 * (1.0 + power.abs()), "{power} W against {rate} W");
        }
    }
}

#[test]
fn holding_torque_is_the_slope_of_the_potential() {
    for (robot, q) in [delta(), serial()] {
        let loads = robot.loads(0.0, &[]);
        let still = Joints::default();
        let tau = robot.mechanism.inverse(&q, &still, &still, &loads).unwrap();
        for i in 0..robot.joints.len() {
            let at = |d: f64| {
                let mut q = q;
                q[i] += d;
                robot.mechanism.energy(&q, &still, &loads).unwrap()
            };
            let slope = (at(1e-4) - at(-1e-4)) / 2e-4;
            assert!((tau[i] - slope).abs() < 1e-6 * (1.0 + slope.abs()), "joint {}: {} against {slope}", i + 1, tau[i]);
        }
        // And under it the robot stays where it is.
        let mut plant = Stepper::at_rest(&robot, &[], 0.0, 1e-4, &q).unwrap();
        for k in 0..100 {
            plant.step(f64::from(k) * 1e-4, &tau).unwrap();
        }
        for i in 0..robot.joints.len() {
            assert!((plant.link()[i] - q[i]).abs() < 1e-10);
        }
    }
}

#[test]
fn a_joint_within_its_friction_stands_exactly_still_and_friction_only_takes_energy() {
    for (mut robot, q) in [delta(), serial()] {
        let n = robot.joints.len();
        let loads = robot.loads(0.0, &[]);
        let still = Joints::default();
        let hold = robot.mechanism.inverse(&q, &still, &still, &loads).unwrap();
        for joint in &mut robot.joints {
            joint.friction = JointFriction::base(5.0, 0.0);
        }
        let mut push = hold;
        (0..n).for_each(|i| push[i] += if i % 2 == 0 { 4.9 } else { -4.9 });
        let mut plant = Stepper::at_rest(&robot, &[], 0.0, 1e-4, &q).unwrap();
        for k in 0..200 {
            plant.step(f64::from(k) * 1e-4, &push).unwrap();
        }
        assert_eq!(plant.link()[..n], q[..n], "stuck joints must not creep");
        // Free fall with friction: energy never rises, and sliding joints come to rest or keep sliding.
        let mut qd = Joints::default();
        qd[..3].copy_from_slice(&[1.5, -1.0, 0.6]);
        let mut plant = Stepper::at_rest(&robot, &[], 0.0, 6.25e-5, &q).unwrap();
        plant.set_velocity(&qd);
        let mut last = energy(&robot, &q, &qd);
        let first = last;
        for k in 0..3000 {
            plant.step(f64::from(k) * 6.25e-5, &Joints::default()).unwrap();
            let now = energy(&robot, plant.link(), &plant.link_speed());
            assert!(now <= last + 1e-6, "step {k}: energy rose from {last} to {now}");
            last = now;
        }
        assert!(last < first - 0.1, "friction took only {} J", first - last);
    }
}

#[test]
fn inverse_kinematics_closes_the_legs() {
    let (robot, _) = delta();
    let Mechanism::Delta(d) = &robot.mechanism else { panic!("a Delta") };
    let mut random = Random::new(11, 0);
    for _ in 0..200 {
        let mut q = Joints::default();
        (0..3).for_each(|i| q[i] = random.uniform(-0.4, 1.3));
        let x = d.forward(&q).unwrap();
        let back = d.inverse_kinematics(&x).unwrap();
        (0..3).for_each(|i| assert!((back[i] - q[i]).abs() < 1e-9, "{q:?} → {back:?}"));
        // Velocities and accelerations against differences of the path x(t) = x + t v + t² a / 2.
        let [v, a] = [0, 1].map(|_| nalgebra::Vector3::from_fn(|_, _| random.uniform(-1.0, 1.0)));
        let at = |t: f64| d.inverse_kinematics(&(x + v * t + a * (0.5 * t * t))).unwrap();
        let [_, qd, qdd] = d.inverse_motion(&x, &v, &(a)).unwrap();
        let h = 1e-4;
        for i in 0..3 {
            let (lo, mid, hi) = (at(-h)[i], q[i], at(h)[i]);
            assert!(((hi - lo) / (2.0 * h) - qd[i]).abs() < 1e-5 * (1.0 + qd[i].abs()));
            assert!(((hi - 2.0 * mid + lo) / (h * h) - qdd[i]).abs() < 1e-3 * (1.0 + qdd[i].abs()));
        }
    }
}
