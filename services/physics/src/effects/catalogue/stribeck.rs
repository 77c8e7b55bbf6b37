//! Stribeck: sticking before sliding.

use crate::effects::kernel::joint_law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "stribeck",
    title: "Stribeck friction",
    law: "f_sc exp(−(θ̇/v_s)²) s, with f_sc = f_s − f_c",
    words: "At low speed the lubricant film breaks down and friction rises from f_c to f_s. Only samples below v_s \
            tell it from a friction that grows with a small power of the speed. With a bristle as direction, s is \
            the bristle's bend and f_s its limit, so a breakaway is part of it.",
    reference: "Bo, Pavelescu 1982, Wear 82, 277-289; Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, \
                Automatica 30, 1083-1138",
    parameters: &[
        ParameterSpec::amplitude("f_sc", "Nm", "static minus Coulomb level", NOT_NEGATIVE, 1.5),
        ParameterSpec::shape("v_s", "rad/s", "Stribeck speed", (1e-4, 10.0), 0.12)
            .searched(&[0.02, 0.04, 0.07, 0.12, 0.2, 0.4]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &["viscous_power"],
    appears: &[Regime::SlowSliding],
    vanishes: &[Regime::FastSliding, Regime::Rest],
    build: |request| {
        let v_s = request.shape("v_s");
        Ok(joint_law(request.joints, move |s, j| [(-(s.qd_rad_s[j] / v_s).powi(2)).exp() * s.direction[j]]))
    },
};
