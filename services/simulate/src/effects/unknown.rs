//! Effects that no catalogue lists.

use super::{Class, Effect, MUST, Scope, parameter, params};
use crate::plant::friction::{Bristle, Dent, Eddy, Hysteresis, Rubbing};
use crate::plant::robot::{CrossRipple, Shake};
use std::f64::consts::TAU;

/// Unknown effects.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "dent",
        class: Class::Unknown,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "friction level raised by height · exp(−((θ − at)/width)²)",
        parameters: &[
            parameter("height", "Nm", MUST, 0.0, 1e4),
            parameter("at", "rad", MUST, -100.0, 100.0),
            parameter("width", "rad", MUST, 1e-3, 10.0),
        ],
        draw: |r, s, i| {
            let (low, high) = (s.limits.q_min[i], s.limits.q_max[i]);
            params(&[
                ("height", r.uniform(0.2, 0.45) * s.torque[i]),
                ("at", low + (high - low) * r.uniform(0.35, 0.65)),
                ("width", r.uniform(0.03, 0.08) * (high - low)),
            ])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let dent = Dent { at: v.get("at"), width: v.get("width"), height: v.get("height") };
                w.truth.joints[i].friction.dent.push(dent);
            }
            Ok(())
        },
    },
    Effect {
        id: "rubbing",
        class: Class::Unknown,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "friction level raised while a slow cycle is in its duty",
        parameters: &[
            parameter("level", "Nm", MUST, 0.0, 1e4),
            parameter("period", "s", MUST, 0.01, 1e4),
            parameter("duty", "1", 0.4, 0.0, 1.0),
            parameter("phase", "s", 0.0, -1e4, 1e4),
        ],
        draw: |r, s, i| {
            let period = r.uniform(1.0, 3.0);
            params(&[
                ("level", r.uniform(0.08, 0.2) * s.torque[i]),
                ("period", period),
                ("duty", r.uniform(0.25, 0.5)),
                ("phase", period * r.unit()),
            ])
        },
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].friction.rubbing.push(Rubbing {
                    level: v.get("level"),
                    period: v.get("period"),
                    duty: v.get("duty"),
                    phase: v.get("phase"),
                });
            }
            Ok(())
        },
    },
    Effect {
        id: "eddy_brake",
        class: Class::Unknown,
        also_accept: &["viscous_power"],
        scope: Scope::Joint,
        kind: None,
        law: "2 T v v_c / (v² + v_c²): magnetic drag with a peak",
        parameters: &[parameter("peak", "Nm", MUST, 0.0, 1e4), parameter("v_c", "rad/s", MUST, 1e-3, 1e3)],
        draw: |r, s, i| {
            params(&[("peak", r.uniform(0.06, 0.18) * s.torque[i]), ("v_c", r.uniform(0.1, 0.3) * s.limits.qd_max[i])])
        },
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].friction.eddy.push(Eddy { peak: v.get("peak"), speed: v.get("v_c") });
            }
            Ok(())
        },
    },
    Effect {
        id: "hysteretic_cable",
        class: Class::Unknown,
        also_accept: &["presliding"],
        scope: Scope::Joint,
        kind: None,
        law: "a Dahl bristle of long travel beside the joint's friction",
        parameters: &[parameter("limit", "Nm", MUST, 0.0, 1e4), parameter("travel", "rad", MUST, 1e-3, 10.0)],
        draw: |r, s, i| params(&[("limit", r.uniform(0.06, 0.18) * s.torque[i]), ("travel", r.uniform(0.15, 0.5))]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i]
                    .friction
                    .hysteresis
                    .push(Hysteresis { limit: v.get("limit"), bristle: Bristle::Dahl { travel: v.get("travel") } });
            }
            Ok(())
        },
    },
    Effect {
        id: "cross_ripple",
        class: Class::Unknown,
        also_accept: &[],
        scope: Scope::Pair,
        kind: None,
        law: "amplitude · sin(w1 θ₁ + w2 θ₂ + φ) on the first joint, and its potential's share on the second",
        parameters: &[
            parameter("amplitude", "Nm", MUST, 0.0, 1e4),
            parameter("w1", "1/rad", MUST, 0.1, 200.0),
            parameter("w2", "1/rad", MUST, -200.0, 200.0),
            parameter("phi", "rad", 0.0, -10.0, 10.0),
        ],
        draw: |r, s, i| {
            let w1 = r.uniform(3.0, 9.0);
            params(&[
                ("amplitude", r.uniform(0.06, 0.15) * s.torque[i]),
                ("w1", w1),
                ("w2", r.sign() * w1 * r.uniform(0.6, 1.4)),
                ("phi", TAU * r.unit()),
            ])
        },
        apply: |v, w| {
            let [first, second] = v.joints[..] else { return Ok(()) };
            w.truth.cross_ripples.push(CrossRipple {
                joints: [first, second],
                waves: [v.get("w1"), v.get("w2")],
                amplitude: v.get("amplitude"),
                phase: v.get("phi"),
            });
            Ok(())
        },
    },
    Effect {
        id: "base_shake",
        class: Class::Unknown,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "the base shakes sideways with acceleration amplitude · sin(2π f t)",
        parameters: &[
            parameter("amplitude", "m/s²", MUST, 0.0, 1e3),
            parameter("frequency", "Hz", MUST, 0.01, 500.0),
            parameter("direction", "rad", 0.0, -10.0, 10.0),
        ],
        draw: |r, s, _| {
            let gravity_share = r.uniform(0.05, 0.15) * s.torque[0] / (s.inertia[0] / s.reach);
            params(&[("amplitude", gravity_share), ("frequency", r.uniform(4.0, 12.0)), ("direction", TAU * r.unit())])
        },
        apply: |v, w| {
            w.truth.shake.push(Shake {
                amplitude: v.get("amplitude"),
                frequency: v.get("frequency"),
                direction: v.get("direction"),
            });
            Ok(())
        },
    },
];
