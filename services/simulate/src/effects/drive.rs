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
        let damping = 2.0 * v.get("zeta") * (stiffness * (inertia - w.scales.rotor[i])).max(0.0).sqrt();
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
        parameters: &[parameter("tau_0", "Nm", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("tau_0", r.sign() * r.uniform(0.03, 0.1) * s.torque[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].torque.push(JointTorque::Offset(v.get("tau_0")));
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
        law: "a_s sin(h N θ) + a_c cos(h N θ), N the gear ratio, h the order per motor revolution; a_s2, a_c2 at 2 h",
        parameters: &[
            parameter("a_s", "Nm", 0.0, -1e4, 1e4),
            parameter("a_c", "Nm", 0.0, -1e4, 1e4),
            parameter("h", "1/rev", MUST, 0.01, 1e3),
            parameter("a_s2", "Nm", 0.0, -1e4, 1e4),
            parameter("a_c2", "Nm", 0.0, -1e4, 1e4),
        ],
        draw: |r, s, i| {
            let (sin, cos) = (TAU * r.unit()).sin_cos();
            let (sin2, cos2) = (TAU * r.unit()).sin_cos();
            let a = r.uniform(0.02, 0.05) * s.torque[i];
            let a2 = if r.unit() < 0.5 { 0.0 } else { r.uniform(0.01, 0.02) * s.torque[i] };
            let h = [1.0, 2.0][r.index(2)];
            params(&[("a_s", a * sin), ("a_c", a * cos), ("h", h), ("a_s2", a2 * sin2), ("a_c2", a2 * cos2)])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let joint = &mut w.truth.joints[i];
                for (s, c, multiple) in [("a_s", "a_c", 1.0), ("a_s2", "a_c2", 2.0)] {
                    let (sine, cosine) = (v.get(s), v.get(c));
                    if sine != 0.0 || cosine != 0.0 {
                        let order = multiple * v.get("h") * joint.gear;
                        joint.torque.push(JointTorque::Ripple { sine, cosine, order });
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
        law: "half gap b between motor and link, flanks of stiffness k",
        parameters: &[
            parameter("b", "rad", MUST, 1e-5, 0.2),
            parameter("k", "Nm/rad", MUST, 1.0, 1e8),
            parameter("zeta", "1", 0.1, 0.0, 1.0),
        ],
        draw: |r, s, i| {
            params(&[
                ("b", r.log_uniform(1e-3, 6e-3)),
                ("k", r.log_uniform(400.0, 1000.0) * s.torque[i]),
                ("zeta", r.uniform(0.08, 0.2)),
            ])
        },
        apply: |v, w| spring(v, w, v.get("b")),
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
        law: "the second joint's motor turns by θ₂ + ρ θ₁: its inertia and friction are felt on both",
        parameters: &[
            parameter("rho", "1", 1.0, -10.0, 10.0),
            parameter("J", "kg m²", MUST, 0.0, 1e4),
            parameter("f_v", "Nm s/rad", 0.0, 0.0, 1e4),
            parameter("f_c", "Nm", 0.0, 0.0, 1e4),
        ],
        draw: |r, s, i| {
            params(&[
                ("rho", r.sign()),
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
            w.truth.couplings.push(Coupling { motor, felt, ratio: v.get("rho"), inertia, viscous, coulomb });
            Ok(())
        },
    },
    Effect {
        id: "kt_scale",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "reported torque = (1 + g) true torque",
        parameters: &[parameter("g", "1", MUST, -0.8, 10.0)],
        draw: |r, _, _| params(&[("g", r.sign() * r.uniform(0.06, 0.15))]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].torque_constant /= 1.0 + v.get("g");
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
        law: "reported τ (1 + a ((|τ| − τ_k)/τ_k)^p) above the knee τ_k",
        parameters: &[
            parameter("a", "1", MUST, 0.0, 20.0),
            parameter("tau_k", "Nm", MUST, 1e-6, 1e6),
            parameter("p", "1", 1.0, 0.5, 4.0),
        ],
        draw: |r, s, i| {
            let p = if r.unit() < 0.5 { 1.0 } else { 2.0 };
            params(&[("a", r.uniform(0.08, 0.3)), ("tau_k", r.uniform(0.35, 0.7) * s.torque[i]), ("p", p)])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = Saturation { knee: v.get("tau_k"), strength: v.get("a"), order: v.get("p") };
                w.truth.joints[i].saturation = Some(law);
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
        law: "logged τ(t) is the executed torque of t − D",
        parameters: &[parameter("D", "s", MUST, -1e-3, 0.05)],
        draw: |r, _, _| params(&[("D", r.uniform(5e-4, 2e-3))]),
        apply: |v, w| {
            w.truth.torque_delay += v.get("D");
            Ok(())
        },
    },
    Effect {
        id: "encoder_offset",
        class: Class::Catalogue,
        also_accept: &["link_length"],
        scope: Scope::Joint,
        kind: None,
        law: "true angle = reading + q_0",
        parameters: &[parameter("q_0", "rad", MUST, -0.5, 0.5)],
        draw: |r, _, _| params(&[("q_0", r.sign() * r.uniform(0.01, 0.03))]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].encoder_offset -= v.get("q_0");
            }
            Ok(())
        },
    },
];
