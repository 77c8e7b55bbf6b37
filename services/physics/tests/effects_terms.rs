//! The terms of a model file at work: who sees whose torque, what is refused, and that nothing allocates.

mod common;
#[path = "common/effects.rs"]
mod support;

use common::{ARM, DELTA};
use lacuna_interfaces::model::Term;
use lacuna_interfaces::{Joints, MAX_JOINTS, ModelFile};
use lacuna_physics::Motion;
use lacuna_physics::effects::{TermInput, Terms, build_terms, registry};
use support::{Robot, fits, joints, map, shaking, typical, with_drive};

fn term(robot: &Robot, effect: &str, joints: &[usize], parameters: &[(&str, f64)]) -> Term {
    Term {
        effect: effect.to_owned(),
        joints: joints.iter().map(|j| robot.file.joints[*j].clone()).collect(),
        parameters: map(parameters),
    }
}

/// Streams the shaking motion through terms; `friction` is what the tau holds on entry.
fn stream(robot: &Robot, terms: &mut Terms, samples: usize, friction: f64) -> Vec<Joints> {
    let n = robot.n();
    let mut out = Vec::with_capacity(samples);
    for k in 0..samples {
        let at =
            |i: usize| -> Joints { std::array::from_fn(|j| if j < n { shaking(j, k as f64 * 1e-3)[i] } else { 0.0 }) };
        let (q, qd, qdd) = (at(0), at(1), at(2));
        let mut rigid = [0.0; MAX_JOINTS];
        let motion = Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] };
        robot.body.torque(&motion, &robot.pi, &mut rigid[..n]).unwrap();
        let mut tau = [friction; MAX_JOINTS];
        tau[n..].fill(0.0);
        let input = TermInput {
            stamp_ns: 1_000_000 * k as i64,
            q_rad: &q,
            qd_rad_s: &qd,
            qdd_rad_s2: &qdd,
            direction: &qd.map(|v| if v == 0.0 { 0.0 } else { v.signum() }),
            ramp_rad_s: 0.01,
            tau_rigid_nm: &rigid,
            temperature_degc: &[30.0; MAX_JOINTS],
        };
        terms.add_torque(&input, &mut tau);
        tau.iter_mut().take(n).for_each(|t| *t -= friction);
        out.push(tau);
    }
    out
}

fn terms(robot: &Robot, list: &[Term]) -> Terms {
    Terms::new(list, &robot.context()).unwrap()
}

fn rms(list: &[Joints], j: usize) -> f64 {
    (list.iter().map(|t| t[j] * t[j]).sum::<f64>() / list.len() as f64).sqrt()
}

#[test]
fn link_effects_load_the_gear_and_the_drive_sees_all() {
    let robot = Robot::new(DELTA);
    let payload = term(&robot, "payload", &[], &[("m", 2.0)]);
    let load = term(&robot, "load_friction", &[1], &[("mu", 0.1)]);
    let scale = term(&robot, "kt_scale", &[1], &[("g", 0.2)]);
    let alone = |list: &[Term], friction: f64| stream(&robot, &mut terms(&robot, list), 200, friction);
    let carried = alone(std::slice::from_ref(&payload), 0.0);
    let rigid: Vec<f64> = alone(&[term(&robot, "kt_scale", &[1], &[("g", 1.0)])], 0.0).iter().map(|t| t[1]).collect();
    // Written last, the payload still loads the gear: μ |τ_rigid − J_r θ̈ + payload|.
    let both = alone(&[load, payload.clone()], 0.0);
    for k in 0..200 {
        let [_, qd, qdd] = shaking(1, k as f64 * 1e-3);
        let expected = 0.1 * (rigid[k] - 0.06 * qdd + carried[k][1]).abs() * qd.signum();
        assert!((both[k][1] - carried[k][1] - expected).abs() < 1e-9, "sample {k}");
    }
    // Written first, the drive's scale still sees payload and friction.
    let all = alone(&[scale, payload], 1.5);
    for k in 0..200 {
        let expected = 1.2 * (rigid[k] + carried[k][1] + 1.5) - rigid[k] - 1.5;
        assert!((all[k][1] - expected).abs() < 1e-9, "sample {k}: {} {expected}", all[k][1]);
    }
}

#[test]
fn no_terms_change_nothing_and_nonsense_resets() {
    let robot = Robot::new(DELTA);
    let mut none = terms(&robot, &[]);
    assert!(none.is_empty());
    assert_eq!(stream(&robot, &mut none, 3, 0.7), vec![[0.0; MAX_JOINTS]; 3]);

    let mut dahl = terms(&robot, &[term(&robot, "presliding", &[0], &[("f", 2.0), ("delta", 0.01)])]);
    let first = stream(&robot, &mut dahl, 50, 0.0);
    dahl.reset();
    assert_eq!(stream(&robot, &mut dahl, 50, 0.0), first, "after a reset it starts anew");
    assert_ne!(stream(&robot, &mut dahl, 50, 0.0), first, "without one it remembers");
    // A sample without a number adds nothing and resets.
    let zero = [0.0; MAX_JOINTS];
    let bad = [f64::NAN; MAX_JOINTS];
    let mut tau = zero;
    let input = TermInput {
        stamp_ns: 0,
        q_rad: &bad,
        qd_rad_s: &zero,
        qdd_rad_s2: &zero,
        direction: &zero,
        ramp_rad_s: 0.01,
        tau_rigid_nm: &zero,
        temperature_degc: &bad,
    };
    dahl.add_torque(&input, &mut tau);
    assert_eq!(tau, zero);
    assert_eq!(stream(&robot, &mut dahl, 50, 0.0), first);
}

#[test]
fn a_model_file_s_terms_run_or_are_refused_in_one_line() {
    let robot = Robot::new(DELTA);
    let head = "schema = \"lacuna.model/1\"\nrobot = \"even\"\n";
    let good = format!(
        "{head}[[term]]\neffect = \"stribeck\"\njoints = [\"q2\"]\nparameters = {{ f_sc = 1.5, v_s = 0.5 }}\n\
         [[term]]\neffect = \"base_tilt\"\nparameters = {{ tilt_1 = 0.02 }}\n"
    );
    let build = |text: &str| {
        let model = ModelFile::parse(text).unwrap();
        model.check(&robot.file).unwrap();
        build_terms(&model, &robot.context())
    };
    let mut running = build(&good).unwrap();
    assert_eq!(running.iter().map(|t| t.effect().id).collect::<Vec<_>>(), ["base_tilt", "stribeck"]);
    let tau = stream(&robot, &mut running, 100, 0.0);
    assert!(rms(&tau, 0) > 1e-3 && rms(&tau, 1) > rms(&tau, 0));
    for (from, to, expected) in [
        ("stribeck", "stribek", "term[0]: found effect \"stribek\"; expected one of coulomb, viscous"),
        ("f_sc", "fsc", "term[0]: stribeck: found parameter \"fsc\"; expected f_sc, v_s"),
        ("[\"q2\"]", "[]", "term[0]: stribeck: joints: found none"),
        ("v_s = 0.5", "v_s = -0.5", "term[0]: stribeck: v_s: found -0.5; expected"),
        ("tilt_1 = 0.02", "tilt_1 = 2.0", "term[1]: base_tilt: tilt_1: found 2"),
    ] {
        let e = build(&good.replace(from, to)).unwrap_err().to_string();
        assert!(e.contains(expected) && !e.contains('\n'), "'{expected}' not in '{e}'");
    }
}

/// Every effect streams without a single allocation after it is made.
#[test]
fn streaming_does_not_allocate() {
    for text in [DELTA, ARM] {
        let robot = Robot::new(&with_drive(text));
        for effect in registry().iter().filter(|e| fits(e, &robot.file)) {
            let list = [Term {
                effect: effect.id.to_owned(),
                joints: joints(effect, robot.n()).iter().map(|j| robot.file.joints[*j].clone()).collect(),
                parameters: typical(effect, &robot.file),
            }];
            let mut running = terms(&robot, &list);
            let mut out = Vec::new();
            let made = allocation_counter::measure(|| out = stream(&robot, &mut running, 500, 0.0)).count_total;
            assert_eq!(made, 1, "{}: the list of results is the one allocation of the test itself", effect.id);
            assert!(out.iter().flatten().all(|v| v.is_finite()), "{}", effect.id);
            assert_eq!(allocation_counter::measure(|| running.reset()).count_total, 0, "{}: reset", effect.id);
        }
    }
}
