//! A constant torque.

use crate::effects::kernel::joint_law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "torque_offset",
    title: "Constant torque offset",
    law: "τ_0",
    words: "Bias of the current or torque sensor, a constant load, or unequal Coulomb levels: the same while the \
            joint slides. Over a narrow range of angles a shifted centre of mass looks like it too.",
    reference: "Khalil, Dombre 2002, Modeling, Identification and Control of Robots, ch. 12",
    parameters: &[ParameterSpec::amplitude("tau_0", "Nm", "offset", ANY, 0.8)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: false,
    exact_group: &["coulomb_asym"],
    practical_group: &["arm_inertia", "gravity_spring"],
    appears: &[Regime::Rest, Regime::FastSliding],
    vanishes: &[],
    build: |request| Ok(joint_law(request.joints, |_, _| [1.0])),
};
