//! A joint that was homed to the wrong zero.

use crate::effects::kernel::{Kernel, law};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Request, Robots, Scope, Side};
use lacuna_interfaces::{BadInput, MAX_JOINTS};

/// Step of the central difference [rad]: its error is of the order of its square.
const STEP_RAD: f64 = 1e-5;

pub(super) static EFFECT: Effect = Effect {
    id: "encoder_offset",
    title: "Encoder offset",
    law: "q_0 ∂τ/∂θ_i, the true angle being θ_i + q_0",
    words: "The joint was homed to a wrong zero, so the rigid body is computed in a pose that is not the robot's. \
            First order in q_0: good to some percent of the effect at 1°. Errors of length look alike over a small \
            workspace.",
    reference: "Mooring, Roth, Driels 1991, Fundamentals of Manipulator Calibration, Wiley",
    parameters: &[ParameterSpec::amplitude("q_0", "rad", "true minus measured angle", (-0.5, 0.5), 0.01)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Source,
    dissipative: false,
    exact_group: &[],
    practical_group: &["link_length"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest, Regime::Massless],
    build,
};

fn build(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let mechanics = request.context.mechanics();
    let pi = request.context.pi.to_vec();
    let joints = request.joints.to_vec();
    Ok(law(move |s, sink| {
        let at = |step: f64| {
            let mut q = *s.q_rad;
            joints.iter().filter(|&&j| j < MAX_JOINTS).for_each(|&j| q[j] += step);
            mechanics.torque(&q, s.qd_rad_s, s.qdd_rad_s2, &pi)
        };
        if let (Some(plus), Some(minus)) = (at(STEP_RAD), at(-STEP_RAD)) {
            sink.set_all(0, &std::array::from_fn(|i| (plus[i] - minus[i]) / (2.0 * STEP_RAD)));
        }
    }))
}
