//! Masses, geometry, gravity and springs of the structure.

use super::{Class, Effect, MUST, Scope, Values, World, parameter, params};
use crate::plant::robot::JointTorque;
use crate::plant::{Delta, Mechanism};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Kind;
use nalgebra::{Isometry3, Rotation3, Vector3};
use std::f64::consts::TAU;

fn delta<'a>(v: &Values<'_>, w: &'a mut World<'_>) -> Result<&'a mut Delta, BadInput> {
    match &mut w.truth.mechanism {
        Mechanism::Delta(d) => Ok(d),
        Mechanism::Serial(_) => {
            Err(BadInput::new(format!("{}: found a serial robot; expected kind \"delta\"", v.effect.id)))
        }
    }
}

/// Inertia about the joint's axis, and first moments along two directions square to it: on a Delta along and
/// across the upper arm; on a chain across the axis, the first least along the other coordinate axes.
fn arm_inertia(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let (inertia, first, second) = (v.get("I"), v.get("m_1"), v.get("m_2"));
    for &i in &v.joints {
        match &mut w.truth.mechanism {
            Mechanism::Delta(d) => {
                d.arm[i].inertia += inertia;
                d.arm[i].moment_along += first;
                d.arm[i].moment_across += second;
            }
            Mechanism::Serial(chain) => {
                let Some(link) = chain.links.get_mut(i) else { continue };
                if link.prismatic {
                    return Err(BadInput::new(format!("arm_inertia: joint {} slides; expected one that turns", i + 1)));
                }
                let axis = link.axis;
                let least = [Vector3::x(), Vector3::y(), Vector3::z()][axis.iamin()];
                let across = (least - axis * axis.dot(&least)).normalize();
                link.body.inertia += axis * axis.transpose() * inertia;
                link.body.moment += across * first + axis.cross(&across) * second;
            }
        }
    }
    Ok(())
}

fn link_length(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    for &i in &v.joints {
        match &mut w.truth.mechanism {
            Mechanism::Delta(d) => {
                let arm = &mut d.arm[i];
                let ratio = 1.0 + v.get("dl") / arm.length;
                arm.length *= ratio;
                // A longer arm of the same mass: a uniform rod's moments follow its length.
                arm.moment_along *= ratio;
                arm.inertia *= ratio * ratio;
                let rod = &mut d.forearm[i];
                let ratio = 1.0 + v.get("dl_2") / rod.length;
                rod.length *= ratio;
                rod.inertia *= ratio * ratio;
            }
            Mechanism::Serial(chain) => {
                let at = match chain.links.get_mut(i + 1) {
                    Some(next) => &mut next.place,
                    None => &mut chain.tip,
                };
                let length = at.translation.vector.norm();
                if length < 1e-6 {
                    return Err(BadInput::new(format!("link_length: link {} has no length to change", i + 1)));
                }
                let longer = at.translation.vector * (v.get("dl") / length);
                at.translation.vector += longer;
                // A body described in the frame at its link's end moves with that end.
                if chain.described_in.get(i).is_some_and(|f| f.translation.vector.norm() > 0.0)
                    && let Some(link) = chain.links.get_mut(i)
                {
                    link.body = link.body.placed(&Isometry3::translation(longer.x, longer.y, longer.z));
                }
            }
        }
    }
    Ok(())
}

/// Effects of the structure.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "arm_inertia",
        class: Class::Catalogue,
        also_accept: &["rotor_inertia"],
        scope: Scope::Joint,
        kind: None,
        law: "added inertia I about the joint, first moments m_1 along and m_2 across the arm",
        parameters: &[
            parameter("I", "kg m²", 0.0, -1e4, 1e4),
            parameter("m_1", "kg m", 0.0, -1e4, 1e4),
            parameter("m_2", "kg m", 0.0, -1e4, 1e4),
        ],
        draw: |r, s, i| {
            params(&[
                ("I", r.uniform(0.08, 0.25) * s.inertia[i]),
                ("m_1", r.sign() * r.uniform(0.03, 0.08) * s.torque[i] / 9.81),
            ])
        },
        apply: arm_inertia,
    },
    Effect {
        id: "forearm_rod",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: Some(Kind::Delta),
        law: "forearms of mass m_f + dm with m_f ξ = m2 + ds_1 and m_f ξ² + I_f/l2² = m2 + ds_2: rods, not points at their ends",
        parameters: &[
            parameter("ds_1", "kg", 0.0, -100.0, 100.0),
            parameter("ds_2", "kg", 0.0, -100.0, 100.0),
            parameter("dm", "kg", 0.0, -100.0, 100.0),
        ],
        draw: |r, s, _| {
            // A uniform rod with a heavier end: ξ about the middle, I_f a twelfth.
            let (m2, xi) = (s.forearm_point, r.uniform(0.42, 0.55));
            let dm = 2.0 * m2 * r.uniform(0.0, 0.3);
            let mass = 2.0 * m2 + dm;
            params(&[("ds_1", mass * xi - m2), ("ds_2", mass * (xi * xi + 1.0 / 12.0) - m2), ("dm", dm)])
        },
        apply: |v, w| {
            let (ds_1, ds_2, dm) = (v.get("ds_1"), v.get("ds_2"), v.get("dm"));
            for rod in &mut delta(v, w)?.forearm {
                let l2 = rod.length * rod.length;
                let s_1 = rod.mass * rod.centre + ds_1;
                let s_2 = rod.mass * rod.centre * rod.centre + rod.inertia / l2 + ds_2;
                rod.mass += dm;
                rod.centre = s_1 / rod.mass;
                rod.inertia = (s_2 - s_1 * rod.centre) * l2;
                if !rod.mass.is_finite() || rod.mass <= 0.0 || rod.inertia < 0.0 {
                    return Err(BadInput::new(format!(
                        "forearm_rod: comes to a mass of {} kg and an inertia of {} kg m²; expected a rod that can exist",
                        rod.mass, rod.inertia
                    )));
                }
            }
            Ok(())
        },
    },
    Effect {
        id: "link_length",
        class: Class::Catalogue,
        also_accept: &["encoder_offset"],
        scope: Scope::Joint,
        kind: None,
        law: "real lengths: dl longer upper arm or link, dl_2 longer forearm of a Delta",
        parameters: &[parameter("dl", "m", 0.0, -0.2, 0.2), parameter("dl_2", "m", 0.0, -0.2, 0.2)],
        draw: |r, s, _| {
            let d = r.sign() * r.uniform(0.02, 0.05) * s.reach;
            // Chains have no forearms.
            if s.forearm_point > 0.0 && r.unit() < 0.5 { params(&[("dl_2", 2.0 * d)]) } else { params(&[("dl", d)]) }
        },
        apply: link_length,
    },
    Effect {
        id: "base_tilt",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "gravity leans by tilt_1 and tilt_2 towards the two base axes least along it (x and y if level)",
        parameters: &[parameter("tilt_1", "rad", 0.0, -1.6, 1.6), parameter("tilt_2", "rad", 0.0, -1.6, 1.6)],
        draw: |r, _, _| {
            let (sin, cos) = (TAU * r.unit()).sin_cos();
            let tilt = r.uniform(0.025, 0.08);
            params(&[("tilt_1", tilt * cos), ("tilt_2", tilt * sin)])
        },
        apply: |v, w| {
            let g = w.truth.gravity;
            let Some(down) = g.try_normalize(1e-9) else {
                return Err(BadInput::new(
                    "base_tilt: found a robot without gravity; expected env.gravity of some size",
                ));
            };
            let mut axes = [Vector3::x(), Vector3::y(), Vector3::z()].to_vec();
            axes.remove(down.iamax());
            let first = (axes[0] - down * down.dot(&axes[0])).normalize();
            let second = axes[1] - down * down.dot(&axes[1]);
            let second = (second - first * first.dot(&second)).normalize();
            // Turning about down × u leans gravity towards u.
            let turn = down.cross(&first) * v.get("tilt_1") + down.cross(&second) * v.get("tilt_2");
            w.truth.gravity = Rotation3::from_scaled_axis(turn) * g;
            Ok(())
        },
    },
    Effect {
        id: "gravity_spring",
        class: Class::Catalogue,
        also_accept: &["arm_inertia"],
        scope: Scope::Joint,
        kind: None,
        law: "a_s sin θ + a_c cos θ on the link",
        parameters: &[parameter("a_s", "Nm", 0.0, -1e5, 1e5), parameter("a_c", "Nm", 0.0, -1e5, 1e5)],
        draw: |r, s, i| {
            let a = r.uniform(0.06, 0.2) * s.torque[i];
            let (sin, cos) = (TAU * r.unit()).sin_cos();
            params(&[("a_s", a * cos), ("a_c", a * sin)])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = JointTorque::GravitySpring { sine: v.get("a_s"), cosine: v.get("a_c") };
                w.truth.joints[i].torque.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "cable_spring",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "k_1 Δ + k_3 Δ³, Δ = θ − q_0, on the link",
        parameters: &[
            parameter("k_1", "Nm/rad", MUST, -1e5, 1e5),
            parameter("k_3", "Nm/rad³", 0.0, -1e5, 1e5),
            parameter("q_0", "rad", 0.0, -10.0, 10.0),
        ],
        draw: |r, s, i| {
            params(&[
                ("k_1", r.uniform(0.03, 0.1) * s.torque[i]),
                ("k_3", r.uniform(0.03, 0.15) * s.torque[i]),
                ("q_0", r.uniform(0.3, 0.6) * (s.limits.q_max[i] + s.limits.q_min[i])),
            ])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = JointTorque::Cable { linear: v.get("k_1"), cubic: v.get("k_3"), centre: v.get("q_0") };
                w.truth.joints[i].torque.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "ball_friction",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: Some(Kind::Delta),
        law: "Coulomb moment and viscous friction in the ball joints at both ends of every forearm",
        parameters: &[parameter("mu", "Nm", 0.0, 0.0, 1e3), parameter("b", "Nm s/rad", 0.0, 0.0, 1e3)],
        draw: |r, s, i| {
            params(&[("mu", r.uniform(0.01, 0.04) * s.torque[i]), ("b", r.uniform(0.0, 0.003) * s.torque[i])])
        },
        apply: |v, w| {
            let (coulomb, viscous) = (v.get("mu"), v.get("b"));
            let ball = &mut delta(v, w)?.ball;
            ball.coulomb += coulomb;
            ball.viscous += viscous;
            Ok(())
        },
    },
];
