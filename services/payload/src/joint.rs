//! What the estimator keeps per joint: whether it slides, and how noisy its torque balance is.

/// Innovations beyond this many standard deviations do not make the noise estimate grow further.
const CLIP: f64 = 3.0;
/// Time constant of the noise estimate [s].
const NOISE_S: f64 = 1.0;
/// Rows whose differences start the noise estimate where the model tells none.
const FIRST_ROWS: u32 = 30;
/// Noise before anything is known [Nm²]; only relative sizes matter then, and no mass is called known.
const UNKNOWN: f64 = 1.0;

/// One joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Joint {
    last_qd: f64,
    /// Time since the joint last stood or reversed [s].
    sliding_s: f64,
    /// Variance r of the innovation [Nm²].
    variance: f64,
    /// Differences still needed before `variance` means anything.
    missing: u32,
    /// Sum of squared differences of the residual so far, and the residual before.
    differences: f64,
    last_residual: Option<f64>,
}

impl Joint {
    /// `sd_nm` is the model file's residual noise, if it holds one.
    pub fn new(sd_nm: Option<f64>) -> Self {
        let known = sd_nm.filter(|sd| sd.is_finite() && *sd > 0.0);
        Self {
            last_qd: 0.0,
            sliding_s: 0.0,
            variance: known.map_or(UNKNOWN, |sd| sd * sd),
            missing: if known.is_some() { 0 } else { FIRST_ROWS },
            differences: 0.0,
            last_residual: None,
        }
    }

    /// A stretch begins: what was before says nothing about the motion now.
    pub fn start(&mut self) {
        self.last_qd = 0.0;
        self.sliding_s = 0.0;
        self.last_residual = None;
    }

    /// True if the joint slides, did so for `margin_s` and will for as long at its present deceleration.
    #[inline]
    pub fn slides(&mut self, qd: f64, standing: bool, dt: f64, margin_s: f64) -> bool {
        let change = qd - self.last_qd;
        let reversed = self.last_qd * qd <= 0.0;
        self.last_qd = if qd.is_finite() { qd } else { 0.0 };
        if standing || reversed || !qd.is_finite() {
            self.sliding_s = 0.0;
            return margin_s == 0.0 && !standing && qd.is_finite();
        }
        self.sliding_s += dt;
        // Time to standstill qd/−q̈ with q̈ = change/dt, compared without dividing.
        let stops_soon = change * qd < 0.0 && qd.abs() * dt < margin_s * change.abs();
        let slides = self.sliding_s >= margin_s && !stops_soon;
        if !slides {
            self.last_residual = None;
        }
        slides
    }

    /// Variance r of the innovation [Nm²].
    #[inline]
    pub fn variance(&self) -> f64 {
        self.variance
    }

    /// True once r means something.
    pub fn known(&self) -> bool {
        self.missing == 0
    }

    /// Until r is known: learns it from differences of successive residuals, which no payload enters.
    pub fn start_noise(&mut self, residual: f64) {
        if let Some(last) = self.last_residual.replace(residual) {
            self.differences += (residual - last) * (residual - last);
            self.missing -= 1;
            if self.missing == 0 {
                // var(e_k − e_{k−1}) = 2r for independent errors.
                let mean = self.differences / f64::from(FIRST_ROWS);
                self.variance = (0.5 * mean).max(f64::MIN_POSITIVE);
            }
        }
    }

    /// Tracks r with an innovation of the predicted variance r + φ²P; `share` = r/(r + φ²P).
    #[inline]
    pub fn track_noise(&mut self, innovation: f64, share: f64, dt: f64) {
        let square = (innovation * innovation * share).min(CLIP * CLIP * self.variance);
        let rate = (dt / NOISE_S).min(0.1);
        self.variance = (self.variance + rate * (square - self.variance)).max(f64::MIN_POSITIVE);
    }
}
