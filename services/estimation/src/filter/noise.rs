//! How noisy a signal is, from its fast differences.
//!
//! The p-th difference of white noise of standard deviation σ has variance σ² C(2p, p); a smooth motion leaves
//! little in it once p is large enough. The MAD makes the estimate blind to spikes and jumps.

use crate::error::{EstimationError, all_finite};
use crate::stats::{MAD_TO_SD, mad, rms};

/// Standard deviation of the white part of `x`, from its differences of order 2, 3, …, 6: the first order
/// whose successor does not lower the estimate by a tenth. Signals that leak into low orders are so followed
/// up, and white noise is judged by the second difference, whose estimate scatters least.
///
/// # Errors
/// [`EstimationError`] for fewer than 16 samples or a sample that is not finite.
pub fn noise_sd(x: &[f64]) -> Result<f64, EstimationError> {
    let mut best = noise_sd_of_order(x, 2)?;
    for order in 3..=6 {
        let next = noise_sd_of_order(x, order)?;
        if next > 0.9 * best {
            break;
        }
        best = next;
    }
    Ok(best)
}

/// Standard deviation of the white part of `x`, from differences of one `order` (1 to 8). Where more than half
/// of the differences are equal (a quantised signal at rest), their root mean square replaces the MAD.
///
/// # Errors
/// [`EstimationError`] for fewer than 16 samples, a sample that is not finite or another order.
pub fn noise_sd_of_order(x: &[f64], order: usize) -> Result<f64, EstimationError> {
    if x.len() < 16 {
        return Err(EstimationError::TooShort { what: "noise estimate", found: x.len(), needed: 16 });
    }
    if !(1..=8).contains(&order) {
        return Err(EstimationError::Setting { what: "difference order", found: order as f64, expected: "1 to 8" });
    }
    all_finite("signal", x)?;
    let mut d = x.to_vec();
    for _ in 0..order {
        for k in 0..d.len() - 1 {
            d[k] = d[k + 1] - d[k];
        }
        d.pop();
    }
    // C(2p, p) = Π (p + i)/i
    let gain: f64 = (1..=order).map(|i| (order + i) as f64 / i as f64).product();
    let spread = MAD_TO_SD * mad(&d);
    Ok(if spread > 0.0 { spread } else { rms(&d) } / gain.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn gaussian(n: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        (0..n).map(|_| crate::stats::normal_quantile(rng.random_range(1e-12..1.0 - 1e-12))).collect()
    }

    #[test]
    fn white_noise_on_motion_with_spikes() {
        let mut x = gaussian(20_000, 3);
        for (k, v) in x.iter_mut().enumerate() {
            *v = *v * 1e-3 + (k as f64 * 0.02).sin();
            if k % 500 == 0 {
                *v += 1.0;
            }
        }
        let sd = noise_sd(&x).unwrap();
        assert!((sd / 1e-3 - 1.0).abs() < 0.05, "{sd}");
    }

    #[test]
    fn quantised_rest_is_not_noiseless() {
        let x: Vec<f64> = (0..100).map(|k| if k % 10 == 0 { 1e-5 } else { 0.0 }).collect();
        let sd = noise_sd_of_order(&x, 1).unwrap();
        assert!(sd > 1e-6 && sd < 1e-5, "{sd}");
        assert!(noise_sd(&[0.0; 15]).is_err());
    }
}
