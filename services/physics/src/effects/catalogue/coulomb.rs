//! Dry friction of constant level: the baseline of every robot.

use crate::effects::kernel::joint_law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "coulomb",
    title: "Coulomb friction",
    law: "f_c s",
    words: "Dry friction of the same level at every speed and in both directions. A joint that sticks holds any \
            torque within ± f_c: there the level cannot be read.",
    reference: "Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Automatica 30, 1083-1138",
    parameters: &[ParameterSpec::amplitude("f_c", "Nm", "level", NOT_NEGATIVE, 2.0)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::SlowSliding, Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| Ok(joint_law(request.joints, |s, j| [s.direction[j]])),
};
