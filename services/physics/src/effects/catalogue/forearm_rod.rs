//! Forearms of a Delta whose mass is spread along them.
//!
//! With mass m_f = 2 m2, centre of mass ξ and transverse inertia I_f, the sums s_1 = m_f ξ and
//! s_2 = m_f ξ² + I_f/l2² are all that matters, and π is linear in them: elbow inertia m_f − 2 s_1 + s_2,
//! elbow weight m_f − s_1, platform inertia s_2 and weight s_1 a leg, coupling s_1 − s_2. Point masses at both
//! ends (M_KH) have s_1 = s_2 = m2.

use super::arm_inertia::along;
use crate::delta::parameters::{GC, GS, INERTIA, M_GR, M_IN, M_JE};
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "forearm_rod",
    title: "Forearms with distributed mass",
    law: "Δs_1 ∂τ/∂s_1 + Δs_2 ∂τ/∂s_2 + Δm ∂τ/∂m_f, with s_1 = m_f ξ and s_2 = m_f ξ² + I_f/l2²",
    words: "The model has half of each forearm's mass at the elbow and half at the platform. A rod couples the two \
            ends, and its weight divides otherwise: uniform rods have Δs_1 = 0 and Δs_2 = −m2/3. Where the mass itself \
            is not that of the file, it is fitted as well.",
    reference: "Codourey 1998, Int. J. Robotics Research 17, 1325-1336",
    parameters: &[
        ParameterSpec::amplitude("ds_1", "kg", "change of m_f ξ from m2: where the centre of mass is", ANY, 0.03)
            .or(0.0),
        ParameterSpec::amplitude("ds_2", "kg", "change of m_f ξ² + I_f/l2² from m2", ANY, -0.07).or(0.0),
        ParameterSpec::amplitude("dm", "kg", "change of m_f, the mass of a forearm", ANY, 0.02).or(0.0),
    ],
    scope: Scope::Structure,
    robots: Robots::Delta,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["link_length", "payload"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest],
    build: |request| {
        let context = request.context;
        let l1 = context.delta()?.l1_m();
        let mut first = vec![0.0; context.pi.len()];
        let (mut second, mut third) = (first.clone(), first.clone());
        first[INERTIA..GC].fill(-2.0 * l1 * l1);
        first[GC..GS].fill(-l1);
        (first[M_GR], first[M_JE]) = (3.0, 1.0);
        second[INERTIA..GC].fill(l1 * l1);
        (second[M_IN], second[M_JE]) = (3.0, -1.0);
        third[INERTIA..GC].fill(l1 * l1);
        third[GC..GS].fill(l1);
        Ok(along(context, vec![first, second, third]))
    },
};
