//! Cables and hoses that pull the joint back.

use crate::effects::kernel::joint_law;
use crate::effects::specification::{ANY, NOT_NEGATIVE};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "cable_spring",
    title: "Cable spring",
    law: "k_1 Δ + k_3 Δ³, Δ = θ − q_0",
    words: "A cable pack or hose that is bent by the joint, stiffer the further it goes. Over a narrow range it is \
            hard to tell from a sine spring.",
    reference: "Kovacic, Brennan 2011, The Duffing Equation, Wiley (the law of the spring)",
    parameters: &[
        ParameterSpec::amplitude("k_1", "Nm/rad", "stiffness", ANY, 1.0).or(0.0),
        ParameterSpec::amplitude("k_3", "Nm/rad^3", "stiffening", NOT_NEGATIVE, 2.0).or(0.0),
        ParameterSpec::shape("q_0", "rad", "angle without force", (-1e3, 1e3), 0.0)
            .or(0.0)
            .searched(&[-0.6, -0.3, 0.0, 0.3, 0.6]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["gravity_spring", "base_tilt"],
    appears: &[Regime::Rest, Regime::Shaking],
    vanishes: &[],
    build: |request| {
        let q_0 = request.shape("q_0");
        Ok(joint_law(request.joints, move |s, j| {
            let d = s.q_rad[j] - q_0;
            [d, d * d * d]
        }))
    },
};
