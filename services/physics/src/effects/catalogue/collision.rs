//! A short contact with the surroundings.

use crate::effects::kernel::law;
use crate::effects::specification::ANY;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use std::f64::consts::PI;

pub(super) static EFFECT: Effect = Effect {
    id: "collision",
    title: "Collision",
    law: "−Jᵀ F sin(π (t − t_0)/T) from t_0 to t_0 + T",
    words: "The surroundings push platform or tip with a force that rises to F and falls again within T, as a half \
            sine.",
    reference: "Haddadin, De Luca, Albu-Schäffer 2017, IEEE Trans. Robotics 33, 1292-1312",
    parameters: &[
        ParameterSpec::amplitude("F_x", "N", "largest force on the tip along x", ANY, 60.0).or(0.0),
        ParameterSpec::amplitude("F_y", "N", "largest force on the tip along y", ANY, -40.0).or(0.0),
        ParameterSpec::amplitude("F_z", "N", "largest force on the tip along z", ANY, 30.0).or(0.0),
        ParameterSpec::shape("t_0", "s", "time of the first touch on the recording's clock", (-1e12, 1e12), 0.1),
        ParameterSpec::shape("T", "s", "duration", (1e-4, 10.0), 0.2).searched(&[0.01, 0.02, 0.04, 0.08, 0.16]),
    ],
    scope: Scope::Structure,
    robots: Robots::Any,
    memory: Memory::Events,
    side: Side::Link,
    stage: OwningStage::Payload,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::Rest, Regime::Shaking],
    vanishes: &[Regime::OutsideEvent],
    build: |request| {
        let mechanics = request.context.mechanics();
        let (t_0, duration) = (request.shape("t_0"), request.shape("T"));
        Ok(law(move |s, sink| {
            let phase = (s.t_s - t_0) / duration;
            if !(0.0..=1.0).contains(&phase) {
                return;
            }
            let size = (PI * phase).sin();
            for (c, force) in [[size, 0.0, 0.0], [0.0, size, 0.0], [0.0, 0.0, size]].into_iter().enumerate() {
                if let Some(tau) = mechanics.external_force(s.q_rad, force) {
                    sink.set_all(c, &tau);
                }
            }
        }))
    },
};
