//! Error of a model on rows that it has not seen.
//!
//! ```text
//! relative error = √( Σ_j Σ_k (e_jk/s_j)² / Σ_j Σ_k (τ_jk/s_j)² )      s_j: standard deviation of τ_j in training
//! ```

use serde::Serialize;

/// Sums over test rows, to be pooled over folds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tally {
    joints: Vec<JointTally>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct JointTally {
    rows: f64,
    error: f64,
    error_squared: f64,
    torque_squared: f64,
    scaled_error_squared: f64,
    scaled_torque_squared: f64,
}

/// Held-out error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Pooled over joints and folds.
    pub relative_error: f64,
    /// Per joint: ‖e‖/‖τ‖.
    pub relative_error_per_joint: Vec<f64>,
    /// Root mean square of the residual [Nm or the robot file's unit].
    pub rms_nm: Vec<f64>,
    /// Mean of the residual.
    pub mean_nm: Vec<f64>,
    /// Standard deviation of the residual.
    pub std_nm: Vec<f64>,
    /// Test rows per joint.
    pub rows: Vec<usize>,
}

/// Which rows of a joint enter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// Moving joints.
    Counted,
    /// All usable rows.
    Usable,
}

impl Tally {
    /// Adds sums over `rows` residuals of a joint: Σe, Σe² and Στ². `scale` is s_j.
    pub(crate) fn add_sums(
        &mut self,
        joint: usize,
        [rows, error, error_squared, torque_squared]: [f64; 4],
        scale: f64,
    ) {
        if self.joints.len() <= joint {
            self.joints.resize(joint + 1, JointTally::default());
        }
        let sum = &mut self.joints[joint];
        sum.rows += rows;
        sum.error += error;
        sum.error_squared += error_squared;
        sum.torque_squared += torque_squared;
        sum.scaled_error_squared += error_squared / (scale * scale);
        sum.scaled_torque_squared += torque_squared / (scale * scale);
    }

    /// The pooled score; `None` without a test row.
    pub fn score(&self) -> Option<Score> {
        let (e, t) =
            self.joints.iter().fold((0.0, 0.0), |(e, t), j| (e + j.scaled_error_squared, t + j.scaled_torque_squared));
        if t.is_nan() || t <= 0.0 {
            return None;
        }
        let each = |f: fn(&JointTally) -> f64| -> Vec<f64> {
            self.joints.iter().map(|j| if j.rows > 0.0 { f(j) } else { 0.0 }).collect()
        };
        Some(Score {
            relative_error: (e / t).sqrt(),
            relative_error_per_joint: each(|j| {
                if j.torque_squared > 0.0 { (j.error_squared / j.torque_squared).sqrt() } else { 0.0 }
            }),
            rms_nm: each(|j| (j.error_squared / j.rows).sqrt()),
            mean_nm: each(|j| j.error / j.rows),
            std_nm: each(|j| (j.error_squared / j.rows - (j.error / j.rows).powi(2)).max(0.0).sqrt()),
            rows: self.joints.iter().map(|j| j.rows as usize).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooled_error_by_hand() {
        // Residuals (0, 1) of torques (3, 4) at joint 1, (6, 0) of (30, 40) at joint 2, whose scale is 10.
        let mut tally = Tally::default();
        tally.add_sums(0, [2.0, 1.0, 1.0, 25.0], 1.0);
        tally.add_sums(1, [2.0, 6.0, 36.0, 2500.0], 10.0);
        let score = tally.score().unwrap();
        // e/s = (0, 1), (0.6, 0); τ/s = (3, 4), (3, 4).
        assert!((score.relative_error - (1.36f64 / 50.0).sqrt()).abs() < 1e-15);
        assert!((score.relative_error_per_joint[1] - 6.0 / 50.0).abs() < 1e-15);
        assert_eq!((score.mean_nm[0], score.rows[0]), (0.5, 2));
        assert!((score.std_nm[0] - 0.5).abs() < 1e-15);
        assert!(Tally::default().score().is_none());
    }
}
