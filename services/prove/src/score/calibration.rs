//! Are probabilities what they say? Reliability in bins, and the expected calibration error
//! ECE = Σ n_b / n · abs(mean p_b − share right_b) (Naeini, Cooper, Hauskrecht 2015, AAAI).

use super::Judged;

/// Upper edges of the bins: fine where findings are.
const EDGES: [f64; 7] = [0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0];

/// Findings by what they say of their own probability.
#[derive(Debug, Clone, PartialEq)]
pub struct Reliability {
    /// Per bin: lower and upper edge, number, mean probability, number right.
    pub bins: Vec<(f64, f64, usize, f64, usize)>,
    /// Expected calibration error; NaN without a finding.
    pub error: f64,
}

impl Reliability {
    /// Of all named findings ("unknown" names nothing, and is left out).
    pub fn of<'a>(cases: impl Iterator<Item = &'a Judged>) -> Self {
        let pairs: Vec<(f64, bool)> = cases
            .flat_map(|c| &c.findings)
            .filter(|f| !f.unknown)
            .filter_map(|f| Some((f.probability.filter(|p| p.is_finite())?, f.right)))
            .collect();
        let mut bins = Vec::new();
        let mut low = 0.0;
        let mut error = if pairs.is_empty() { f64::NAN } else { 0.0 };
        for high in EDGES {
            let inside: Vec<&(f64, bool)> =
                pairs.iter().filter(|(p, _)| (*p >= low || low == 0.0) && (*p < high || high == 1.0)).collect();
            let count = inside.len();
            let mean = inside.iter().map(|(p, _)| p).sum::<f64>() / count.max(1) as f64;
            let right = inside.iter().filter(|(_, r)| *r).count();
            error += (count as f64 * mean - right as f64).abs() / pairs.len().max(1) as f64;
            bins.push((low, high, count, mean, right));
            low = high;
        }
        Self { bins, error }
    }
}
