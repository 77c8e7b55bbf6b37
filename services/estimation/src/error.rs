//! What the numerics refuse, with the numbers that show why.

use lacuna_interfaces::BadInput;
use thiserror::Error;

/// Input that a computation cannot use.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EstimationError {
    /// Two arrays that belong together differ in length.
    #[error("{what}: found {found} values; expected {expected}")]
    Length {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length it should have.
        expected: usize,
    },
    /// A setting outside its range.
    #[error("{what}: found {found}; expected {expected}")]
    Setting {
        /// Which setting.
        what: &'static str,
        /// Its value.
        found: f64,
        /// Its range, in words.
        expected: &'static str,
    },
    /// A sample that is NaN or infinite.
    #[error("{what}: sample {index} is {value}; expected a finite number")]
    NotFinite {
        /// Which signal.
        what: &'static str,
        /// 0-based index of the sample.
        index: usize,
        /// The value.
        value: f64,
    },
    /// Time that does not increase.
    #[error("time: sample {index} is at {found} s after {before} s; expected strictly increasing time")]
    Time {
        /// 0-based index of the later sample.
        index: usize,
        /// Its time.
        found: f64,
        /// The time of the sample before.
        before: f64,
    },
    /// Too little data for what is asked.
    #[error("{what}: found {found} samples; expected at least {needed}")]
    TooShort {
        /// The computation.
        what: &'static str,
        /// Samples given.
        found: usize,
        /// Samples needed.
        needed: usize,
    },
    /// Columns that the data do not tell apart.
    #[error(
        "regressor of {columns} columns has rank {rank} (condition number {condition:.1e}); \
         expected independent columns: take the base parameters first"
    )]
    RankDeficient {
        /// Columns given.
        columns: usize,
        /// Rank found.
        rank: usize,
        /// Condition number of the column-scaled regressor.
        condition: f64,
    },
    /// Normal equations would lose too many digits.
    #[error(
        "condition number {condition:.1e} of the scaled regressor is above {limit:.0e}, where normal equations \
         lose the digits that matter; expected the QR accumulator instead"
    )]
    IllConditioned {
        /// Condition number of the column-scaled regressor.
        condition: f64,
        /// Largest one accepted.
        limit: f64,
    },
}

impl From<EstimationError> for BadInput {
    fn from(e: EstimationError) -> Self {
        BadInput::new(e.to_string())
    }
}

pub(crate) fn same_length(what: &'static str, found: usize, expected: usize) -> Result<(), EstimationError> {
    if found == expected { Ok(()) } else { Err(EstimationError::Length { what, found, expected }) }
}

pub(crate) fn positive(what: &'static str, found: f64) -> Result<(), EstimationError> {
    if found.is_finite() && found > 0.0 {
        Ok(())
    } else {
        Err(EstimationError::Setting { what, found, expected: "a positive number" })
    }
}

pub(crate) fn all_finite(what: &'static str, x: &[f64]) -> Result<(), EstimationError> {
    match x.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(EstimationError::NotFinite { what, index, value: x[index] }),
        None => Ok(()),
    }
}

pub(crate) fn increasing(t: &[f64]) -> Result<(), EstimationError> {
    all_finite("time", t)?;
    match t.windows(2).position(|w| w[1] <= w[0]) {
        Some(i) => Err(EstimationError::Time { index: i + 1, found: t[i + 1], before: t[i] }),
        None => Ok(()),
    }
}
