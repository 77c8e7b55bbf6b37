//! Gradient boosting with shallow regression trees: the black box that named models are held against.
//!
//! Friedman 2001, Annals of Statistics 29, 1189-1232: squared loss, shrinkage, histograms of quantile bins.
//! Small and deterministic on purpose: the boosting crates that are kept up need a nightly compiler or bring
//! their own thread pools and memory probes.

/// Settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Trees.
    pub rounds: usize,
    /// Depth of each.
    pub depth: usize,
    /// Shrinkage.
    pub rate: f64,
    /// Fewest rows in a leaf.
    pub leaf: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { rounds: 70, depth: 4, rate: 0.15, leaf: 15 }
    }
}

/// Most bins of a feature.
const BINS: usize = 200;

/// Features in bins: `[feature][row]`.
#[derive(Debug, Clone)]
pub struct Binned {
    values: Vec<Vec<u8>>,
    rows: usize,
}

impl Binned {
    /// Bins features of equal length by their quantiles.
    pub fn new(features: &[Vec<f64>]) -> Self {
        let rows = features.iter().map(Vec::len).min().unwrap_or(0);
        let values = features
            .iter()
            .map(|f| {
                let mut sorted: Vec<f64> = f[..rows].to_vec();
                sorted.sort_by(f64::total_cmp);
                let mut edges: Vec<f64> = (1..BINS).filter_map(|b| sorted.get(b * rows / BINS).copied()).collect();
                edges.dedup();
                f[..rows].iter().map(|v| edges.partition_point(|e| e <= v) as u8).collect()
            })
            .collect();
        Self { values, rows }
    }
}

#[derive(Debug, Clone, Copy)]
enum Node {
    Leaf(f64),
    Split { feature: usize, bin: u8, left: usize, right: usize },
}

/// Predictions for all rows of a model fitted to the rows in `train`.
pub fn fit_predict(x: &Binned, y: &[f64], train: &[usize], settings: &Settings) -> Vec<f64> {
    let mut prediction = vec![0.0; x.rows];
    if train.is_empty() {
        return prediction;
    }
    let mean = train.iter().map(|r| y[*r]).sum::<f64>() / train.len() as f64;
    prediction.fill(mean);
    let mut rest: Vec<f64> = y.iter().map(|v| v - mean).collect();
    for _ in 0..settings.rounds {
        let mut nodes = Vec::new();
        grow(x, &rest, train.to_vec(), settings, settings.depth, &mut nodes);
        for row in 0..x.rows {
            let step = settings.rate * evaluate(&nodes, x, row);
            prediction[row] += step;
            rest[row] -= step;
        }
    }
    prediction
}

fn evaluate(nodes: &[Node], x: &Binned, row: usize) -> f64 {
    let mut at = 0;
    loop {
        match nodes[at] {
            Node::Leaf(v) => return v,
            Node::Split { feature, bin, left, right } => at = if x.values[feature][row] <= bin { left } else { right },
        }
    }
}

/// Grows a tree over `rows` and returns its index in `nodes`.
fn grow(x: &Binned, y: &[f64], rows: Vec<usize>, settings: &Settings, depth: usize, nodes: &mut Vec<Node>) -> usize {
    let total: f64 = rows.iter().map(|r| y[*r]).sum();
    let at = nodes.len();
    nodes.push(Node::Leaf(total / rows.len().max(1) as f64));
    if depth == 0 || rows.len() < 2 * settings.leaf {
        return at;
    }
    let Some((feature, bin)) = best_split(x, y, &rows, total, settings.leaf) else { return at };
    let (a, b): (Vec<usize>, Vec<usize>) = rows.into_iter().partition(|r| x.values[feature][*r] <= bin);
    let left = grow(x, y, a, settings, depth - 1, nodes);
    let right = grow(x, y, b, settings, depth - 1, nodes);
    nodes[at] = Node::Split { feature, bin, left, right };
    at
}

fn best_split(x: &Binned, y: &[f64], rows: &[usize], total: f64, leaf: usize) -> Option<(usize, u8)> {
    let n = rows.len() as f64;
    let mut best = (total * total / n * (1.0 + 1e-9) + 1e-30, None);
    for (feature, values) in x.values.iter().enumerate() {
        let mut sum = [0.0; 256];
        let mut count = [0u32; 256];
        for r in rows {
            let b = usize::from(values[*r]);
            sum[b] += y[*r];
            count[b] += 1;
        }
        let (mut s, mut c) = (0.0, 0u32);
        for bin in 0..=254u8 {
            s += sum[usize::from(bin)];
            c += count[usize::from(bin)];
            let other = rows.len() as u32 - c;
            if (c as usize) < leaf || (other as usize) < leaf {
                continue;
            }
            let gain = s * s / f64::from(c) + (total - s) * (total - s) / f64::from(other);
            if gain > best.0 {
                best = (gain, Some((feature, bin)));
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step in one feature and nothing in the other: held-out rows are predicted, noise is not learnt.
    #[test]
    fn learns_a_step_and_not_the_noise() {
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        let n = 3000;
        let a: Vec<f64> = (0..n).map(|_| random()).collect();
        let b: Vec<f64> = (0..n).map(|_| random()).collect();
        let noise: Vec<f64> = (0..n).map(|_| 0.2 * random()).collect();
        let y: Vec<f64> = (0..n).map(|i| if a[i] > 0.1 { 1.0 } else { -1.0 } + noise[i]).collect();
        let x = Binned::new(&[a, b]);
        let train: Vec<usize> = (0..n / 2).collect();
        let p = fit_predict(&x, &y, &train, &Settings::default());
        let rest = |y: &[f64]| (n / 2..n).map(|i| (y[i] - p[i]).powi(2)).sum::<f64>() / (n / 2) as f64;
        let noise_power = noise.iter().map(|v| v * v).sum::<f64>() / n as f64;
        assert!(rest(&y) < 2.0 * noise_power, "{} {noise_power}", rest(&y));
        let p = fit_predict(&x, &noise, &train, &Settings::default());
        let rest = (n / 2..n).map(|i| (noise[i] - p[i]).powi(2)).sum::<f64>() / (n / 2) as f64;
        assert!(rest > 0.95 * noise_power && rest < 1.4 * noise_power, "{rest} {noise_power}");
    }
}
