//! Drives, transmissions and sensors.

use super::{Class, Effect, MUST, Scope, Values, World, parameter, params};
use crate::plant::robot::{Coupling, JointTorque, Saturation, Transmission};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Kind;
use std::f64::consts::TAU;

/// A spring between motor and link needs a rotor with inertia of its own.
fn spring(v: &Values<'_>, w: &mut World<'_>, half_gap: f64) -> Result<(), BadInput> {
    for &i in &v.joints {
        let inertia = w.scales.inertia[i];
        let joint = &mut w.truth.joints[i];
        if joint.rotor <= 0.002 * inertia {
            return Err(BadInput::new(format!(
                "{}: joint {} has a rotor inertia of {} kg m²; a transmission needs one, expected rotor_inertia above {:.1e}",
                v.effect.id,
                i + 1,
                joint.rotor,
                0.002 * inertia
            )));
        }
        if joint.transmission.is_some() {
            return Err(BadInput::new(format!("{}: joint {} has a spring already", v.effect.id, i + 1)));
        }
        let stiffness = v.get("k");
        let damping = 2.0 * v.get("zeta") * (stiffness * joint.rotor).sqrt();
        joint.transmission = Some(Transmission { stiffness, damping, half_gap });
    }
    Ok(())
}

/// Drive effects.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "torque_offset",
        class: Class::Catalogue,
        also_accept: &["coulomb_asym"],
        scope: Scope::Joint,
        kind: None,
        law: "constant torque",
        parameters: &[parameter("c", "Nm", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("c", r.sign() * r.uniform(0.03, 0.1) * s.torque[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].torque.push(JointTorque::Offset(v.get("c")));
            }
            Ok(())
        },
    },
    Effect {
        id: "cogging",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "a1 sin(h1 N θ + φ1) + a2 sin(h2 N θ + φ2), N the gear ratio, orders h per motor revolution",
        parameters: &[
            parameter("a1", "Nm", MUST, 0.0, 1e4),
            parameter("h1", "1", MUST, 0.01, 1e3),
            parameter("phi1", "rad", 0.0, -10.0, 10.0),
            parameter("a2", "Nm", 0.0, 0.0, 1e4),
            parameter("h2", "1", 2.0, 0.01, 1e3),
            parameter("phi2", "rad", 0.0, -10.0, 10.0),
        ],
        draw: |r, s, i| {
            let h = [1.0, 2.0][r.index(2)];
            params(&[
                ("a1", r.uniform(0.015, 0.05) * s.torque[i]),
                ("h1", h),
                ("phi1", TAU * r.unit()),
                ("a2", r.uniform(0.0, 0.02) * s.torque[i]),
                ("h2", 2.0 * h),
                ("phi2", TAU * r.unit()),
            ])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let joint = &mut w.truth.joints[i];
                for [a, h, phi] in [["a1", "h1", "phi1"], ["a2", "h2", "phi2"]] {
                    let (amplitude, order) = (v.get(a), v.get(h) * joint.gear.abs());
                    if amplitude > 0.0 {
                        joint.torque.push(JointTorque::Ripple { amplitude, order, phase: v.get(phi) });
                    }
                }
            }
            Ok(())
        },
    },
    Effect {
        id: "elasticity",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "spring k between motor and link",
        parameters: &[parameter("k", "Nm/rad", MUST, 1.0, 1e8), parameter("zeta", "1", 0.05, 0.0, 1.0)],
        draw: |r, s, i| params(&[("k", r.log_uniform(50.0, 400.0) * s.torque[i]), ("zeta", r.uniform(0.03, 0.1))]),
        apply: |v, w| spring(v, w, 0.0),
    },
    Effect {
        id: "backlash",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "half gap between motor and link, flanks of stiffness k",
        parameters: &[
            parameter("half_gap", "rad", MUST, 1e-5, 0.2),
            parameter("k", "Nm/rad", MUST, 1.0, 1e8),
            parameter("zeta", "1", 0.1, 0.0, 1.0),
        ],
        draw: |r, s, i| {
            params(&[
                ("half_gap", r.log_uniform(1e-3, 6e-3)),
                ("k", r.log_uniform(400.0, 1000.0) * s.torque[i]),
                ("zeta", r.uniform(0.08, 0.2)),
            ])
        },
        apply: |v, w| spring(v, w, v.get("half_gap")),
    },
    Effect {
        id: "rotor_inertia",
        class: Class::Catalogue,
        also_accept: &["arm_inertia"],
        scope: Scope::Joint,
        kind: None,
        law: "J θ̈",
        parameters: &[parameter("J", "kg m²", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("J", r.uniform(0.08, 0.3) * s.inertia[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                let joint = &mut w.truth.joints[i];
                joint.rotor += v.get("J");
                if joint.rotor < 0.0 {
                    return Err(BadInput::new(format!(
                        "rotor_inertia: joint {} comes to {} kg m²; expected zero or more",
                        i + 1,
                        joint.rotor
                    )));
                }
            }
            Ok(())
        },
    },
    Effect {
        id: "axis_coupling",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Pair,
        kind: Some(Kind::Serial),
        law: "the second joint's motor turns by θ₂ + ratio θ₁: its inertia and friction are felt on both",
        parameters: &[
            parameter("ratio", "1", 1.0, -10.0, 10.0),
            parameter("J", "kg m²", MUST, 0.0, 1e4),
            parameter("f_v", "Nm s/rad", 0.0, 0.0, 1e4),
            parameter("f_c", "Nm", 0.0, 0.0, 1e4),
        ],
        draw: |r, s, i| {
            params(&[
                ("ratio", r.sign()),
                ("J", r.uniform(0.1, 0.3) * s.inertia[i + 1]),
                ("f_v", r.uniform(0.1, 0.3) * s.torque[i + 1] / s.limits.qd_max[i + 1]),
                ("f_c", r.uniform(0.05, 0.2) * s.torque[i + 1]),
            ])
        },
        apply: |v, w| {
            let [felt, motor] = v.joints[..] else { return Ok(()) };
            let inertia = v.get("J");
            if [felt, motor].iter().any(|&i| w.truth.joints[i].transmission.is_some()) {
                return Err(BadInput::new("axis_coupling: found a joint with a spring; expected rigid joints"));
            }
            // The motor's inertia is moved to where it truly sits, as far as the file knows it.
            let rotor = &mut w.truth.joints[motor].rotor;
            *rotor -= rotor.min(inertia);
            let (viscous, coulomb) = (v.get("f_v"), v.get("f_c"));
            w.truth.couplings.push(Coupling { motor, felt, ratio: v.get("ratio"), inertia, viscous, coulomb });
            Ok(())
        },
    },
    Effect {
        id: "kt_scale",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "real over nominal torque constant",
        parameters: &[parameter("scale", "1", MUST, 0.2, 5.0)],
        draw: |r, _, _| params(&[("scale", 1.0 + r.sign() * r.uniform(0.06, 0.15))]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].torque_constant *= v.get("scale");
            }
            Ok(())
        },
    },
    Effect {
        id: "torque_saturation",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "torque constant 1 − drop (|u|/knee − 1) above the knee",
        parameters: &[parameter("knee", "Nm", MUST, 1e-6, 1e6), parameter("drop", "1", MUST, 0.0, 0.9)],
        draw: |r, s, i| params(&[("knee", r.uniform(0.5, 0.9) * s.torque[i]), ("drop", r.uniform(0.08, 0.2))]),
        apply: |v, w| {
            for &i in &v.joints {
                let drop = v.get("drop");
                w.truth.joints[i].saturation = (drop > 0.0).then_some(Saturation { knee: v.get("knee"), drop });
            }
            Ok(())
        },
    },
    Effect {
        id: "torque_delay",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "logged τ(t) is the executed torque of t − delay",
        parameters: &[parameter("delay", "s", MUST, -1e-3, 0.05)],
        draw: |r, _, _| params(&[("delay", r.uniform(3e-4, 1.5e-3))]),
        apply: |v, w| {
            w.truth.torque_delay += v.get("delay");
            Ok(())
        },
    },
    Effect {
        id: "encoder_offset",
        class: Class::Catalogue,
        also_accept: &["link_length"],
        scope: Scope::Joint,
        kind: None,
        law: "reading = angle + offset",
        parameters: &[parameter("offset", "rad", MUST, -0.5, 0.5)],
        draw: |r, _, _| params(&[("offset", r.sign() * r.uniform(0.006, 0.025))]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].encoder_offset += v.get("offset");
            }
            Ok(())
        },
    },
];
