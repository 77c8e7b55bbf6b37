//! Friction that changes as the gear warms up.

use crate::effects::kernel::joint_law;
use crate::effects::specification::{ANY, NOT_NEGATIVE};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use lacuna_interfaces::BadInput;

pub(super) static EFFECT: Effect = Effect {
    id: "thermal_viscous",
    title: "Friction that changes with temperature",
    law: "b e^(−t/τ_w) θ̇ + (T − T_ref) (b_T θ̇ + c_T s)",
    words: "Cold lubricant is stiff. Without a temperature signal the excess b over the warm coefficient decays with \
            the time since switch-on, so recordings must know when they were made; with one, the coefficient \
            changes by b_T per kelvin, and dry friction by c_T (where the torque signal is a voltage, the winding's \
            resistance is in both). In catalogue notation f_v (1 + a e^(−t/τ_w)): b = a f_v.",
    reference: "Bittencourt, Gunnarsson 2012, J. Dyn. Syst. Meas. Control 134, 051013",
    parameters: &[
        ParameterSpec::amplitude("b", "Nm s/rad", "excess of f_v at switch-on", NOT_NEGATIVE, 0.5).or(0.0),
        ParameterSpec::amplitude("b_T", "Nm s/(rad K)", "change of f_v per kelvin", ANY, -0.02).or(0.0),
        ParameterSpec::amplitude("c_T", "Nm/K", "change of f_c per kelvin", ANY, -0.01).or(0.0),
        ParameterSpec::shape("tau_w", "s", "time constant τ_w of warming up", (0.1, 1e5), 60.0)
            .or(60.0)
            .searched(&[10.0, 20.0, 40.0, 80.0, 160.0, 640.0]),
        ParameterSpec::shape("T_ref", "degC", "temperature at which f_v holds", (-60.0, 200.0), 40.0).or(40.0),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::Slow,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::FastSliding],
    vanishes: &[Regime::SlidingWarm, Regime::Rest],
    build: |request| {
        for symbol in ["b_T", "c_T"] {
            if request.given(symbol).is_some_and(|v| v != 0.0) && request.context.robot.columns.temperature.is_empty() {
                return Err(BadInput::new(format!(
                    "found {symbol} for a robot without temperature columns; expected columns.temperature in the robot \
                     file"
                )));
            }
        }
        let (tau_w, t_ref) = (request.shape("tau_w"), request.shape("T_ref"));
        Ok(joint_law(request.joints, move |s, j| {
            // A recording that starts before switch-on cannot be colder than cold.
            let cold = (-s.t_s.max(0.0) / tau_w).exp();
            let warmer = s.temperature_degc[j] - t_ref;
            let warmer = if warmer.is_finite() { warmer } else { 0.0 };
            [cold * s.qd_rad_s[j], warmer * s.qd_rad_s[j], warmer * s.direction[j]]
        }))
    },
};
