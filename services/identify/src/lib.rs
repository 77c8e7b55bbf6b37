//! From recordings to a dynamic model that one can trust: parameters with intervals, an error on data that the fit has
//! not seen, and warnings in words.
//!
//! ```text
//! recordings ─ condition ─ rows (filtered regressor of the minimal set) ─ fit ─ held-out error, intervals ─ model.toml
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`condition`] | repair, regular sampling, filters, derivatives, masks (shared with the diagnosis) |
//! | [`columns`], [`base`], [`rows`] | the linear model, its minimal identifiable set, its filtered rows |
//! | [`fit`] | weighted robust fit with a covariance for correlated residuals |
//! | [`bristle`], [`delay`] | nuisances: Coulomb friction after a reversal, torque delay |
//! | [`consistent`] | links that could exist: positive definite pseudo-inertias |
//! | [`split`], [`evaluate`] | what is held out, and the error there |
//! | [`excite`] | trajectories after which the parameters are known best |
//! | [`paper`] | the founding paper's grid search and averages |
//! | [`outcome`] | the files and the data of the report |

mod account;
pub mod base;
pub mod bristle;
pub mod columns;
pub mod condition;
pub mod consistent;
pub mod delay;
pub mod evaluate;
pub mod excite;
pub mod fit;
mod hold_out;
mod identify;
mod options;
pub mod outcome;
pub mod paper;
pub mod rows;
pub mod split;
mod warnings;

pub use columns::Signal;
pub use delay::Delay;
pub use identify::{identify, identify_recordings};
pub use options::{Method, Options};
pub use outcome::{Identification, Outcome, ReportData, write};
pub use split::{FileRange, Holdout};
