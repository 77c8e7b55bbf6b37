//! A spring between motor and link. The equations are in [`crate::effects::compliance`].

use crate::effects::compliance::Compliance;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "elasticity",
    title: "Elastic joint",
    law: "Δτ = τ_link(θ − e) − M ë − τ_link(θ), M ë + d ė + k e = τ_link(θ − e)",
    words: "Gear and shaft wind up by e, the link lags behind the motor and swings against it. Far below the \
            resonance the torque looks like a delayed one. Linearised columns do not reach the noise floor: the \
            link is simulated.",
    reference: "Spong 1987, J. Dyn. Syst. Meas. Control 109, 310-319",
    parameters: &[
        ParameterSpec::shape("k", "Nm/rad", "stiffness", (1.0, 1e9), 4e3)
            .searched(&[800.0, 1500.0, 3000.0, 6000.0, 12000.0, 50000.0]),
        ParameterSpec::shape("zeta", "1", "damping ratio", (0.0, 2.0), 0.05).or(0.05).searched(&[0.01, 0.03, 0.1]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::State,
    side: Side::Transmission,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["torque_delay", "backlash"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest, Regime::Massless],
    build: |request| Ok(Box::new(Compliance::new(request, request.shape("k"), request.shape("zeta"), 0.0))),
};
