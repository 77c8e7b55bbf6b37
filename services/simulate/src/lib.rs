//! Closed-loop recordings of a robot, with the truth behind them.
//!
//! [`simulate`] draws reference motions, lets a PD controller with nominal feed-forward follow them at 4 kHz
//! on a plant with friction, effects and sensor noise, and logs what a drive logs: motor encoders and the
//! executed torque. [`demo_delta`] makes the recordings of the project's demo.
//!
//! **The plant is a witness.** It shares no code with the estimator's equations (this crate does not depend
//! on `lacuna-physics`) and no derivation either; see [`plant`]. What both agree on, two independent ways
//! have found; a test holds them against each other and against Pinocchio.
//!
//! Deterministic by seed: every trajectory has random streams of its own, so neither the number of threads nor
//! the order of the work changes a bit.

pub mod case;
pub mod config;
pub mod control;
pub mod demo;
pub mod effects;
pub mod log;
pub mod oracle;
pub mod output;
pub mod plant;
pub mod random;
pub mod reference;
pub mod run;
mod simulation;
mod truth;
pub mod twin;

pub use case::{Case, CaseOptions, draw_case};
pub use config::SimulationConfig;
pub use demo::{Demo, demo_delta};
pub use effects::{TrueEffect, draw_effect};
pub use oracle::Oracle;
pub use output::{Manifest, ManifestFile, write_csv};
pub use simulation::{Simulation, simulate};
pub use truth::{BaseFriction, EffectTruth, EventTruth, NoiseTruth, Truth};
pub use twin::{Twin, TwinConfig, TwinReference};
