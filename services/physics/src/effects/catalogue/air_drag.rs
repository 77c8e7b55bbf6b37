//! Drag of the air on what the robot moves.

use crate::Vec3;
use crate::effects::kernel::law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "air_drag",
    title: "Air drag at platform or tip",
    law: "c Jᵀ abs(ẋ) ẋ",
    words: "The square of the speed of platform or tip, against its motion: c = ρ C_d A / 2.",
    reference: "Batchelor 1967, An Introduction to Fluid Dynamics, Cambridge University Press",
    parameters: &[ParameterSpec::amplitude("c", "N s^2/m^2", "drag coefficient", NOT_NEGATIVE, 0.3)],
    scope: Scope::Structure,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: true,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| {
        let mechanics = request.context.mechanics();
        Ok(law(move |s, sink| {
            let Some(tip) = mechanics.tip_motion(s) else { return };
            let v = Vec3::from(tip.velocity_m_s);
            if let Some(tau) = mechanics.external_force(s.q_rad, (-v.norm() * v).into()) {
                sink.set_all(0, &tau);
            }
        }))
    },
};
