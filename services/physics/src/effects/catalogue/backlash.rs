//! A gap between motor and link. The equations are in [`crate::effects::compliance`].

use crate::effects::compliance::Compliance;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "backlash",
    title: "Backlash",
    law: "Δτ = τ_link(θ − e) − M ë − τ_link(θ), M ë + T = τ_link(θ − e), T = k (e − b sgn e) + d ė where abs e > b, else 0",
    words: "Motor and link part when the load changes its direction; for a moment the motor carries nothing, then \
            the flanks meet with a knock. A load that keeps its direction (gravity on a loaded arm) hides it.",
    reference: "Nordin, Gutman 2002, Automatica 38, 1633-1649",
    parameters: &[
        ParameterSpec::shape("b", "rad", "half gap", (0.0, 0.1), 1.5e-3)
            .searched(&[0.7e-3, 1e-3, 1.5e-3, 2.2e-3, 3.3e-3, 6e-3]),
        ParameterSpec::shape("k", "Nm/rad", "stiffness of the flanks", (1.0, 1e9), 3e4)
            .or(3e4)
            .searched(&[1e4, 3e4, 1e5]),
        ParameterSpec::shape("zeta", "1", "damping ratio of the contact", (0.0, 2.0), 0.2)
            .or(0.2)
            .searched(&[0.05, 0.2, 0.5]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::State,
    side: Side::Transmission,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["elasticity", "presliding"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest, Regime::Massless],
    build: |request| {
        let (k, zeta, b) = (request.shape("k"), request.shape("zeta"), request.shape("b"));
        Ok(Box::new(Compliance::new(request, k, zeta, b)))
    },
};
