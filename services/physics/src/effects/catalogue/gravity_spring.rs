//! A counterbalance or imbalance that follows the joint's angle like a pendulum.

use crate::effects::kernel::joint_law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "gravity_spring",
    title: "Sine spring",
    law: "a_s sin θ + a_c cos θ = A sin(θ − θ_0)",
    words: "A counterbalance, or a centre of mass that is elsewhere than in the model: on an axis fixed to the base \
            across gravity the two are the same. A = √(a_s² + a_c²), θ_0 = atan2(−a_c, a_s).",
    reference: "Arakelian 2016, Advanced Robotics 30, 79-96",
    parameters: &[
        ParameterSpec::amplitude("a_s", "Nm", "factor of sin θ", ANY, 1.5).or(0.0),
        ParameterSpec::amplitude("a_c", "Nm", "factor of cos θ", ANY, 0.8).or(0.0),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &["arm_inertia"],
    practical_group: &["base_tilt", "cable_spring", "torque_offset"],
    appears: &[Regime::Rest, Regime::Shaking],
    vanishes: &[],
    build: |request| {
        Ok(joint_law(request.joints, |s, j| {
            let (sin, cos) = s.q_rad[j].sin_cos();
            [sin, cos]
        }))
    },
};
