//! From recordings to a dynamic model that one can trust: parameters with intervals, an error on data that the fit has
//! not seen, and warnings in words.
//!
//! ```text
//! recordings ─ part by part: condition ─ rows (filtered regressor of the minimal set) ─ sums
//!                                                     sums ─ fits, held-out error, intervals ─ model.toml
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`condition`] | repair, regular sampling, filters, derivatives, masks (shared with the diagnosis) |
//! | [`columns`], [`base`] | the linear model and its minimal identifiable set |
//! | `stream`, `layout`, `sums` | filtered rows part by part, what is kept of each, sums over blocks of time |
//! | [`rows`] | all rows in memory, as a reference |
//! | [`fit`] | weighted robust fit with a covariance for correlated residuals |
//! | [`bristle`], [`delay`] | nuisances: Coulomb friction after a reversal, torque delay |
//! | [`consistent`] | links that could exist: positive definite pseudo-inertias |
//! | [`split`], [`evaluate`] | what is held out, and the error there |
//! | [`forward`] | the model simulated forward on held-out data |
//! | [`excite`] | trajectories after which the parameters are known best |
//! | [`paper`] | the founding paper's grid search and averages |
//! | [`replay`], [`payload`] | the stages offline: payload over time, the paper's Table 2 and Fig. 8 |
//! | [`urdf`] | identified inertials in the input URDF |
//! | [`outcome`] | the files and the data of the report |

mod account;
pub mod base;
pub mod bristle;
pub mod columns;
pub mod condition;
pub mod consistent;
mod curves;
pub mod delay;
pub mod evaluate;
pub mod excite;
pub mod fit;
pub mod forward;
mod hold_out;
mod identify;
mod layout;
mod options;
pub mod outcome;
pub mod paper;
mod paper_tables;
pub mod payload;
pub mod replay;
pub mod rows;
pub mod split;
mod stream;
mod sums;
pub mod urdf;
mod warnings;

pub use columns::Signal;
pub use delay::Delay;
pub use fit::{InstrumentCheck, InstrumentMotion, Instruments};
pub use identify::{identify, identify_recordings};
pub use options::{Method, Options};
pub use outcome::{Identification, Outcome, ReportData};
pub use split::{FileRange, Holdout};
