//! A wrist whose motors share an axis: one joint feels the other's motor.

use crate::effects::direction::ramp;
use crate::effects::kernel::law;
use crate::effects::specification::{ANY, NOT_NEGATIVE};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use lacuna_interfaces::BadInput;

pub(super) static EFFECT: Effect = Effect {
    id: "axis_coupling",
    title: "Coupled axes",
    law: "with w = θ̇_j + ρ θ̇_i: joint i: ρ (J θ̈_j + f_v θ̇_j + f_c sgn w); joint j: J ρ θ̈_i + f_v ρ θ̇_i + f_c sgn w",
    words: "The motor of joint j turns with θ̇_j + ρ θ̇_i, because its gear train runs through joint i: its inertia \
            and friction are felt on both. The parts that each joint would have by itself belong to its own inertia \
            and viscous friction and are not repeated here.",
    reference: "Gautier, Janot, Vandanjon 2013, IEEE Trans. Control Systems Technology 21, 428-444 (Stäubli TX40: \
                Ia_m6, fv_m6, fs_m6)",
    parameters: &[
        ParameterSpec::amplitude("J", "kg m^2", "inertia of the shared motor at the joint side", ANY, 0.01).or(0.0),
        ParameterSpec::amplitude("f_v", "Nm s/rad", "its viscous friction", ANY, 0.6).or(0.0),
        ParameterSpec::amplitude("f_c", "Nm", "its Coulomb friction", NOT_NEGATIVE, 2.0).or(0.0),
        ParameterSpec::shape(
            "rho",
            "1",
            "turns of the motor (at joint j's side) per turn of joint i",
            (-1e3, 1e3),
            1.0,
        )
        .or(1.0)
        .searched(&[-1.0, 1.0]),
    ],
    scope: Scope::Pair,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Transmission,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::Rest],
    build: |request| {
        let &[i, j] = request.joints else {
            return Err(BadInput::new("joints: expected two"));
        };
        let rho = request.shape("rho");
        Ok(law(move |s, sink| {
            for (c, x) in [s.qdd_rad_s2, s.qd_rad_s].into_iter().enumerate() {
                sink.set(c, i, rho * x[j]);
                sink.set(c, j, rho * x[i]);
            }
            let sign = ramp(s.qd_rad_s[j] + rho * s.qd_rad_s[i], s.ramp_rad_s);
            sink.set(2, i, rho * sign);
            sink.set(2, j, sign);
        }))
    },
};
