//! The catalogue of effects beyond the rigid body: friction in all its forms, compliance, drives, geometry,
//! payload, contact.
//!
//! An [`Effect`] is data plus one constructor, one file each under [`catalogue`], one line in its registry.
//! With its shape parameters fixed an effect becomes a [`Kernel`], which writes the torque **per unit of each
//! amplitude** at every sample. That one computation serves everything:
//!
//! | user | uses |
//! |---|---|
//! | streaming stages | [`build_terms`] → [`Terms::add_torque`]: kernel × amplitudes, sample by sample |
//! | identification, diagnosis | [`Effect::columns`]: the kernel along a recording, one column per amplitude |
//! | documentation | [`markdown`] |
//!
//! **Sign.** A torque is what the drive must *add* because of the effect: friction has the sign of the
//! velocity, a weight hung on the tip the sign that lifts it.
//!
//! **Order.** Effects at the link load the gear and so come first ([`Side::Link`]); then motor and gear
//! ([`Side::Transmission`]), which see the link's torque; then the drive's measurement of it ([`Side::Drive`]),
//! which sees the sum.
//!
//! **sgn θ̇** is never computed here: a joint at standstill has no direction, and what a caller makes of that
//! (a hard sign, a ramp, a bristle: [`DirectionLaw`]) must be one decision for all dry friction. Laws take it
//! from [`EffectSample::direction`].

pub mod catalogue;
mod columns;
mod compliance;
mod context;
mod direction;
mod document;
mod effect;
mod kernel;
mod legs;
mod specification;
mod term;

pub use catalogue::cogging::candidate_orders;
pub use catalogue::{find, registry};
pub use columns::{Columns, Track};
pub use context::EffectContext;
pub use direction::{Direction, DirectionLaw};
pub use document::markdown;
pub use effect::{Effect, Request};
pub use kernel::{ColumnSink, EffectSample, Kernel};
pub use specification::{Memory, OwningStage, ParameterSpec, Regime, Robots, Role, Scope, Side};
pub use term::{TermInput, TermState, Terms, build_terms};
