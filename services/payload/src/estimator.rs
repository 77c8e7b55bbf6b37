//! Recursive least squares for one mass, with forgetting, step detection and an honest variance.

use crate::Config;
use crate::joint::Joint;

/// One joint's equation: residual = column · mass + error.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Row {
    pub joint: usize,
    /// φ [Nm/kg].
    pub column: f64,
    /// ΔT [Nm].
    pub residual: f64,
    /// τ as measured [Nm].
    pub torque: f64,
    /// 1/r [1/Nm²]; 0 while r is not known, and the row only starts it.
    pub weight: f64,
    /// r as the update uses it: wider for an outlier [Nm²].
    pub noise: f64,
}

/// Likelihood ratio above which another mass is believed: 5 standard deviations.
const STEP_RATIO: f64 = 25.0;
/// Share of the recent misfit that the other mass must explain.
const STEP_SHARE: f64 = 0.5;
/// Samples that must speak for it.
const STEP_SAMPLES: f64 = 5.0;
/// The long window's time constant, in those of the short one.
const LONG: f64 = 6.0;
/// Innovations beyond this many standard deviations are weighted down.
const HUBER: f64 = 3.0;
/// Default of `max_sd_kg`, as a share of the mass that would ask for the torque measured.
const KNOWN_SHARE: f64 = 0.03;
/// A column with less than this share of the usual square tells nothing of the mass.
const NO_COLUMN: f64 = 1e-4;
/// Time constant of that mass [s].
const SCALE_S: f64 = 1.0;
/// Blocks over which scores are compared with what independent errors would give, in forgetting times.
const BLOCK: f64 = 0.25;
/// Variance inflation before any block was seen, and the number of blocks that it outweighs.
const FIRST_INFLATION: f64 = 4.0;
const FIRST_BLOCKS: f64 = 2.0;
/// Blocks that the inflation remembers.
const MOST_BLOCKS: f64 = 20.0;

/// Exponentially forgotten sums over the last moments.
#[derive(Debug, Clone, Copy, Default)]
struct Window {
    /// Σ φ²/r.
    column: f64,
    /// Σ φΔT/r.
    product: f64,
    /// Σ ΔT²/r.
    residual: f64,
    samples: f64,
    rows: f64,
}

impl Window {
    fn forget(&mut self, keep: f64) {
        for sum in [&mut self.column, &mut self.product, &mut self.residual, &mut self.samples, &mut self.rows] {
            *sum *= keep;
        }
    }

    fn add(&mut self, row: &Row) {
        let weighted = row.residual * row.weight;
        self.column += row.column * row.column * row.weight;
        self.product += row.column * weighted;
        self.residual += row.residual * weighted;
        self.rows += 1.0;
    }
}

/// How much wider the mass scatters than independent errors would make it: the score Σ φe/r of a block has
/// the variance Σ φ²/r if errors are independent (the cluster-robust covariance, on the stream).
#[derive(Debug, Clone, Copy)]
struct Inflation {
    length_s: f64,
    elapsed_s: f64,
    score: f64,
    information: f64,
    blocks: f64,
    value: f64,
}

impl Inflation {
    fn new(length_s: f64) -> Self {
        let value = FIRST_INFLATION;
        Self { length_s, elapsed_s: 0.0, score: 0.0, information: 0.0, blocks: FIRST_BLOCKS, value }
    }

    /// At least 1: errors that happen to cancel do not make the mass better known.
    fn value(&self) -> f64 {
        self.value.max(1.0)
    }

    fn forget(&mut self, dt: f64) {
        self.elapsed_s += dt;
        if self.elapsed_s < self.length_s {
            return;
        }
        if self.information > 0.0 {
            // One block must not say more than ten usual ones: it may hold an undetected step.
            let ratio = (self.score * self.score / self.information).min(10.0 * self.value());
            self.blocks = (self.blocks + 1.0).min(MOST_BLOCKS);
            self.value += (ratio - self.value) / self.blocks;
        }
        self.drop_block();
    }

    fn drop_block(&mut self) {
        self.elapsed_s = 0.0;
        self.score = 0.0;
        self.information = 0.0;
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Estimator {
    forgetting_s: f64,
    detection_s: f64,
    max_sd_kg: Option<f64>,
    /// How long rows may stay away before a load could have changed unseen [s].
    patience_s: f64,
    prior_variance: f64,
    mass: f64,
    variance: f64,
    /// The last moments, short and long.
    windows: [Window; 2],
    inflation: Inflation,
    /// Step width, 1/σ over it, and what it leaves of the windows.
    factors: (f64, f64, [f64; 2]),
    /// Smoothed τ² and φ².
    scale: (f64, f64),
    since_row_s: f64,
}

impl Estimator {
    pub fn new(config: &Config) -> Self {
        let prior_variance = config.prior_sd_kg * config.prior_sd_kg;
        Self {
            forgetting_s: config.forgetting_s,
            detection_s: config.detection_s,
            max_sd_kg: config.max_sd_kg,
            patience_s: 2.0 * (config.detection_s + config.reversal_s),
            prior_variance,
            mass: 0.0,
            variance: prior_variance,
            windows: [Window::default(); 2],
            inflation: Inflation::new(BLOCK * config.forgetting_s),
            factors: (0.0, 1.0, [1.0; 2]),
            scale: (0.0, 0.0),
            since_row_s: 0.0,
        }
    }

    pub fn mass_kg(&self) -> f64 {
        self.mass
    }

    /// Standard deviation, correlation of the errors included.
    pub fn sd_kg(&self) -> f64 {
        (self.variance * self.inflation.value()).min(self.prior_variance).sqrt()
    }

    /// Square of the largest standard deviation with which the mass counts as known [kg²].
    fn max_variance(&self) -> f64 {
        let (torque, column) = self.scale;
        match self.max_sd_kg {
            Some(sd) => sd * sd,
            None if column > 0.0 => KNOWN_SHARE * KNOWN_SHARE * torque / column,
            None => 0.0,
        }
    }

    /// Fully correlated errors of a window count as one.
    fn window_inflation(&self, window: &Window) -> f64 {
        self.inflation.value().min(window.rows.max(1.0))
    }

    /// True if the mass is known, and would be from the last moments alone.
    pub fn supported(&self) -> bool {
        let most = self.max_variance();
        let tells = |w: &Window| w.samples >= STEP_SAMPLES && self.window_inflation(w) < most * w.column;
        let known = self.variance * self.inflation.value() < most;
        known && self.since_row_s <= self.patience_s && self.windows.iter().any(tells)
    }

    /// Time goes on by `dt`.
    #[inline]
    pub fn forget(&mut self, dt: f64) {
        if dt != self.factors.0 {
            let keep = |time_s: f64| (-dt / time_s).exp();
            let windows = [keep(self.detection_s), keep(LONG * self.detection_s)];
            self.factors = (dt, (dt / self.forgetting_s).exp(), windows);
        }
        self.variance = (self.variance * self.factors.1).min(self.prior_variance);
        for (window, keep) in self.windows.iter_mut().zip(self.factors.2) {
            window.forget(keep);
        }
        self.inflation.forget(dt);
        self.since_row_s += dt;
        if self.since_row_s > self.patience_s {
            // What comes after a pause must speak for itself: the load may have changed meanwhile.
            self.windows = [Window::default(); 2];
        }
    }

    /// Takes in a sample's rows; true if the mass changed abruptly.
    #[inline]
    pub fn update(&mut self, rows: &mut [Row], joints: &mut [Joint], dt: f64) -> bool {
        let (mut count, mut torque, mut column, mut largest) = (0.0, 0.0, 0.0, 0.0_f64);
        for row in rows.iter_mut() {
            let joint = &mut joints[row.joint];
            if !joint.known() {
                joint.start_noise(row.residual);
                continue;
            }
            row.weight = 1.0 / joint.variance();
            self.windows.iter_mut().for_each(|w| w.add(row));
            count += 1.0;
            torque += row.torque * row.torque;
            column += row.column * row.column;
            largest = largest.max(row.column * row.column);
        }
        if count == 0.0 {
            return false;
        }
        let rate = if self.scale.1 == 0.0 { 1.0 } else { count * (dt / SCALE_S).min(0.1) };
        let usual = self.scale.1;
        self.scale.0 += rate * (torque / count - self.scale.0);
        self.scale.1 += rate * (column / count - self.scale.1);
        if largest <= NO_COLUMN * usual {
            return false;
        }
        self.windows.iter_mut().for_each(|w| w.samples += 1.0);
        self.since_row_s = 0.0;
        let stepped = self.windows.iter().find_map(|w| self.other_mass(w));
        if let Some(mass) = stepped {
            self.mass = mass;
            self.variance = self.prior_variance;
            self.windows = [Window::default(); 2];
            self.inflation.drop_block();
        }
        let informed = self.variance < 0.01 * self.prior_variance;
        // All rows are weighed against what was known before the sample: the joints have no order.
        for row in rows.iter_mut().filter(|r| r.weight > 0.0) {
            self.weigh(row, &mut joints[row.joint], informed, dt);
        }
        for row in rows.iter().filter(|r| r.weight > 0.0) {
            self.take(row);
        }
        stepped.is_some()
    }

    /// What a row's error is taken for: its joint's noise, or more if it lies far out (Huber).
    #[inline]
    fn weigh(&mut self, row: &mut Row, joint: &mut Joint, informed: bool, dt: f64) {
        row.noise = joint.variance();
        if !informed {
            return;
        }
        let innovation = row.residual - row.column * self.mass;
        let square_column = row.column * row.column;
        let inverse = 1.0 / (row.noise + square_column * self.variance);
        let mut score = row.column * innovation * row.weight;
        self.inflation.information += square_column * row.weight;
        joint.track_noise(innovation, row.noise * inverse, dt);
        let square = innovation * innovation * inverse;
        if square > HUBER * HUBER {
            let outlying = square.sqrt() / HUBER;
            score /= outlying;
            row.noise *= outlying;
        }
        self.inflation.score += score;
    }

    /// One row of recursive least squares.
    #[inline]
    fn take(&mut self, row: &Row) {
        let innovation = row.residual - row.column * self.mass;
        let inverse = 1.0 / (row.noise + row.column * row.column * self.variance);
        self.mass += self.variance * row.column * inverse * innovation;
        // (1 − Kφ) P without the cancellation.
        self.variance *= row.noise * inverse;
    }

    /// The mass that the window alone gives, if it is believed more than the estimate.
    #[inline]
    fn other_mass(&self, window: &Window) -> Option<f64> {
        // explained = score²/column is what the misfit falls by with the window's own mass; compared without
        // dividing, since this runs on every sample.
        let score = window.product - window.column * self.mass;
        let noise = window.column * (1.0 + window.column * self.variance) * self.window_inflation(window);
        if score * score <= STEP_RATIO * noise || window.samples < STEP_SAMPLES {
            return None;
        }
        let change = score / window.column;
        let explained = score * change;
        let misfit = window.residual - (2.0 * window.product - window.column * self.mass) * self.mass;
        let believed = change * change >= self.max_variance() && explained >= STEP_SHARE * misfit;
        believed.then_some(self.mass + change)
    }
}
