//! Takes the colour out of what a model leaves, so that evidence counts where the residual is quiet.
//!
//! The residual of a real robot is slow: few of its samples are independent, and plain least squares gives a sharp
//! law no more weight than a slow one of the same size. Generalised least squares weighs each frequency by what is
//! left there: torque and regressors go through the filter that makes the residual white, an autoregression per joint
//!
//! ```text
//! e_k = Σ_i a_i e_{k−i·lag} + ε_k ,  i = 1 … m ≤ ORDER
//! ```
//!
//! at a lag at which the band fills the Nyquist range (outside the band there is nothing to whiten). Behind a gap the
//! predictor of as many samples as there are takes its place, scaled to the same innovation (Levinson and Durbin), so
//! that no row is lost. Source: Brockwell and Davis 1991, section 5.2 (innovations); Aitken 1936.

use crate::scene::{Column, Scene};

/// Samples that a predictor looks back at most.
const ORDER: usize = 6;
/// Share of the power that is added as white noise: what is 30 dB below it is not whitened any further.
const RIDGE: f64 = 1e-3;
/// Row rate over band from which every row counts; below it rows are skipped.
const PER_BAND: f64 = 2.6;

/// A whitening filter per joint.
#[derive(Debug, Clone)]
pub struct Whitening {
    /// Rows from one sample of the predictor to the next.
    lag: usize,
    /// Per joint: predictors of 0 to [`ORDER`] samples with the scale of each; empty: the joint stays as it is.
    predictors: Vec<Vec<(Vec<f64>, f64)>>,
    /// Per joint and row: how many samples there are to look back at.
    back: Vec<Vec<u8>>,
}

impl Whitening {
    /// Of what is left at the rows of `scene`, for the joints in `coloured`.
    pub fn of(scene: &Scene, residual: &Column, coloured: &[bool]) -> Self {
        let lag = ((scene.row_rate_hz() / (PER_BAND * scene.band_hz)).round() as usize).max(1);
        let back: Vec<Vec<u8>> = (0..scene.joints).map(|j| reach(scene, j, lag)).collect();
        let predictors = (0..scene.joints)
            .map(|j| match (coloured.get(j), residual.part.get(j)) {
                (Some(true), Some(r)) if !r.is_empty() => levinson(&covariance(r, &back[j], lag)),
                _ => Vec::new(),
            })
            .collect();
        Self { lag, predictors, back }
    }

    /// A column's parts through the filter.
    pub fn apply(&self, part: &[Vec<f64>]) -> Vec<Vec<f64>> {
        part.iter().enumerate().map(|(j, rows)| self.joint(rows, j)).collect()
    }

    fn joint(&self, rows: &[f64], j: usize) -> Vec<f64> {
        let (Some(predictors), Some(back)) = (self.predictors.get(j).filter(|p| !p.is_empty()), self.back.get(j))
        else {
            return rows.to_vec();
        };
        let one = |(k, (x, m)): (usize, (&f64, &u8))| {
            let Some((a, scale)) = predictors.get(usize::from(*m)) else { return *x };
            let told: f64 = a.iter().enumerate().map(|(i, a)| a * rows[k - (i + 1) * self.lag]).sum();
            scale * (x - told)
        };
        rows.iter().zip(back).enumerate().map(one).collect()
    }
}

/// How many samples each row can look back at: those that count, in the same stretch and fold.
fn reach(scene: &Scene, j: usize, lag: usize) -> Vec<u8> {
    let mut out = vec![0u8; scene.rows];
    let mut begins: Vec<bool> = vec![false; scene.rows];
    for start in scene.pieces.iter().map(|p| p.rows.start).chain(scene.folds.iter().map(|f| f.start)) {
        if let Some(b) = begins.get_mut(start) {
            *b = true;
        }
    }
    // A row looks over no beginning: rows since the last one limit it.
    let mut since = 0;
    for row in 0..scene.rows {
        since = if begins[row] { 0 } else { since + 1 };
        if since >= lag && scene.mask[j][row] && scene.mask[j][row - lag] {
            out[row] = (out[row - lag] + 1).min(ORDER as u8);
        }
    }
    out
}

/// Mean products of rows `i` lags apart, i = 0 … [`ORDER`].
fn covariance(rows: &[f64], back: &[u8], lag: usize) -> Vec<f64> {
    let mut out = vec![0.0; ORDER + 1];
    let mut counts = vec![0.0f64; ORDER + 1];
    for (k, reach) in back.iter().enumerate() {
        // Pairs at each lag as often as there are: what is longer apart is rarer.
        for i in 1..=usize::from(*reach) {
            out[i] += rows[k] * rows[k - i * lag];
            counts[i] += 1.0;
        }
    }
    // Rows that nothing precedes count for the power as well.
    let all = rows.iter().filter(|r| **r != 0.0).count().max(1) as f64;
    let power = rows.iter().map(|r| r * r).sum::<f64>() / all * (1.0 + RIDGE);
    out[0] = power;
    for i in 1..=ORDER {
        // A taper keeps the sequence positive definite where few pairs are far apart.
        let taper = 1.0 - i as f64 / (4.0 * (ORDER + 1) as f64);
        out[i] = (out[i] / counts[i].max(1.0) * taper).clamp(-0.999 * power, 0.999 * power);
    }
    out
}

/// Predictors of 0, 1, … samples, each with the factor that brings its error to the size of the longest one's.
fn levinson(covariance: &[f64]) -> Vec<(Vec<f64>, f64)> {
    let Some((&power, _)) = covariance.split_first().filter(|(p, _)| **p > 0.0) else { return Vec::new() };
    let mut all: Vec<(Vec<f64>, f64)> = vec![(Vec::new(), power)];
    let (mut a, mut error): (Vec<f64>, f64) = (Vec::new(), power);
    for m in 1..covariance.len() {
        let told: f64 = a.iter().enumerate().map(|(i, a)| a * covariance[m - 1 - i]).sum();
        let reflection = (covariance[m] - told) / error;
        if !(reflection.abs() < 1.0) {
            break;
        }
        let next: Vec<f64> = (0..m - 1).map(|i| a[i] - reflection * a[m - 2 - i]).chain([reflection]).collect();
        a = next;
        error *= 1.0 - reflection * reflection;
        all.push((a.clone(), error));
    }
    let last = error;
    // Where the recursion had to end, longer reaches use the longest predictor there is.
    while all.len() < covariance.len() {
        all.push((a.clone(), error));
    }
    all.into_iter().map(|(a, e)| (a, (last / e).sqrt())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// x_k = 1.2 x_{k−1} − 0.5 x_{k−2} + ε_k: its covariance in closed form (Yule and Walker), its predictor known.
    #[test]
    fn the_predictor_of_a_second_order_process_is_its_own() {
        let (a, b) = (1.2, -0.5);
        let one = a / (1.0 - b);
        let mut rho = vec![1.0, one];
        while rho.len() <= ORDER {
            let k = rho.len();
            rho.push(a * rho[k - 1] + b * rho[k - 2]);
        }
        let all = levinson(&rho);
        assert_eq!(all.len(), ORDER + 1);
        let (last, scale) = &all[ORDER];
        assert!((last[0] - a).abs() < 1e-9 && (last[1] - b).abs() < 1e-9, "{last:?}");
        assert!(last[2..].iter().all(|v| v.abs() < 1e-9) && (scale - 1.0).abs() < 1e-12);
        // Without a past the scale is σ_ε/σ_x.
        let share = 1.0 - a * rho[1] - b * rho[2];
        assert!((all[0].1 - share.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_process_that_cannot_be_is_not_followed() {
        let all = levinson(&[1.0, 0.9, -0.9, 0.9, -0.9, 0.9, -0.9]);
        assert!(all.iter().all(|(a, s)| a.iter().all(|v| v.is_finite()) && s.is_finite()));
        assert!(levinson(&[0.0; 7]).is_empty());
    }
}
