//! Friction that grows with what the gear carries.

use crate::effects::kernel::joint_law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "load_friction",
    title: "Load-dependent friction",
    law: "μ abs(τ_link) s + μ_v abs(τ_link) θ̇",
    words: "Tooth and bearing forces grow with the torque that the gear passes to the link, and friction with them: \
            μ is close to one minus the gear's efficiency. The rotor's own inertia torque does not load the gear \
            and is left out of τ_link; link-side terms of the model are in it.",
    reference: "Hamon, Gautier, Garrec 2010, IROS, 6187-6193",
    parameters: &[
        ParameterSpec::amplitude("mu", "1", "Coulomb-like share of the load", NOT_NEGATIVE, 0.08).or(0.0),
        ParameterSpec::amplitude("mu_v", "s/rad", "viscous share of the load", NOT_NEGATIVE, 0.02).or(0.0),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::SlidingUnloaded, Regime::Rest],
    build: |request| {
        Ok(joint_law(request.joints, |s, j| {
            let load = s.tau_link_nm[j].abs();
            [load * s.direction[j], load * s.qd_rad_s[j]]
        }))
    },
};
