//! What motor-side position and torque cannot tell apart: the equivalences that findings report as groups,
//! verified in numbers.

mod common;
#[path = "common/effects.rs"]
mod support;

use common::{ARM, DELTA};
use lacuna_physics::effects::{EffectContext, Regime, find};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;
use support::{Robot, Signals, map, regime, rms, shaking, torque_of};

const PENDULUM: &str = "kind = \"serial\"\nname = \"pendulum\"\njoints = [\"1\"]\n[env]\ngravity = [9.81, 0.0, 0.0]\n\
    [[dh]]\na = 0.3\n[[link]]\nmass = 1.0\ncom = [-0.1, 0.02, 0.0]\ninertia = [0.0, 0.0, 0.0, 0.0, 0.0, 0.01]\n";

/// All columns of an effect, each over all joints in a row.
fn columns(id: &str, joints: &[usize], p: &[(&str, f64)], c: &EffectContext<'_>, s: &Signals) -> Vec<Vec<f64>> {
    let columns = find(id).unwrap().columns(joints, &map(p), c, &s.track()).unwrap();
    (0..columns.count()).map(|i| (0..c.joint_count()).flat_map(|j| columns.column(i, j).to_vec()).collect()).collect()
}

/// Share of `target` that lies outside the span of `others`.
fn outside(target: &[f64], others: &[Vec<f64>]) -> f64 {
    let x = DMatrix::from_columns(&others.iter().map(|c| DVector::from_column_slice(c)).collect::<Vec<_>>());
    let y = DVector::from_column_slice(target);
    let svd = x.clone().svd(true, true);
    let fit = svd.solve(&y, 1e-10).unwrap();
    (&y - x * fit).norm() / y.norm()
}

fn all_outside(targets: &[Vec<f64>], others: &[Vec<f64>]) -> f64 {
    targets.iter().map(|t| outside(t, others)).fold(0.0, f64::max)
}

#[test]
fn asymmetry_is_an_offset_while_sliding() {
    let robot = Robot::new(ARM);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let [coulomb, offset, asym] =
        ["coulomb", "torque_offset", "coulomb_asym"].map(|id| columns(id, &[2], &[], &c, &s).remove(0));
    assert!(outside(&asym, &[coulomb.clone(), offset.clone()]) < 1e-12);
    assert!(outside(&offset, &[coulomb.clone(), asym]) < 1e-12);
    assert!(outside(&offset, &[coulomb]) > 0.1, "it is not Coulomb friction itself");
}

#[test]
fn rotor_and_arm_inertia_are_one_on_a_fixed_axis() {
    for (text, j) in [(DELTA, 1), (PENDULUM, 0), (ARM, 0)] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let arm = columns("arm_inertia", &[j], &[], &c, &s).remove(0);
        let rotor = columns("rotor_inertia", &[j], &[], &c, &s).remove(0);
        assert!(outside(&arm, &[rotor]) < 1e-9, "{}", robot.file.name);
    }
    // Further out in a chain the arm's inertia is felt at the joints before, the rotor's is not.
    let robot = Robot::new(ARM);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let arm = columns("arm_inertia", &[2], &[], &c, &s).remove(0);
    let rotor = columns("rotor_inertia", &[2], &[], &c, &s).remove(0);
    assert!(outside(&arm, &[rotor]) > 0.1);
}

#[test]
fn first_moments_are_a_sine_spring_on_a_fixed_axis() {
    for (text, j) in [(DELTA, 1), (PENDULUM, 0)] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let moments = columns("arm_inertia", &[j], &[], &c, &s)[1..].to_vec();
        let spring = columns("gravity_spring", &[j], &[], &c, &s);
        assert!(all_outside(&moments, &spring) < 1e-9, "{}", robot.file.name);
        assert!(all_outside(&spring, &moments) < 1e-9, "{}", robot.file.name);
    }
}

#[test]
fn a_scale_of_all_torque_constants_is_all_masses_scaled() {
    for text in [DELTA, ARM] {
        let robot = Robot::new(text);
        let c = robot.context();
        let s = regime(&c, Regime::Shaking);
        let all: Vec<usize> = (0..robot.n()).collect();
        let scaled: Vec<f64> = robot.pi.iter().map(|p| 0.1 * p).collect();
        let masses = s.torque(robot.body.as_ref(), &scaled).concat();
        let drives = torque_of(find("kt_scale").unwrap(), &all, &map(&[("g", 0.1)]), &c, &s).concat();
        assert!(common::relative(&drives, &masses, 1e-9) < 1e-12);
        // One joint alone is not: no change of π does the same.
        let one = columns("kt_scale", &[1], &[], &c, &s).remove(0);
        let p = robot.pi.len();
        let regressor: Vec<Vec<f64>> = (0..p)
            .map(|k| {
                let mut unit = vec![0.0; p];
                unit[k] = 1.0;
                s.torque(robot.body.as_ref(), &unit).concat()
            })
            .filter(|column| column.iter().any(|v| v.abs() > 1e-9))
            .collect();
        assert!(outside(&one, &regressor) > 0.01, "{}: separable through the structure", robot.file.name);
    }
}

#[test]
fn a_constant_payload_is_a_heavier_platform() {
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    let payload = columns("payload", &[], &[], &c, &s).remove(0);
    let mut platform = vec![0.0; robot.pi.len()];
    for symbol in ["m_in", "m_gr"] {
        platform[robot.body.parameters().iter().position(|p| p.symbol == symbol).unwrap()] = 1.0;
    }
    let heavier = s.torque(robot.body.as_ref(), &platform).concat();
    assert!(common::relative(&payload, &heavier, 1e-9) < 1e-12);
}

/// A torque that comes D late is the torque of positions that came D early, at any fraction of a sample.
#[test]
fn late_torque_is_early_position() {
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let dt = 1e-3;
    let s = Signals::new(&c, 400, dt, shaking);
    for delay in [0.37 * dt, dt, 2.6 * dt, 11.2 * dt, -0.4 * dt] {
        let shifted = Signals::new(&c, 400, dt, |j, t| shaking(j, t - delay));
        let late = torque_of(find("torque_delay").unwrap(), &[], &map(&[("D", delay)]), &c, &s);
        let mut wrong = vec![Vec::new(); 3];
        let mut difference = vec![Vec::new(); 3];
        for j in 0..3 {
            for k in 20..400 {
                let truth = shifted.drive[j][k] - s.drive[j][k];
                wrong[j].push(late[j][k] - truth);
                difference[j].push(truth);
            }
        }
        let share = rms(&wrong) / rms(&difference);
        assert!(share < 1e-4, "delay {delay}: {share:.2e}");
    }
}

/// Far below its resonance a soft joint's torque is nearly that of a delay; stiffness and delay trade.
#[test]
fn practical_groups_are_hard_to_tell() {
    let robot = Robot::new(DELTA);
    let c = robot.context();
    let s = regime(&c, Regime::Shaking);
    // Over a narrow range a sine spring is an offset and a cable.
    let narrow = Signals::new(&c, 400, 1e-3, |j, t| [0.3 + 0.05 * (TAU * 2.0 * t + j as f64).sin(), 0.0, 0.0]);
    let spring = columns("gravity_spring", &[1], &[], &c, &narrow);
    let mut cable = columns("cable_spring", &[1], &[], &c, &narrow);
    cable.extend(columns("torque_offset", &[1], &[], &c, &narrow));
    assert!(all_outside(&spring, &cable) < 1e-3);
    // A tilt is three pairs of gravity terms, nearly.
    let tilt = columns("base_tilt", &[], &[], &c, &s);
    let mut moments = Vec::new();
    for j in 0..3 {
        moments.extend(columns("gravity_spring", &[j], &[], &c, &s));
    }
    let left = all_outside(&tilt, &moments);
    assert!((1e-6..0.3).contains(&left), "practically, not exactly: {left:.2e}");
}
