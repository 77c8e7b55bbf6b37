//! The plant: the robot as it truly is. It shares no code with the estimator (`lacuna-physics`): other
//! derivations (Kane's method over bodies for the Delta, screw algebra in the base frame for chains), other
//! kinematics (trilateration), other friction (set-valued, solved in the time step). An error would have to
//! be made twice, in two different ways, to go unnoticed.

pub mod delta;
pub mod friction;
mod linalg;
mod mechanism;
pub mod robot;
pub mod serial;
mod step;
mod urdf;

pub use delta::Delta;
pub use linalg::JointMatrix;
pub use mechanism::{Dynamics, Loads, Mechanism, Unreachable};
pub use robot::TrueRobot;
pub use serial::Serial;
pub use step::Stepper;
