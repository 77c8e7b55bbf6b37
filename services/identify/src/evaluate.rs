//! Error of a model on rows that it has not seen.
//!
//! ```text
//! relative error = √( Σ_j Σ_k (e_jk/s_j)² / Σ_j Σ_k (τ_jk/s_j)² )      s_j: standard deviation of τ_j in training
//! ```

use crate::rows::Rows;
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
    /// Adds joint `joint`'s residuals y − model on rows where `test` is true. `scale` is s_j.
    pub fn add(&mut self, rows: &Rows, joint: usize, model: &[f64], test: &[bool], which: Which, scale: f64) {
        if self.joints.len() <= joint {
            self.joints.resize(joint + 1, JointTally::default());
        }
        let sum = &mut self.joints[joint];
        let data = &rows.joints[joint];
        let mask = match which {
            Which::Counted => &data.counted,
            Which::Usable => &data.usable,
        };
        for k in 0..rows.len() {
            if !(test[k] && mask[k]) {
                continue;
            }
            let e = data.y[k] - model[k];
            sum.rows += 1.0;
            sum.error += e;
            sum.error_squared += e * e;
            sum.torque_squared += data.y[k] * data.y[k];
            sum.scaled_error_squared += e * e / (scale * scale);
            sum.scaled_torque_squared += data.y[k] * data.y[k] / (scale * scale);
        }
    }

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

/// Standard deviation of each joint's torque over usable training rows; 1 where there is none.
pub fn training_scale(rows: &Rows, train: &[bool]) -> Vec<f64> {
    rows.joints
        .iter()
        .map(|j| {
            let values: Vec<f64> = (0..rows.len()).filter(|&k| train[k] && j.usable[k]).map(|k| j.y[k]).collect();
            let sd = lacuna_estimation::stats::standard_deviation(&values);
            if sd.is_finite() && sd > 0.0 { sd } else { 1.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::JointRows;

    #[test]
    fn pooled_error_by_hand() {
        let joint = |y: [f64; 3]| JointRows {
            y: y.to_vec(),
            counted: vec![true, true, false],
            usable: vec![true; 3],
            ..JointRows::default()
        };
        let rows = Rows {
            joints: vec![joint([3.0, 4.0, 100.0]), joint([30.0, 40.0, 0.0])],
            time_s: vec![0.0, 1.0, 2.0],
            ..Rows::default()
        };
        let mut tally = Tally::default();
        tally.add(&rows, 0, &[3.0, 3.0, 0.0], &[true; 3], Which::Counted, 1.0);
        tally.add(&rows, 1, &[24.0, 40.0, 0.0], &[true; 3], Which::Counted, 10.0);
        let score = tally.score().unwrap();
        // e/s = (0, 1), (0.6, 0); τ/s = (3, 4), (3, 4).
        assert!((score.relative_error - (1.36f64 / 50.0).sqrt()).abs() < 1e-15);
        assert!((score.relative_error_per_joint[1] - 6.0 / 50.0).abs() < 1e-15);
        assert_eq!((score.mean_nm[0], score.rows[0]), (0.5, 2));
        assert!((score.std_nm[0] - 0.5).abs() < 1e-15);
        let mut all = Tally::default();
        all.add(&rows, 0, &[3.0, 3.0, 0.0], &[true; 3], Which::Usable, 1.0);
        assert_eq!(all.score().unwrap().rows, [3]);
        assert!(Tally::default().score().is_none());
    }
}
