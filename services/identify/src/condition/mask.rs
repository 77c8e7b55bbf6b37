//! Which samples say something about the model.

use super::Plan;
use lacuna_physics::effects::{Direction, DirectionLaw};
use serde::Serialize;

/// A torque signal that stays at its largest value: the drive's limit, or a clipped measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Saturation {
    /// Level [Nm or the robot file's unit].
    pub level: f64,
    /// Samples at the level.
    pub samples: usize,
    /// Their share of the recording.
    pub share: f64,
}

/// Shortest run at the limit that counts as clipping [samples].
const CLIP_RUN: usize = 4;
/// Runs at the limit that make it a limit: a signal has one largest value, but reaches a limit again and again.
const CLIP_RUNS: usize = 3;
/// How close to the largest value a sample must be, as a share of it.
const CLIP_BAND: f64 = 1e-3;

/// Looks for a torque limit: at least three runs of at least four samples within 0.1 % of the largest magnitude, and
/// twice as many samples there as in the 0.9 % below. (The peaks of a smooth signal have less than half as many.)
pub fn saturation(tau: &[f64]) -> Option<Saturation> {
    let level = tau.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    if level == 0.0 || !level.is_finite() {
        return None;
    }
    let (mut runs, mut samples) = (0, 0);
    for range in runs_at(tau, level) {
        runs += 1;
        samples += range.len();
    }
    let below = tau.iter().filter(|v| (0.99..1.0 - CLIP_BAND).contains(&(v.abs() / level))).count();
    // A signal that hardly changes is always at its largest value.
    let share = samples as f64 / tau.len() as f64;
    (runs >= CLIP_RUNS && share < 0.5 && samples > 2 * below).then_some(Saturation { level, samples, share })
}

fn runs_at(tau: &[f64], level: f64) -> Vec<std::ops::Range<usize>> {
    let at = |v: f64| v.abs() >= level * (1.0 - CLIP_BAND);
    let mut runs = Vec::new();
    let mut start = None;
    for k in 0..=tau.len() {
        let inside = k < tau.len() && at(tau[k]) && start.is_none_or(|s: usize| tau[s].signum() == tau[k].signum());
        match (inside, start) {
            (true, None) => start = Some(k),
            (false, Some(s)) => {
                if k - s >= CLIP_RUN {
                    runs.push(s..k);
                }
                start = None;
            }
            _ => {}
        }
    }
    runs
}

/// Samples at the torque limit, and `pad` samples around them: the filters carry them over.
pub(super) fn clipped(tau: &[f64], limit: Option<&Saturation>, pad: usize) -> Vec<bool> {
    let mut bad = vec![false; tau.len()];
    if let Some(limit) = limit {
        for range in runs_at(tau, limit.level) {
            bad[range].fill(true);
        }
        bad = widened(&bad, pad);
    }
    bad
}

/// (counted, fitted): the drive is on and the joint moves; and besides, the torque is not at its limit and no slow
/// motion is closer than `plan.reversal_s`. With a moving speed of 0 the joint need not move.
pub(super) fn moving(
    velocity: &[f64],
    usable: &[bool],
    clipped: &[bool],
    plan: &Plan,
    rate_hz: f64,
) -> (Vec<bool>, Vec<bool>) {
    let slow: Vec<bool> = velocity.iter().map(|v| v.abs() <= plan.moving_rad_s && plan.moving_rad_s > 0.0).collect();
    let counted: Vec<bool> = slow.iter().zip(usable).map(|(s, u)| !s && *u).collect();
    let left_out: Vec<bool> = slow.iter().zip(usable).map(|(s, u)| *s || !u).collect();
    let near = widened(&left_out, (plan.reversal_s * rate_hz).round() as usize);
    let fitted = near.iter().zip(clipped).map(|(n, c)| !(*n || *c)).collect();
    (counted, fitted)
}

/// `flags` with every set stretch extended by `pad` samples on both sides.
fn widened(flags: &[bool], pad: usize) -> Vec<bool> {
    let mut out = flags.to_vec();
    let mut last: Option<usize> = None;
    for k in 0..flags.len() {
        if flags[k] {
            last = Some(k);
        }
        out[k] |= last.is_some_and(|l| k - l <= pad);
    }
    let mut next: Option<usize> = None;
    for k in (0..flags.len()).rev() {
        if flags[k] {
            next = Some(k);
        }
        out[k] |= next.is_some_and(|n| n - k <= pad);
    }
    out
}

/// Direction of sliding at every `step`-th sample by `law`, averaged over the `step` samples around, so that a reversal
/// between two working samples counts with its share.
pub(super) fn direction(q: &[f64], velocity: &[f64], law: DirectionLaw, step: usize) -> Vec<f64> {
    let mut state = Direction::new(law);
    let at: Vec<f64> = q.iter().zip(velocity).map(|(q, v)| state.step(*q, *v)).collect();
    let half = step / 2;
    (0..at.len())
        .step_by(step)
        .map(|k| {
            let (low, high) = (k.saturating_sub(half), (k + half).min(at.len() - 1));
            let mut sum = 0.0;
            let mut weights = 0.0;
            for (i, value) in at.iter().enumerate().take(high + 1).skip(low) {
                // Trapezoid for an even step: the samples half a step away belong to two working samples.
                let w = if step.is_multiple_of(2) && (i + half == k || i == k + half) { 0.5 } else { 1.0 };
                sum += w * value;
                weights += w;
            }
            sum / weights
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_found_and_a_peak_is_not() {
        let sine: Vec<f64> = (0..4000).map(|k| 3.0 * (k as f64 * 0.01).sin()).collect();
        assert_eq!(saturation(&sine), None);
        let clipped: Vec<f64> = sine.iter().map(|v| v.clamp(-2.2, 2.2)).collect();
        let found = saturation(&clipped).unwrap();
        assert_eq!(found.level, 2.2);
        // abs(3 sin x) > 2.2 for 1 − 2/π asin(2.2/3) = 47.6 % of the time.
        assert!((found.share - 0.476).abs() < 0.02, "{found:?}");
        assert!(saturation(&vec![1.0; 100]).is_none());
        assert!(saturation(&[]).is_none());
    }

    #[test]
    fn widening_reaches_both_ways() {
        let mut flags = vec![false; 9];
        flags[4] = true;
        assert_eq!(widened(&flags, 2), [false, false, true, true, true, true, true, false, false]);
        assert_eq!(widened(&flags, 0), flags);
    }

    #[test]
    fn direction_averages_over_the_step() {
        let v = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
        // Around sample 4 with step 4: ½(−1) + 1 + 1 + 1 + ½(1) over 4.
        assert_eq!(direction(&v, &v, DirectionLaw::Sign, 4), [-1.0, 0.75, 1.0]);
        let ramp = DirectionLaw::Ramp { width_rad_s: 0.01 };
        assert_eq!(direction(&[0.0; 2], &[0.005, -0.02], ramp, 1), [0.5, -1.0]);
    }
}
