//! Random numbers by seed. The draws are written out here (uniform by 53 bits, normal by Box–Muller), so a
//! seed keeps its meaning whatever a random-number crate does to its distributions.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::f64::consts::TAU;

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Random {
    generator: Pcg64Mcg,
    spare: Option<f64>,
}

impl Random {
    /// The stream number `stream` of `seed`; different streams are unrelated, so that trajectories can be
    /// simulated in any order on any number of threads.
    pub fn new(seed: u64, stream: u64) -> Self {
        // SplitMix64's finaliser: neighbouring seeds and streams must not give neighbouring states.
        let mix = |mut z: u64| {
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        };
        let state = mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)) ^ stream.wrapping_mul(0xd134_2543_de82_ef95));
        Self { generator: Pcg64Mcg::seed_from_u64(state), spare: None }
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.generator.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Log-uniform in [low, high); both positive.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Uniform among 0 … n − 1; 0 for n = 0.
    pub fn index(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n.saturating_sub(1))
    }

    /// −1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        if let Some(z) = self.spare.take() {
            return z;
        }
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (TAU * self.unit()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::Random;

    #[test]
    fn normal_has_unit_variance_and_streams_differ() {
        let mut r = Random::new(7, 0);
        let z: Vec<f64> = (0..200_000).map(|_| r.normal()).collect();
        let mean = z.iter().sum::<f64>() / z.len() as f64;
        let var = z.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / z.len() as f64;
        let kurtosis = z.iter().map(|x| (x - mean).powi(4)).sum::<f64>() / z.len() as f64 / (var * var);
        assert!(mean.abs() < 0.01 && (var - 1.0).abs() < 0.01 && (kurtosis - 3.0).abs() < 0.06);
        assert_ne!(Random::new(7, 1).unit(), Random::new(7, 0).unit());
        assert_eq!(Random::new(7, 1).unit(), Random::new(7, 1).unit());
    }
}
