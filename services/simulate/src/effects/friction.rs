//! Friction beyond Coulomb and viscous.

use super::{Class, Effect, MUST, Scope, parameter, params};
use crate::plant::friction::{Bristle, LoadFriction, Power, Stribeck, Thermal};

/// Friction effects.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "coulomb",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "f_c sgn θ̇ on top of the base friction",
        parameters: &[parameter("f_c", "Nm", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("f_c", r.uniform(0.05, 0.15) * s.torque[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                let f = &mut w.truth.joints[i].friction;
                f.coulomb_positive += v.get("f_c");
                f.coulomb_negative += v.get("f_c");
            }
            Ok(())
        },
    },
    Effect {
        id: "viscous",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "f_v θ̇ on top of the base friction",
        parameters: &[parameter("f_v", "Nm s/rad", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("f_v", r.uniform(0.1, 0.3) * s.torque[i] / s.limits.qd_max[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                w.truth.joints[i].friction.viscous += v.get("f_v");
            }
            Ok(())
        },
    },
    Effect {
        id: "coulomb_asym",
        class: Class::Catalogue,
        also_accept: &["torque_offset"],
        scope: Scope::Joint,
        kind: None,
        law: "f_c⁺ = f_c + a_c, f_c⁻ = f_c − a_c",
        parameters: &[parameter("a_c", "Nm", MUST, -1e4, 1e4)],
        draw: |r, s, i| params(&[("a_c", r.sign() * r.uniform(0.02, 0.06) * s.torque[i])]),
        apply: |v, w| {
            for &i in &v.joints {
                let f = &mut w.truth.joints[i].friction;
                // What one direction cannot lose below zero, the other gains: the difference stays 2 a_c.
                let d = v.get("a_c");
                let short = (d.abs() - f.coulomb_positive.min(f.coulomb_negative)).max(0.0);
                f.coulomb_positive += short + d;
                f.coulomb_negative += short - d;
            }
            Ok(())
        },
    },
    Effect {
        id: "stribeck",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "f_sc exp(−(θ̇/v_s)²) sgn θ̇, f_sc = f_s − f_c",
        parameters: &[parameter("f_sc", "Nm", MUST, 0.0, 1e4), parameter("v_s", "rad/s", MUST, 1e-4, 100.0)],
        draw: |r, s, i| params(&[("f_sc", r.uniform(0.05, 0.15) * s.torque[i]), ("v_s", r.log_uniform(0.05, 0.3))]),
        apply: |v, w| {
            for &i in &v.joints {
                let law = Stribeck { excess: v.get("f_sc"), speed: v.get("v_s") };
                w.truth.joints[i].friction.stribeck.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "viscous_power",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "a |θ̇|^p sgn θ̇",
        parameters: &[parameter("a", "Nm (s/rad)^p", MUST, 0.0, 1e4), parameter("p", "1", MUST, 0.1, 4.0)],
        draw: |r, s, i| {
            let p = if r.unit() < 0.4 { r.uniform(0.35, 0.65) } else { r.uniform(1.6, 2.3) };
            let a = r.uniform(0.05, 0.15) * s.torque[i] / (0.5 * s.limits.qd_max[i]).powf(p);
            params(&[("a", a), ("p", p)])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = Power { coefficient: v.get("a"), exponent: v.get("p") };
                w.truth.joints[i].friction.power.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "load_friction",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "μ |τ_link| sgn θ̇ + μ_v |τ_link| θ̇",
        parameters: &[parameter("mu", "1", MUST, 0.0, 0.8), parameter("mu_v", "s/rad", 0.0, 0.0, 1.0)],
        draw: |r, _, _| params(&[("mu", r.uniform(0.04, 0.12))]),
        apply: |v, w| {
            for &i in &v.joints {
                let law = LoadFriction { coulomb: v.get("mu"), viscous: v.get("mu_v") };
                w.truth.joints[i].friction.load.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "thermal_viscous",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "b exp(−t/τ_w) θ̇, t since the cold start",
        parameters: &[parameter("b", "Nm s/rad", MUST, 0.0, 1e4), parameter("tau_w", "s", MUST, 0.1, 1e5)],
        draw: |r, s, i| {
            let b = r.uniform(0.15, 0.4) * s.torque[i] / s.limits.qd_max[i];
            params(&[("b", b), ("tau_w", r.uniform(25.0, 90.0))])
        },
        apply: |v, w| {
            for &i in &v.joints {
                let law = Thermal { excess: v.get("b"), time_constant: v.get("tau_w") };
                w.truth.joints[i].friction.thermal.push(law);
            }
            Ok(())
        },
    },
    Effect {
        id: "presliding",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Joint,
        kind: None,
        law: "the Coulomb level acts through a bristle of travel δ: 0 Dahl, 1 LuGre, 2 Maxwell slip",
        parameters: &[
            parameter("delta", "rad", MUST, 1e-4, 1.0),
            parameter("law", "0, 1, 2", 0.0, 0.0, 2.0),
            parameter("f_1", "Nm s", 0.0, 0.0, 1e3),
        ],
        draw: |r, s, i| {
            let law = r.index(3) as f64;
            let delta = r.log_uniform(4e-3, 5e-2);
            let damping = if law == 1.0 { r.uniform(0.002, 0.01) * s.torque[i] * delta } else { 0.0 };
            params(&[("delta", delta), ("law", law), ("f_1", damping)])
        },
        apply: |v, w| {
            let travel = v.get("delta");
            let bristle = match v.get("law").round() as i64 {
                1 => Bristle::LuGre { travel, damping: v.get("f_1") },
                2 => Bristle::Maxwell { travel },
                _ => Bristle::Dahl { travel },
            };
            for &i in &v.joints {
                w.truth.joints[i].friction.presliding = Some(bristle);
            }
            Ok(())
        },
    },
];
