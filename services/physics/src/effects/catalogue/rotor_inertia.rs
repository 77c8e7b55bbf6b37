//! Inertia of rotor and gear that the model does not have.

use crate::effects::kernel::joint_law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "rotor_inertia",
    title: "Rotor inertia",
    law: "J θ̈",
    words: "What turns with the motor, times the gear ratio squared; negative if the model has too much. On an axis \
            fixed to the base the arm's own inertia about it is the same thing: only the sum is known.",
    reference: "Khalil, Dombre 2002, Modeling, Identification and Control of Robots, ch. 9",
    parameters: &[ParameterSpec::amplitude("J", "kg m^2", "inertia at the joint side", ANY, 0.03)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &["arm_inertia"],
    practical_group: &[],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::FastSliding, Regime::Rest],
    build: |request| Ok(joint_law(request.joints, |s, j| [s.qdd_rad_s2[j]])),
};
