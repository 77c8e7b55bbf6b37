//! How much of what could be gained was gained.

use crate::hidden::{Hidden, norm};
use crate::said::Said;

/// Held-out residuals over all joints [Nm].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Improvement {
    /// Base model.
    pub before: f64,
    /// With the findings.
    pub after: f64,
    /// What the true model leaves.
    pub oracle: f64,
}

impl Improvement {
    /// `None` where the answer has no oracle.
    pub fn of(said: &Said, hidden: &Hidden) -> Option<Self> {
        let (held, n) = (&said.held_out, hidden.oracle_rms_nm.len());
        if n == 0 || held.after_rms_nm.len() != n || held.before_rms_nm.len() != n {
            return None;
        }
        Some(Self {
            before: norm(&held.before_rms_nm),
            after: norm(&held.after_rms_nm),
            oracle: norm(&hidden.oracle_rms_nm),
        })
    }

    /// Residual over the oracle's. The diagnosis compares in a band of its own choice, the oracle below 40 Hz: below
    /// 1 is possible.
    pub fn ratio(self) -> f64 {
        self.after / self.oracle
    }

    /// Share of the improvement that the true model would bring; NaN where it would bring next to none.
    pub fn share(self) -> f64 {
        let possible = self.before - self.oracle;
        if possible < 0.05 * self.before { f64::NAN } else { ((self.before - self.after) / possible).min(1.0) }
    }
}
