//! Equations of motion and nothing else: no I/O, no bus, no clock.
//!
//! [`RigidBody`] is the one interface to a robot's mechanics; [`build`] makes it from a robot file. Behind it
//! stand [`Delta`] (three legs, translating platform: paper sections 2 and 3 in the corrected form) and
//! [`SerialChain`] (1 to 8 revolute or prismatic joints from DH rows or a URDF).
//!
//! Every model is linear in its dynamic parameters: τ = Y(q, q̇, q̈) π. The torque is computed directly,
//! the regressor Y by a path of its own, and the tests hold one against the other.
//!
//! Units are SI; a prismatic joint's "angle" is in metres and its "torque" in newtons.

pub mod delta;
pub mod effects;
pub mod rigid_body;
pub mod serial;

pub use delta::Delta;
pub use rigid_body::{Evaluation, Motion, Parameter, RigidBody, Tip, TipMotion, Unreachable, build, parameters_of};
pub use serial::SerialChain;

/// Vector in space.
pub type Vec3 = nalgebra::Vector3<f64>;
/// 3 × 3 matrix: a rotation, an inertia or a Delta's Jacobian.
pub type Mat3 = nalgebra::Matrix3<f64>;
