//! Numerics shared by the stages and the offline tools: smoothing ([`kalman`]), zero-phase filters and signal
//! repair ([`filter`]), linear least squares ([`least_squares`]) and robust statistics ([`stats`]).
//!
//! Pure functions and state machines over slices: no I/O, no clock, no bus, no global state, and the same
//! input gives the same bytes whatever the number of threads. SI units; positions in rad stand for metres
//! where a joint is prismatic.

pub mod error;
pub mod filter;
pub mod kalman;
pub mod least_squares;
pub mod stats;

pub use error::EstimationError;
