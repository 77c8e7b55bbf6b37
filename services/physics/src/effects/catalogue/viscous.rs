//! Friction in proportion to speed: the baseline of every robot.

use crate::effects::kernel::joint_law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "viscous",
    title: "Viscous friction",
    law: "f_v θ̇",
    words: "Lubricant shear in gear and bearings. With the torque signal in volts the motor's back-EMF looks the same.",
    reference: "Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Automatica 30, 1083-1138",
    parameters: &[ParameterSpec::amplitude("f_v", "Nm s/rad", "coefficient", NOT_NEGATIVE, 0.5)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| Ok(joint_law(request.joints, |s, j| [s.qd_rad_s[j]])),
};
