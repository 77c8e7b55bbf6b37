//! Coulomb friction that differs between the two directions.

use crate::effects::kernel::joint_law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "coulomb_asym",
    title: "Coulomb friction that differs by direction",
    law: "a_c abs(s), so that f_c⁺ = f_c + a_c forwards and f_c⁻ = f_c − a_c backwards",
    words: "Half the difference of the two levels, on top of the common level f_c. While a joint slides this is a \
            constant, the same as an offset of the drive or of the torque sensor; only a joint at rest with a \
            known load would tell them apart. f_c − abs(a_c) ≥ 0 is needed for a friction that dissipates.",
    reference: "Armstrong-Hélouvry 1991, Control of Machines with Friction, Kluwer",
    parameters: &[ParameterSpec::amplitude("a_c", "Nm", "(f_c⁺ − f_c⁻) / 2", ANY, 0.8)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: false,
    exact_group: &["torque_offset"],
    practical_group: &[],
    appears: &[Regime::SlowSliding, Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| Ok(joint_law(request.joints, |s, j| [s.direction[j].abs()])),
};
