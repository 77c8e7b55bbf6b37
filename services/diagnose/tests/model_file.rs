//! The model file alone gives the residual that the findings state: what the stages load is the whole model.

use lacuna_diagnose::scene::{Raw, Scene};
use lacuna_diagnose::{Conditioning, Options, Outcome, diagnose, tolerance};
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{Joints, ModelFile};
use lacuna_physics::effects::{EffectContext, TermInput, build_terms};
use lacuna_physics::{Motion, RigidBody, parameters_of};
use lacuna_simulate::case::{CaseOptions, draw_case};
use lacuna_simulate::simulate;

fn case(kind: Kind, ids: &[&str], seed: u64, mass_error: f64) -> Options {
    let options = CaseOptions {
        effects: ids.len(),
        ids: ids.iter().map(|s| (*s).to_owned()).collect(),
        severity: [1.0, 1.0],
        kind,
        mass_error,
        trajectories: 5,
        duration_s: 3.0,
        ..CaseOptions::default()
    };
    let case = draw_case(seed, &options).unwrap();
    let simulation = simulate(&case.robot, None, &case.config).unwrap();
    let start_s = simulation.manifest.files.iter().map(|f| f.start_time_s).collect();
    Options {
        robot: case.robot,
        urdf: None,
        recordings: simulation.recordings,
        sim: Vec::new(),
        conditioning: Conditioning { start_s, ..Conditioning::default() },
        seed: 1,
    }
}

/// Residual per joint of a model file as the torque and friction stages have it: no search, no regression.
fn residual_of(options: &Options, file: &ModelFile) -> Vec<f64> {
    let mut scene = Scene::new(&options.robot, None, &options.recordings, &options.conditioning).unwrap();
    // As in the diagnosis: where something is picked or placed no row counts.
    let times = file.terms.iter().flat_map(|t| ["t_on", "t_off"].into_iter().filter_map(|s| t.parameters.get(s)));
    let switches: Vec<(f64, f64)> = times.map(|t| (t - 0.07, t + 0.07)).collect();
    scene.blank(&switches);
    let body = lacuna_physics::build(&options.robot, None).unwrap();
    let pi = parameters_of(body.as_ref(), &file.rigid_body).unwrap();
    let context = EffectContext { robot: &options.robot, urdf: None, body: body.as_ref(), pi: &pi };
    let raw: Raw =
        scene.pieces.iter().map(|piece| stretch(&scene, piece, body.as_ref(), &pi, file, &context)).collect();
    let column = scene.column(raw);
    (0..scene.joints)
        .map(|j| {
            let count = scene.mask[j].iter().filter(|m| **m).count() as f64;
            (column.part[j].iter().map(|v| v * v).sum::<f64>() / count).sqrt()
        })
        .collect()
}

fn stretch(
    scene: &Scene,
    piece: &lacuna_diagnose::scene::Piece,
    body: &dyn RigidBody,
    pi: &[f64],
    file: &ModelFile,
    context: &EffectContext<'_>,
) -> Vec<Vec<f64>> {
    let n = scene.joints;
    let mut terms = build_terms(file, context).unwrap();
    let mut out = vec![vec![0.0; piece.len()]; n];
    for k in 0..piece.len() {
        let at = |s: &[Vec<f64>]| -> Joints { std::array::from_fn(|j| s.get(j).map_or(0.0, |s| s[k])) };
        let (q, qd, qdd) = (at(&piece.q), at(&piece.qd), at(&piece.qdd));
        let mut rigid: Joints = Default::default();
        body.torque(&Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] }, pi, &mut rigid[..n])
            .unwrap();
        let direction: Joints = std::array::from_fn(|j| {
            let slow = file.friction.standstill_rad_s.get(j).copied().unwrap_or(0.0);
            if qd[j].abs() < slow { 0.0 } else { qd[j].signum() }
        });
        let of = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(0.0);
        let friction = &file.friction;
        let mut tau: Joints = std::array::from_fn(|j| {
            of(&friction.f_v, j) * qd[j] + of(&friction.f_c, j) * direction[j] + of(&friction.offset, j)
        });
        terms.add_torque(
            &TermInput {
                stamp_ns: ((piece.global_s + k as f64 / scene.rate_hz) * 1e9).round() as i64,
                q_rad: &q,
                qd_rad_s: &qd,
                qdd_rad_s2: &qdd,
                direction: &direction,
                ramp_rad_s: 0.01,
                tau_rigid_nm: &rigid,
                temperature_degc: &[f64::NAN; lacuna_interfaces::MAX_JOINTS],
            },
            &mut tau,
        );
        for j in 0..n {
            out[j][k] = piece.tau[j][k] - rigid[j] - tau[j];
        }
    }
    out
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn the_file_alone_gives_the_residual_after() {
    for (ids, seed) in [(&["viscous_power"][..], 31), (&["payload"], 32), (&["encoder_offset"], 33)] {
        let options = case(Kind::Delta, ids, seed, 0.02);
        let Outcome { findings, model, .. } = diagnose(&options, &mut |_, _| {}).unwrap();
        let stated = norm(&findings.held_out.after_rms_nm);
        let ours = norm(&residual_of(&options, &model));
        assert!((ours / stated - 1.0).abs() < 0.1, "{ids:?}: the file leaves {ours} Nm; the findings say {stated} Nm");
        // The fitted tolerances are part of it: without them the file leaves more.
        let mut bare = model.clone();
        bare.rigid_body.parameters.clear();
        let without = norm(&residual_of(&options, &bare));
        assert!(without > 1.2 * ours, "{ids:?}: without the fitted masses {without} Nm, with them {ours} Nm");
    }
}

#[test]
fn a_freely_fitted_file_does_not_fall_back_on_the_robot_files_masses() {
    let mut options = case(Kind::Serial, &[], 34, 0.0);
    // Masses that nobody would believe: the base is fitted freely.
    for link in &mut options.robot.link {
        link.mass *= 5.0;
        link.inertia.iter_mut().for_each(|v| *v *= 5.0);
        link.rotor_inertia *= 5.0;
    }
    let Outcome { findings, model, .. } = diagnose(&options, &mut |_, _| {}).unwrap();
    let body = lacuna_physics::build(&options.robot, None).unwrap();
    assert_eq!(model.rigid_body.parameters.len(), body.parameters().len(), "every parameter is stated");
    let (ours, stated) = (norm(&residual_of(&options, &model)), norm(&findings.held_out.after_rms_nm));
    assert!(ours < 1.15 * stated, "the file leaves {ours} Nm; the findings say {stated} Nm");
    let mut fallen_back = model.clone();
    fallen_back.rigid_body.parameters.clear();
    let other = norm(&residual_of(&options, &fallen_back));
    assert!(ours < 0.5 * other, "the file leaves {ours} Nm, the robot file's masses {other} Nm: {}", findings.verdict);
}

#[test]
fn the_radius_tolerance_is_a_delta_of_another_radius() {
    let options = case(Kind::Delta, &[], 35, 0.0);
    let scene = Scene::new(&options.robot, None, &options.recordings, &options.conditioning).unwrap();
    let radius = tolerance::all(&scene).into_iter().find(|t| t.name == "radius difference").unwrap();
    let nominal = scene.rigid_raw(scene.body.as_ref(), &scene.pi);
    let column = radius.raw(&scene, &nominal).unwrap();
    // The same by building robots of a slightly different radius.
    let share = 1e-5;
    let other = |by: f64| {
        let mut file = options.robot.clone();
        let g = file.geometry.as_mut().unwrap();
        g.ra = g.rb + (g.ra - g.rb) * (1.0 + by);
        let body = lacuna_physics::build(&file, None).unwrap();
        scene.rigid_raw(body.as_ref(), &body.nominal())
    };
    let (plus, minus) = (other(share), other(-share));
    let tolerance = options.robot.tolerance.length;
    let (mut error, mut size) = (0.0, 0.0);
    for ((c, p), m) in column.iter().flatten().zip(plus.iter().flatten()).zip(minus.iter().flatten()) {
        for ((c, p), m) in c.iter().zip(p).zip(m) {
            let d = (p - m) / (2.0 * share) * tolerance;
            error += (c - d) * (c - d);
            size += d * d;
        }
    }
    assert!(size > 0.0 && (error / size).sqrt() < 1e-3, "{}", (error / size).sqrt());
}
