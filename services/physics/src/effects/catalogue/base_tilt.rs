//! Gravity that does not point where the robot file says.

use crate::Vec3;
use crate::effects::kernel::{Kernel, law};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Request, Robots, Scope, Side};
use lacuna_interfaces::{BadInput, MAX_JOINTS};

/// Beyond this the first-order gravity change is not good enough [rad].
const TILT: (f64, f64) = (-0.5, 0.5);

pub(super) static EFFECT: Effect = Effect {
    id: "base_tilt",
    title: "Tilted base",
    law: "τ_gravity(Δg), Δg = abs(g) (ε_1 u_1 + ε_2 u_2)",
    words: "Two angles for the whole robot: gravity leans by ε_1 towards u_1 and by ε_2 towards u_2, the two axes of \
            the base across gravity (x and y if gravity is along z), to first order. Free gravity terms at every \
            joint can imitate it with more numbers; the fewer numbers are to be preferred.",
    reference: "Hollerbach, Khalil, Gautier 2016, Springer Handbook of Robotics, ch. 6",
    parameters: &[
        ParameterSpec::amplitude("tilt_1", "rad", "ε_1, lean of gravity towards u_1", TILT, 0.03).or(0.0),
        ParameterSpec::amplitude("tilt_2", "rad", "ε_2, lean of gravity towards u_2", TILT, -0.02).or(0.0),
    ],
    scope: Scope::Structure,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["arm_inertia", "gravity_spring", "cable_spring"],
    appears: &[Regime::Rest],
    vanishes: &[Regime::Massless],
    build,
};

fn build(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let context = request.context;
    let g = Vec3::from(context.body.gravity_m_s2());
    let [u_1, u_2] = across(&g)
        .ok_or_else(|| BadInput::new("found a robot without gravity; expected env.gravity of some magnitude"))?;
    let tilted = [u_1, u_2].map(|u| context.mechanics_under((u * g.norm()).into()));
    let pi = context.pi.to_vec();
    Ok(law(move |s, sink| {
        let still = [0.0; MAX_JOINTS];
        for (c, mechanics) in tilted.iter().enumerate() {
            // At rest nothing but the (changed) gravity is left.
            if let Some(tau) = mechanics.torque(s.q_rad, &still, &still, &pi) {
                sink.set_all(c, &tau);
            }
        }
    }))
}

/// The two base axes least along `g`, in their order, made perpendicular to it and to each other.
pub(super) fn across(g: &Vec3) -> Option<[Vec3; 2]> {
    let down = g.try_normalize(1e-9)?;
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
    let most = down.iamax();
    let mut rest = (0..3).filter(|&i| i != most).map(|i| axes[i]);
    let (a, b) = (rest.next()?, rest.next()?);
    let u_1 = (a - down * down.dot(&a)).try_normalize(1e-9)?;
    let b = b - down * down.dot(&b);
    let u_2 = (b - u_1 * u_1.dot(&b)).try_normalize(1e-9)?;
    Some([u_1, u_2])
}
