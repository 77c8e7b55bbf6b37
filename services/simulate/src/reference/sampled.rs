//! A reference given as samples: what a recording's own motion is replayed by.

use super::{Motion, Reference};
use crate::plant::Unreachable;
use lacuna_interfaces::{BadInput, MAX_JOINTS};

/// Natural cubic spline through the samples, per joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampled {
    t: Vec<f64>,
    /// Per joint: values and second derivatives at the knots.
    knots: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Sampled {
    /// From times [s] and joint-major positions [rad].
    ///
    /// # Errors
    /// [`BadInput`] if there are fewer than two samples, lengths differ, time does not rise, or values are
    /// not finite.
    pub fn new(t_s: &[f64], q_rad: &[Vec<f64>]) -> Result<Self, BadInput> {
        if t_s.len() < 2 || q_rad.is_empty() || q_rad.len() > MAX_JOINTS {
            return Err(BadInput::new(format!(
                "reference: found {} samples of {} joints; expected at least 2 samples of 1 to {MAX_JOINTS} joints",
                t_s.len(),
                q_rad.len()
            )));
        }
        if let Some(k) =
            t_s.windows(2).position(|w| !matches!(w[1].partial_cmp(&w[0]), Some(std::cmp::Ordering::Greater)))
        {
            return Err(BadInput::new(format!("reference: time does not rise at sample {}", k + 2)));
        }
        for (i, q) in q_rad.iter().enumerate() {
            if q.len() != t_s.len() || q.iter().any(|v| !v.is_finite()) {
                return Err(BadInput::new(format!(
                    "reference: joint {} has {} values; expected {} finite ones",
                    i + 1,
                    q.len(),
                    t_s.len()
                )));
            }
        }
        let start = t_s[0];
        let t: Vec<f64> = t_s.iter().map(|t| t - start).collect();
        let knots = q_rad.iter().map(|q| (q.clone(), second_derivatives(&t, q))).collect();
        Ok(Self { t, knots })
    }
}

/// Natural spline's second derivatives by the tridiagonal sweep.
fn second_derivatives(t: &[f64], q: &[f64]) -> Vec<f64> {
    let n = t.len();
    let mut m = vec![0.0; n];
    let mut carry = vec![0.0; n];
    for k in 1..n - 1 {
        let (h0, h1) = (t[k] - t[k - 1], t[k + 1] - t[k]);
        let diagonal = 2.0 * (h0 + h1) - h0 * carry[k - 1];
        carry[k] = h1 / diagonal;
        let rhs = 6.0 * ((q[k + 1] - q[k]) / h1 - (q[k] - q[k - 1]) / h0);
        m[k] = (rhs - h0 * m[k - 1]) / diagonal;
    }
    for k in (1..n - 1).rev() {
        m[k] -= carry[k] * m[k + 1];
    }
    m
}

impl Reference for Sampled {
    fn at(&self, t: f64) -> Result<Motion, Unreachable> {
        let mut motion = Motion::default();
        let last = self.t.len() - 1;
        let outside = t <= 0.0 || t >= self.t[last];
        let t = t.clamp(0.0, self.t[last]);
        let k = self.t.partition_point(|&x| x <= t).clamp(1, last);
        let h = self.t[k] - self.t[k - 1];
        let b = (t - self.t[k - 1]) / h;
        let a = 1.0 - b;
        for (i, (q, m)) in self.knots.iter().enumerate() {
            let (q0, q1, m0, m1) = (q[k - 1], q[k], m[k - 1], m[k]);
            motion.q[i] = a * q0 + b * q1 + ((a * a * a - a) * m0 + (b * b * b - b) * m1) * h * h / 6.0;
            if !outside {
                motion.qd[i] = (q1 - q0) / h + ((1.0 - 3.0 * a * a) * m0 + (3.0 * b * b - 1.0) * m1) * h / 6.0;
                motion.qdd[i] = a * m0 + b * m1;
            }
        }
        Ok(motion)
    }
}
