//! Masses, geometry, gravity and springs of the structure.

use super::{Class, Effect, MUST, Scope, Values, World, parameter, params};
use crate::plant::robot::JointTorque;
use crate::plant::{Delta, Mechanism};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Kind;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::TAU;

fn delta<'a>(v: &Values<'_>, w: &'a mut World<'_>) -> Result<&'a mut Delta, BadInput> {
    match &mut w.truth.mechanism {
        Mechanism::Delta(d) => Ok(d),
        Mechanism::Serial(_) => {
            Err(BadInput::new(format!("{}: found a serial robot; expected kind \"delta\"", v.effect.id)))
        }
    }
}

fn arm_inertia(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let (di, dm) = (v.get("dI"), v.get("dm"));
    for &i in &v.joints {
        match &mut w.truth.mechanism {
            Mechanism::Delta(d) => {
                d.arm[i].inertia += di;
                d.arm[i].moment_along += dm;
            }
            Mechanism::Serial(chain) => {
                let Some(link) = chain.links.get_mut(i) else { continue };
                let body = &mut link.body;
                if body.mass <= 0.0 {
                    return Err(BadInput::new(format!("arm_inertia: link {} has no mass to shift", i + 1)));
                }
                // Along the direction from the axis to the centre of mass, or any square to the axis.
                let radial = body.com - link.axis * link.axis.dot(&body.com);
                let side = if link.axis.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
                let direction =
                    if radial.norm() > 1e-6 { radial.normalize() } else { link.axis.cross(&side).normalize() };
                body.com += direction * (dm / body.mass);
                // About the axis alone, as far as a body can: square to it grow the two others by half.
                let along = link.axis * link.axis.transpose();
                body.inertia += along * di + (Matrix3::identity() - along) * (0.5 * di);
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
                let ratio = 1.0 + v.get("dl1") / arm.length;
                arm.length *= ratio;
                // A longer arm of the same mass: a uniform rod's moments follow its length.
                arm.moment_along *= ratio;
                arm.inertia *= ratio * ratio;
                let rod = &mut d.forearm[i];
                let ratio = 1.0 + v.get("dl2") / rod.length;
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
                at.translation.vector *= 1.0 + v.get("dl") / length;
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
        law: "added inertia dI of the link about its joint, first moment shifted by dm",
        parameters: &[parameter("dI", "kg m²", MUST, -1e4, 1e4), parameter("dm", "kg m", 0.0, -1e4, 1e4)],
        draw: |r, s, i| {
            params(&[
                ("dI", r.uniform(0.08, 0.25) * s.inertia[i]),
                ("dm", r.sign() * r.uniform(0.03, 0.08) * s.torque[i] / 9.81),
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
        law: "forearms are rods of mass m_f = mass × nominal, centre of mass ξ, inertia share × m_f l2², not points at their ends",
        parameters: &[
            parameter("mass", "1", 1.0, 0.01, 20.0),
            parameter("xi", "1", 0.5, 0.0, 1.0),
            parameter("share", "1", 1.0 / 12.0, 0.0, 0.25),
        ],
        draw: |r, _, _| params(&[("mass", r.uniform(1.0, 1.3)), ("xi", r.uniform(0.42, 0.55)), ("share", 1.0 / 12.0)]),
        apply: |v, w| {
            let (mass, centre, share) = (v.get("mass"), v.get("xi"), v.get("share"));
            for rod in &mut delta(v, w)?.forearm {
                rod.mass *= mass;
                rod.centre = centre;
                rod.inertia = share * rod.mass * rod.length * rod.length;
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
        law: "real lengths differ: dl1 and dl2 of a Delta's arm and forearm, dl of a serial link",
        parameters: &[
            parameter("dl1", "m", 0.0, -0.2, 0.2),
            parameter("dl2", "m", 0.0, -0.2, 0.2),
            parameter("dl", "m", 0.0, -0.2, 0.2),
        ],
        draw: |r, s, _| {
            let d = r.sign() * r.uniform(0.02, 0.05) * s.reach;
            if r.unit() < 0.5 { params(&[("dl1", d), ("dl", d)]) } else { params(&[("dl2", 2.0 * d), ("dl", d)]) }
        },
        apply: link_length,
    },
    Effect {
        id: "base_tilt",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "the base is turned about its x and y axes",
        parameters: &[parameter("tilt_x", "rad", MUST, -1.6, 1.6), parameter("tilt_y", "rad", MUST, -1.6, 1.6)],
        draw: |r, _, _| {
            let (sin, cos) = (TAU * r.unit()).sin_cos();
            let tilt = r.uniform(0.025, 0.08);
            params(&[("tilt_x", tilt * cos), ("tilt_y", tilt * sin)])
        },
        apply: |v, w| {
            // Gravity as the tilted base sees it.
            let base = Rotation3::from_scaled_axis(Vector3::new(v.get("tilt_x"), v.get("tilt_y"), 0.0));
            w.truth.gravity = base.inverse() * w.truth.gravity;
            Ok(())
        },
    },
    Effect {
        id: "gravity_spring",
        class: Class::Catalogue,
        also_accept: &["arm_inertia"],
        scope: Scope::Joint,
        kind: None,
        law: "A sin(θ − θ0) on the link",
        parameters: &[parameter("A", "Nm", MUST, -1e5, 1e5), parameter("theta0", "rad", 0.0, -10.0, 10.0)],
        draw: |r, s, i| params(&[("A", r.uniform(0.06, 0.2) * s.torque[i]), ("theta0", r.uniform(-0.8, 0.8))]),
        apply: |v, w| {
            for &i in &v.joints {
                let law = JointTorque::GravitySpring { amplitude: v.get("A"), centre: v.get("theta0") };
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
        law: "k1 Δ + k3 Δ³, Δ = θ − θ_c, on the link",
        parameters: &[
            parameter("k1", "Nm/rad", MUST, -1e5, 1e5),
            parameter("k3", "Nm/rad³", 0.0, -1e5, 1e5),
            parameter("theta_c", "rad", 0.0, -10.0, 10.0),
        ],
        draw: |r, s, i| {
            params(&[
                ("k1", r.uniform(0.03, 0.1) * s.torque[i]),
                ("k3", r.uniform(0.03, 0.15) * s.torque[i]),
                ("theta_c", r.uniform(0.3, 0.6) * (s.limits.q_max[i] + s.limits.q_min[i])),
            ])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = JointTorque::Cable { linear: v.get("k1"), cubic: v.get("k3"), centre: v.get("theta_c") };
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
        parameters: &[parameter("moment", "Nm", MUST, 0.0, 1e3), parameter("viscous", "Nm s/rad", 0.0, 0.0, 1e3)],
        draw: |r, s, i| {
            params(&[("moment", r.uniform(0.01, 0.04) * s.torque[i]), ("viscous", r.uniform(0.0, 0.003) * s.torque[i])])
        },
        apply: |v, w| {
            let (coulomb, viscous) = (v.get("moment"), v.get("viscous"));
            let ball = &mut delta(v, w)?.ball;
            ball.coulomb += coulomb;
            ball.viscous += viscous;
            Ok(())
        },
    },
];
