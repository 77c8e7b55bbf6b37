//! Friction with a power of the speed.

use crate::effects::kernel::joint_law;
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "viscous_power",
    title: "Nonlinear viscous friction",
    law: "a abs(θ̇)^p s",
    words: "Viscous friction that does not grow in proportion: p < 1 for lubricants that thin under shear, p > 1 for \
            churning oil and fans. An eddy-current brake is well described by it over a limited range of speeds.",
    reference: "Hess, Soom 1990, J. Tribology 112, 147-152; Armstrong-Hélouvry 1991, Control of Machines with \
                Friction, Kluwer",
    parameters: &[
        ParameterSpec::amplitude("a", "Nm (s/rad)^p", "coefficient", NOT_NEGATIVE, 0.3),
        ParameterSpec::shape("p", "1", "power", (0.05, 4.0), 1.8).searched(&[0.3, 0.5, 0.7, 1.4, 1.7, 2.0, 2.5, 3.0]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: true,
    exact_group: &[],
    practical_group: &["stribeck"],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::Rest],
    build: |request| {
        let p = request.shape("p");
        Ok(joint_law(request.joints, move |s, j| [s.qd_rad_s[j].abs().powf(p) * s.direction[j]]))
    },
};
