//! The registry: one file, one line here. The order is that of the docs.

mod air_drag;
mod arm_inertia;
mod axis_coupling;
mod backlash;
mod ball_friction;
mod base_tilt;
mod cable_spring;
pub mod cogging;
mod collision;
mod coulomb;
mod coulomb_asym;
mod elasticity;
mod encoder_offset;
mod forearm_rod;
mod gravity_spring;
mod kt_scale;
mod link_length;
mod load_friction;
mod payload;
mod payload_ecc;
mod presliding;
mod rotor_inertia;
mod stribeck;
mod thermal_viscous;
mod torque_delay;
mod torque_offset;
mod torque_saturation;
mod viscous;
mod viscous_power;

use super::effect::Effect;

static REGISTRY: &[&Effect] = &[
    &coulomb::EFFECT,
    &viscous::EFFECT,
    &coulomb_asym::EFFECT,
    &torque_offset::EFFECT,
    &stribeck::EFFECT,
    &viscous_power::EFFECT,
    &load_friction::EFFECT,
    &thermal_viscous::EFFECT,
    &presliding::EFFECT,
    &backlash::EFFECT,
    &cogging::EFFECT,
    &elasticity::EFFECT,
    &rotor_inertia::EFFECT,
    &arm_inertia::EFFECT,
    &axis_coupling::EFFECT,
    &forearm_rod::EFFECT,
    &kt_scale::EFFECT,
    &base_tilt::EFFECT,
    &encoder_offset::EFFECT,
    &link_length::EFFECT,
    &payload::EFFECT,
    &payload_ecc::EFFECT,
    &torque_delay::EFFECT,
    &torque_saturation::EFFECT,
    &gravity_spring::EFFECT,
    &cable_spring::EFFECT,
    &air_drag::EFFECT,
    &ball_friction::EFFECT,
    &collision::EFFECT,
];

/// All effects.
pub fn registry() -> &'static [&'static Effect] {
    REGISTRY
}

/// The effect with a catalogue id; `None` for any other word (`unknown` is a verdict, not an effect).
pub fn find(id: &str) -> Option<&'static Effect> {
    REGISTRY.iter().copied().find(|e| e.id == id)
}
