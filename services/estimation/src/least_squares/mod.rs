//! Linear least squares y = X β + e for long recordings.
//!
//! The data pass once, in blocks, into sufficient statistics; everything after that works on p × p matrices:
//!
//! | type | keeps | for |
//! |---|---|---|
//! | [`Gram`] | XᵀX, Xᵀy, yᵀy | speed; refuses a regressor whose condition number it cannot afford |
//! | [`Tsqr`] | R of X = QR | any condition number, about ten times slower |
//! | [`Moments`] | cross products of all columns | regressions among columns that are chosen later |
//! | [`BlockSums`] | one of them per block | cluster-robust covariance and block bootstrap without the data |
//!
//! [`accumulate`] fills blocks in parallel and sums them in block order, so the result does not depend on the
//! number of threads. [`base_parameters`] finds which columns the data tell apart.
//!
//! | symbol | meaning |
//! |---|---|
//! | X, y, β | regressor (rows × p), measurements, parameters |
//! | D | column scales, D_jj = ‖X_j‖: condition numbers are those of X D⁻¹ |
//! | σ² | residual variance ‖y − Xβ‖²/(rows − p) |
//!
//! Reference: Björck, Numerical Methods for Least Squares Problems (1996), sections 2.2, 2.4 and 6.4.

mod base;
mod blocks;
mod covariance;
mod gram;
mod moments;
mod robust;
mod solve;
mod tsqr;

pub use base::{BaseParameters, Dependent, Pivoting, base_parameters};
pub use blocks::{BlockSums, Bootstrap, Statistics, accumulate};
pub use covariance::{bartlett_bandwidth, newey_west};
pub use gram::Gram;
pub use moments::{CrossMoments, Mixture, Moments};
pub use robust::{Loss, RobustFit, robust};
pub use solve::{Fit, least_squares, weighted_least_squares};
pub use tsqr::Tsqr;

/// Largest condition number of the column-scaled regressor for which [`Gram`] is accepted: normal equations
/// lose its square, so at 1e5 six digits of β remain.
pub const GRAM_CONDITION_LIMIT: f64 = 1e5;

/// A column whose part that is independent of the others is below this fraction of its length is taken as dependent.
pub const RANK_TOLERANCE: f64 = 1e-8;
