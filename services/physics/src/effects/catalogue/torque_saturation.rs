//! A motor that needs more and more current for its torque.

use crate::effects::kernel::joint_law;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "torque_saturation",
    title: "Torque constant that falls at high torque",
    law: "a τ ((abs τ − τ_k)/τ_k)^p where abs τ > τ_k, else 0",
    words: "Above the knee τ_k the iron saturates: the same torque takes more current, and a drive that assumes a \
            constant factor reports more torque than it gives. First order in a. A clip to which the executed torque is logged \
            leaves nothing to see.",
    reference: "Krishnan 2010, Permanent Magnet Synchronous and Brushless DC Motor Drives, CRC Press",
    parameters: &[
        ParameterSpec::amplitude(
            "a",
            "1",
            "fall of the torque constant at twice the knee, as a share",
            (0.0, 100.0),
            0.15,
        ),
        ParameterSpec::shape("tau_k", "Nm", "knee", (1e-6, 1e9), 3.0).searched(&[2.0, 5.0, 10.0, 15.0, 20.0, 30.0]),
        ParameterSpec::shape("p", "1", "1: a kink, 2: a smooth bend", (0.5, 4.0), 1.0).or(1.0).searched(&[1.0, 2.0]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Drive,
    stage: OwningStage::Source,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::LowTorque],
    build: |request| {
        let (knee, p) = (request.shape("tau_k"), request.shape("p"));
        Ok(joint_law(request.joints, move |s, j| {
            let tau = s.tau_drive_nm[j];
            let excess = (tau.abs() - knee) / knee;
            [if excess > 0.0 { tau * excess.powf(p) } else { 0.0 }]
        }))
    },
};
