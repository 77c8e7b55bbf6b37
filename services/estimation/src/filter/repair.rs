//! Repairs that say what they repaired: single-sample spikes, wrapped angles; and the running median.

use crate::error::EstimationError;
use crate::stats::{MAD_TO_SD, median_in_place, quantile_in_place};

/// When a sample counts as a spike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpikeRule {
    /// Distance from the mean of its neighbours, in robust standard deviations of that distance.
    pub threshold: f64,
    /// Smallest distance that counts, in the signal's unit (its resolution, say).
    pub floor: f64,
}

impl Default for SpikeRule {
    fn default() -> Self {
        Self { threshold: 8.0, floor: 0.0 }
    }
}

impl SpikeRule {
    /// For one signal: larger than `share` of its range (smaller ones are noise, or the corner of a trajectory) and than
    /// three steps of its resolution (a resting encoder that flickers by a step has none).
    pub fn of(x: &[f64], share: f64, threshold: f64) -> Self {
        // The range must not be that of the spikes; ten thousand samples know it well enough.
        let mut sorted: Vec<f64> = x.iter().copied().step_by(x.len() / 10_000 + 1).collect();
        let range = quantile_in_place(&mut sorted, 0.995) - quantile_in_place(&mut sorted, 0.005);
        let floor = (share * range).max(3.0 * resolution(x));
        Self { threshold, floor: if floor.is_finite() { floor } else { 0.0 } }
    }
}

/// Smallest step between neighbouring samples that is not zero; 0 for a constant signal.
fn resolution(x: &[f64]) -> f64 {
    let least = x.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

/// Half width [samples] of the stretch a spike is judged against.
const NEIGHBOURHOOD: usize = 25;

/// Indices of single-sample outliers, ascending.
///
/// With e_k = x_k − (x_{k−1} + x_{k+1})/2, sample k is a spike if abs e_k exceeds `threshold` robust standard
/// deviations of e, over the whole signal (a quarter of a million samples of it, evenly, where there are more) and
/// within 25 samples around, exceeds `floor`, is the largest of its neighbours', and if with the sample replaced its neighbours are no outliers any more: a step or a
/// burst is a fact of the recording, not a spike. The first and last sample are never spikes. Samples that
/// are not finite are spikes; they enter no statistic.
pub fn find_spikes(x: &[f64], rule: &SpikeRule) -> Vec<usize> {
    let n = x.len();
    if n < 5 {
        return Vec::new();
    }
    // Computed where needed: a copy of a long recording's column is no small matter.
    let e = |k: usize| if k == 0 || k + 1 >= n { 0.0 } else { x[k] - 0.5 * (x[k - 1] + x[k + 1]) };
    let step = (n - 2).div_ceil(MOST_SAMPLED);
    let global =
        robust_scale(&mut (1..n - 1).step_by(step).map(|k| e(k).abs()).filter(|v| v.is_finite()).collect::<Vec<_>>());
    let mut found = Vec::new();
    for k in 1..n - 1 {
        if !x[k].is_finite() {
            found.push(k);
            continue;
        }
        let size = e(k).abs();
        // A neighbour that is not finite makes e_k useless.
        if !size.is_finite() || size <= rule.floor || size <= rule.threshold * global {
            continue;
        }
        if size < e(k - 1).abs() || size < e(k + 1).abs() {
            continue;
        }
        let limit = rule.threshold * local_scale(&e, n, k).max(global);
        let mended = 0.5 * (x[k - 1] + x[k + 1]);
        let left = if k >= 2 { (x[k - 1] - 0.5 * (x[k - 2] + mended)).abs() } else { 0.0 };
        let right = if k + 2 < n { (x[k + 1] - 0.5 * (mended + x[k + 2])).abs() } else { 0.0 };
        // The mended neighbours may not stand out themselves: half the spike, for a step, would be left.
        let settled = left.max(right) <= limit.max(0.2 * size).min(0.35 * size);
        if size > limit && settled {
            found.push(k);
        }
    }
    found
}

/// Samples from which the scale of the whole signal is known well enough.
const MOST_SAMPLED: usize = 250_000;

/// Standard deviation from absolute deviations: 1.4826 × median, or from the 90 % point where most are zero.
fn robust_scale(size: &mut [f64]) -> f64 {
    let middle = MAD_TO_SD * median_in_place(size);
    if middle > 0.0 {
        return middle;
    }
    let upper = quantile_in_place(size, 0.9) / 1.645;
    if upper.is_finite() { upper } else { 0.0 }
}

fn local_scale(e: &impl Fn(usize) -> f64, len: usize, k: usize) -> f64 {
    let range = k.saturating_sub(NEIGHBOURHOOD)..(k + NEIGHBOURHOOD + 1).min(len);
    let mut size: Vec<f64> =
        range.filter(|i| i.abs_diff(k) > 1).map(|i| e(i).abs()).filter(|v| v.is_finite()).collect();
    robust_scale(&mut size)
}

/// Replaces the spikes of [`find_spikes`] by the mean of their neighbours and returns their indices.
pub fn remove_spikes(x: &mut [f64], rule: &SpikeRule) -> Vec<usize> {
    let spikes = find_spikes(x, rule);
    for &k in &spikes {
        x[k] = 0.5 * (x[k - 1] + x[k + 1]);
    }
    spikes
}

/// Running median over `window` samples (odd), the ends continued by their first and last value, as
/// `scipy.ndimage.median_filter(x, window, mode="nearest")`.
///
/// # Errors
/// [`EstimationError::Setting`] for an even window.
pub fn median_filter(x: &[f64], window: usize) -> Result<Vec<f64>, EstimationError> {
    if window.is_multiple_of(2) {
        let expected = "an odd number of samples";
        return Err(EstimationError::Setting { what: "median window", found: window as f64, expected });
    }
    if x.is_empty() {
        return Ok(Vec::new());
    }
    let half = window / 2;
    let at = |i: isize| x[i.clamp(0, x.len() as isize - 1) as usize];
    let mut sorted: Vec<f64> = (0..window).map(|i| at(i as isize - half as isize)).collect();
    sorted.sort_by(f64::total_cmp);
    let mut y = Vec::with_capacity(x.len());
    for k in 0..x.len() as isize {
        y.push(sorted[half]);
        let place = |v: f64, s: &[f64]| s.partition_point(|a| a.total_cmp(&v).is_lt());
        let (old, new) = (at(k - half as isize), at(k + half as isize + 1));
        let from = place(old, &sorted).min(window - 1);
        sorted.remove(from);
        let to = place(new, &sorted);
        sorted.insert(to, new);
    }
    Ok(y)
}

/// Makes an angle that wraps by `turn` (2π for rad) continuous, in place; returns the number of wraps removed.
/// A step of more than half a turn is a wrap; steps are taken between finite samples.
pub fn unwrap_angles(x: &mut [f64], turn: f64) -> usize {
    let mut wraps = 0;
    let mut offset = 0.0;
    let mut before: Option<f64> = None;
    for v in x.iter_mut().filter(|v| v.is_finite()) {
        let raw = *v;
        if let Some(last) = before {
            let turns = ((raw - last) / turn).round();
            if turns != 0.0 && turns.is_finite() {
                offset -= turns * turn;
                wraps += 1;
            }
        }
        before = Some(raw);
        *v = raw + offset;
    }
    wraps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn torque(n: usize) -> Vec<f64> {
        // Motion plus a fixed pseudo-noise.
        (0..n).map(|k| 5.0 * (k as f64 * 0.01).sin() + 0.02 * ((k * 7919 % 101) as f64 / 50.0 - 1.0)).collect()
    }

    #[test]
    fn spikes_are_found_and_nothing_else() {
        let clean = torque(2000);
        assert_eq!(find_spikes(&clean, &SpikeRule::default()), Vec::<usize>::new());
        let mut x = clean.clone();
        x[300] += 3.0;
        x[301 + 40] = 1e293;
        x[900] -= 0.5;
        x[1500] = f64::NAN;
        assert_eq!(remove_spikes(&mut x, &SpikeRule::default()), [300, 341, 900, 1500]);
        assert!(x.iter().zip(&clean).all(|(a, b)| (a - b).abs() < 0.05));
    }

    #[test]
    fn steps_bursts_and_resolution_are_no_spikes() {
        let mut step = torque(2000);
        step.iter_mut().skip(1000).for_each(|v| *v += 4.0);
        assert!(find_spikes(&step, &SpikeRule::default()).is_empty());
        let mut burst = torque(2000);
        burst[1000] += 3.0;
        burst[1001] += 3.0;
        assert!(find_spikes(&burst, &SpikeRule::default()).is_empty());
        let quantised: Vec<f64> = (0..500).map(|k| if k == 250 { 0.01 } else { 0.0 }).collect();
        assert!(find_spikes(&quantised, &SpikeRule { floor: 0.02, ..SpikeRule::default() }).is_empty());
        assert_eq!(find_spikes(&quantised, &SpikeRule::default()), [250]);
    }

    #[test]
    fn running_median_by_hand() {
        let y = median_filter(&[1.0, 9.0, 2.0, 3.0, 3.0, 0.0], 3).unwrap();
        assert_eq!(y, [1.0, 2.0, 3.0, 3.0, 3.0, 0.0]);
        assert!(median_filter(&[1.0], 2).is_err());
        assert_eq!(median_filter(&[1.0, 5.0], 7).unwrap(), [1.0, 5.0]);
    }

    #[test]
    fn angles_unwrap() {
        let truth: Vec<f64> = (0..200).map(|k| 8.0 * (k as f64 * 0.05).sin()).collect();
        let tau = std::f64::consts::TAU;
        let mut x: Vec<f64> = truth.iter().map(|v| v - tau * (v / tau).round()).collect();
        let wraps = unwrap_angles(&mut x, tau);
        assert!(wraps > 4);
        assert!(x.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
