//! Friction in the passive joints of a Delta's parallel legs.
//!
//! The forearm turns with ω_f = ŝ × ṡ / l2, the upper arm with ω_a = θ̇ a. At the platform, which does not
//! turn, the joint moves with ω_f, at the elbow with ω_f − ω_a. What friction takes there the drives must give:
//! τ_j = Σ ∂ω/∂θ̇_j · (μ ω/√(ω² + ω_0²) + b ω) over the two joint centres of the three legs.

use crate::effects::kernel::law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, EffectSample, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use crate::{Delta, Vec3};
use lacuna_interfaces::{Joints, MAX_JOINTS};

pub(super) static EFFECT: Effect = Effect {
    id: "ball_friction",
    title: "Friction in the ball joints",
    law: "Σ (∂ω/∂θ̇)ᵀ (μ ω/√(ω² + ω_0²) + b ω) over elbow and platform joints, ω their relative rates",
    words: "Coulomb (μ) and viscous (b) friction at both joint centres of each forearm, all alike. Around ω_0 the \
            Coulomb part turns round with the rate: it bends the bearings before they slide.",
    reference: "Farhat, Mata, Page, Díaz-Rodríguez 2010, Robotica 28, 35-45",
    parameters: &[
        ParameterSpec::amplitude("mu", "Nm", "Coulomb level at a joint centre", NOT_NEGATIVE, 0.3).or(0.0),
        ParameterSpec::amplitude("b", "Nm s/rad", "viscous coefficient at a joint centre", NOT_NEGATIVE, 0.05).or(0.0),
        ParameterSpec::shape("omega_0", "rad/s", "rate ω_0 over which the Coulomb part turns round", (0.0, 10.0), 0.05)
            .or(0.05)
            .searched(&[0.01, 0.03, 0.05, 0.1]),
    ],
    scope: Scope::Structure,
    robots: Robots::Delta,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| {
        let (delta, omega_0) = (request.context.delta()?, request.shape("omega_0"));
        Ok(law(move |s, sink| {
            if let Some([dry, viscous]) = columns(&delta, omega_0, s) {
                sink.set_all(0, &dry);
                sink.set_all(1, &viscous);
            }
        }))
    },
};

fn columns(delta: &Delta, omega_0: f64, s: &EffectSample<'_>) -> Option<[Joints; 2]> {
    let q = [s.q_rad[0], s.q_rad[1], s.q_rad[2]];
    let pose = delta.pose(&q).ok()?;
    let jacobian: [Vec3; 3] = std::array::from_fn(|j| pose.jacobian_column(j));
    let (l1, l2) = (delta.l1_m(), delta.l2_m());
    let (mut dry, mut viscous) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for i in 0..3 {
        let along = pose.s[i] / l2;
        // a is across the plane of the upper arm and its velocity.
        let axis = pose.u[i].cross(&pose.w[i]) / (l1 * l1);
        let mut platform = jacobian.map(|column| along.cross(&column) / l2);
        platform[i] -= along.cross(&pose.u[i]) / l2;
        let mut elbow = platform;
        elbow[i] -= axis;
        for rates in [platform, elbow] {
            let omega: Vec3 = (0..3).map(|j| rates[j] * s.qd_rad_s[j]).sum();
            let size = omega.norm().hypot(omega_0);
            let unit = if size > 0.0 { omega / size } else { Vec3::zeros() };
            for j in 0..3 {
                dry[j] += rates[j].dot(&unit);
                viscous[j] += rates[j].dot(&omega);
            }
        }
    }
    Some([dry, viscous])
}
