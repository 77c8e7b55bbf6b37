//! Which rows count, and which are left out together.

use super::Scene;
use lacuna_estimation::stats;
use std::ops::Range;

/// Fewest folds; fewer recordings than this are cut.
pub const MIN_FOLDS: usize = 5;

impl Scene {
    /// Recordings of one number as a fold; without numbers whole recordings, too few of them cut.
    pub(super) fn make_folds(&self, recordings: usize, numbers: &[usize]) -> Vec<Range<usize>> {
        if numbers.len() == recordings && !numbers.is_empty() {
            let own = |n: usize| self.pieces.iter().filter(move |p| numbers.get(p.recording) == Some(&n));
            let ends = |n: usize| Some(own(n).next()?.rows.start..own(n).next_back()?.rows.end);
            return (0..=numbers.iter().copied().max().unwrap_or(0)).filter_map(ends).collect();
        }
        let mut whole: Vec<Range<usize>> = Vec::new();
        for r in 0..recordings {
            let mut own = self.pieces.iter().filter(|p| p.recording == r);
            if let Some(first) = own.next() {
                let end = own.next_back().map_or(first.rows.end, |p| p.rows.end);
                whole.push(first.rows.start..end);
            }
        }
        if whole.len() >= MIN_FOLDS {
            return whole;
        }
        // Too few recordings: cut them, the longer ones into more parts.
        let target = self.rows as f64 / (MIN_FOLDS + 1) as f64;
        let mut out = Vec::new();
        for r in whole {
            let parts = ((r.len() as f64 / target).round() as usize).max(1);
            for k in 0..parts {
                out.push(r.start + k * r.len() / parts..r.start + (k + 1) * r.len() / parts);
            }
        }
        out
    }

    /// Speed below which friction is in doubt: a small share of the typical speed, above the encoder's noise.
    pub(super) fn slow_speed(&self, j: usize) -> f64 {
        let mut speeds: Vec<f64> =
            self.pieces.iter().flat_map(|p| p.qd[j].iter().map(|v| v.abs())).filter(|v| *v > 1e-4).collect();
        let typical = stats::quantile_in_place(&mut speeds, 0.75);
        if typical.is_finite() { (0.04 * typical).clamp(1e-3, 0.05) } else { 0.05 }
    }

    /// Rows of joint `j` that count: drive on, faster than the slow speed, 25 ms away from slower samples.
    pub(super) fn moving(&self, j: usize) -> Vec<bool> {
        let margin = (0.025 * self.rate_hz).round() as usize;
        let edge = (3.0 * self.rate_hz / self.band_hz).round() as usize;
        let mut mask = vec![false; self.rows];
        for piece in &self.pieces {
            let n = piece.len();
            let mut ok = vec![true; n];
            for k in 0..n {
                if piece.qd[j][k].abs() < self.slow_rad_s[j] || !piece.enabled[k] {
                    ok[k.saturating_sub(margin)..(k + margin + 1).min(n)].fill(false);
                }
            }
            for (i, row) in piece.rows.clone().enumerate() {
                let k = i * self.stride;
                mask[row] = ok[k] && k >= edge && k + edge < n;
            }
        }
        mask
    }

    /// Rows count above these speeds from now on [rad/s].
    pub fn count_above(&mut self, slow_rad_s: &[f64]) {
        self.slow_rad_s = slow_rad_s.to_vec();
        self.mask = (0..self.joints).map(|j| self.moving(j)).collect();
    }
}
