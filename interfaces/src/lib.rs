//! What Lacuna's parts agree on, and nothing else: the messages on the bus ([`wire`]), the files a user
//! writes ([`robot`], [`model`], [`graph`]), recordings in memory ([`recording`]) and the contract of a
//! stage ([`stage`]).
//!
//! There is no I/O here: every parser takes text, every type is plain data. Units are SI and stand in the
//! field names (`q_rad`, `qd_rad_s`, `qdd_rad_s2`, `tau_nm`); a robot file may declare that its torque
//! signal is a current or a voltage (`torque_unit`), then `tau_nm` holds that signal in that unit and every
//! report says so. A prismatic joint's `q_rad` is in metres and its `tau_nm` in newtons.

pub mod columns;
pub mod error;
pub mod ethercat;
pub mod graph;
pub mod model;
pub mod recording;
pub mod robot;
pub mod stage;
pub mod wire;

pub use error::BadInput;
pub use model::ModelFile;
pub use recording::{Recording, Repair, RepairKind};
pub use robot::RobotFile;
pub use stage::{Stage, StageContext};
pub use wire::{
    FrictionTorque, Header, JointMeasured, JointSmoothed, Joints, MAX_JOINTS, PayloadEstimate, ResidualWatch,
    TorqueModel, Wire, flag, region,
};
