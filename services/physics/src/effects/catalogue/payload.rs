//! A mass carried by platform or tip for a time.

use crate::effects::kernel::law;
use crate::effects::specification::{ANY_TIME, NOT_NEGATIVE};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "payload",
    title: "Payload",
    law: "m ∂τ/∂m_p from t_on to t_off (Delta: m Jᵀγ, γ = ẍ − g)",
    words: "A point mass at platform or tip between pick and place; one term per carry. Without times it is carried \
            always, which nothing tells from a heavier platform. On a Delta, whose platform only translates, where \
            the mass sits on it makes no difference.",
    reference: "Khalil, Gautier, Lemoine 2007, ICRA, 4943-4948",
    parameters: &[
        ParameterSpec::amplitude("m", "kg", "mass", NOT_NEGATIVE, 1.5),
        ParameterSpec::shape("t_on", "s", "time of the pick on the recording's clock", ANY_TIME, 0.0)
            .or(f64::NEG_INFINITY),
        ParameterSpec::shape("t_off", "s", "time of the place on the recording's clock", ANY_TIME, 10.0)
            .or(f64::INFINITY),
    ],
    scope: Scope::Structure,
    robots: Robots::Any,
    memory: Memory::Events,
    side: Side::Link,
    stage: OwningStage::Payload,
    dissipative: false,
    exact_group: &[],
    practical_group: &["forearm_rod", "payload_ecc"],
    appears: &[Regime::Rest, Regime::Shaking],
    vanishes: &[Regime::OutsideEvent, Regime::WeightlessRest],
    build: |request| {
        let mechanics = request.context.mechanics();
        let carried = request.shape("t_on")..request.shape("t_off");
        Ok(law(move |s, sink| {
            if carried.contains(&s.t_s)
                && let Some(tau) = mechanics.payload_column(s)
            {
                sink.set_all(0, &tau);
            }
        }))
    },
};
