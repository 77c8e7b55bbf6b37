//! Kalman smoothing of joint positions: θ, θ̇, θ̈ and their standard deviations from measured θ.
//!
//! Every joint is a chain of N integrators driven by white noise w of intensity q, observed through its
//! position (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.3; the paper's section 4 uses the same model):
//!
//! ```text
//! x = (θ, θ̇, …),  x⁽ᴺ⁾ = w,  E[w(t) w(s)] = q δ(t − s),  z_k = θ(t_k) + v_k,  E[v²] = r
//! F_ij = dt^(j−i)/(j−i)!,   Q_ij = q dt^(2N−1−i−j) / ((N−1−i)! (N−1−j)! (2N−1−i−j))      (i, j from 0)
//! filter    P⁻ = F P Fᵀ + Q,  K = P⁻Hᵀ/(H P⁻Hᵀ + r),  x = x⁻ + K (z − H x⁻)
//! smoother  C = P Fᵀ (P⁻)⁻¹,  x_s = x + C (x_s⁺ − F x),  P_s = (I − CF) P (I − CF)ᵀ + C (P_s⁺ + Q) Cᵀ
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | N | 3: constant acceleration (white jerk); 4: constant jerk (white snap) | – |
//! | q | noise intensity of the highest derivative | rad²/s⁵ (N = 3), rad²/s⁷ (N = 4) |
//! | r | variance of the position measurement | rad² |
//! | P, P_s | covariance of the filtered and of the smoothed state | |
//! | C | smoother gain (Rauch, Tung, Striebel 1965) | |
//!
//! **One core, used both ways.** `gain` turns a time step into the numbers (K, C, …), which do not depend on
//! the data and are shared by all joints of equal q/r. [`smooth`] runs them forward and backward over a
//! recording; [`FixedLag`] runs the same steps on a stream and gives each sample the future it can wait for.
//!
//! **Irregular sampling is exact**: F, Q, K and C follow every step. Where steps repeat (see
//! [`Settings::period_tolerance`]) and P has converged, the step's numbers are kept and reused: that is the
//! steady-state path, which differs from the exact one only by the convergence tolerance (1e-11 in P).
//!
//! **Start.** Nothing is assumed of the first state: the first N samples are fused in information form with
//! priors of [`PRIOR_SD`], far beyond any robot, so there is no large covariance to cancel digits.

mod gain;
mod lanes;
mod likelihood;
mod maps;
mod model;
mod offline;
mod small;
mod stream;
mod window;

pub use likelihood::{NoiseEstimate, estimate_noise, log_likelihood};
pub use offline::{smooth, smooth_blocks, smooth_into};
pub use stream::{FixedLag, LagEstimate};

use crate::error::{EstimationError, positive};
use serde::{Deserialize, Serialize};

/// Standard deviations of θ̇ [rad/s], θ̈ [rad/s²], θ⃛ [rad/s³] before the first sample (θ itself is unknown).
pub const PRIOR_SD: [f64; 3] = [1e3, 1e6, 1e9];

/// Which derivative of the position is driven by white noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionModel {
    /// State (θ, θ̇, θ̈), white jerk.
    #[default]
    ConstantAcceleration,
    /// State (θ, θ̇, θ̈, θ⃛), white snap.
    ConstantJerk,
}

impl MotionModel {
    /// Number of states N.
    pub fn order(self) -> usize {
        match self {
            Self::ConstantAcceleration => 3,
            Self::ConstantJerk => 4,
        }
    }
}

/// How the filter's covariance takes in a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CovarianceUpdate {
    /// (I − KH) P⁻ (I − KH)ᵀ + K r Kᵀ: a sum of positive parts, stays positive definite (Joseph 1968).
    #[default]
    Joseph,
    /// P⁻ − K S Kᵀ: cheaper, loses digits when r is far below P⁻.
    Subtractive,
}

/// Noise of one joint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Intensity q of the highest derivative [rad²/s⁵ or rad²/s⁷].
    pub process: f64,
    /// Standard deviation √r of the position measurement [rad].
    pub measurement_sd: f64,
}

impl Noise {
    /// The noise with which the smoother passes motion up to `bandwidth_hz`.
    ///
    /// Sampled every `period_s`, the two-sided smoother is the zero-phase low-pass
    /// abs H(ω) = 1/(1 + (ω/ω_c)^2N) with ω_c^2N = q/(r · period) (well below the sampling rate), so
    /// q = (2π bandwidth)^2N r period puts abs H = 1/2 at `bandwidth_hz`.
    pub fn from_bandwidth(model: MotionModel, bandwidth_hz: f64, measurement_sd: f64, period_s: f64) -> Self {
        let omega = std::f64::consts::TAU * bandwidth_hz;
        let process = omega.powi(2 * model.order() as i32) * measurement_sd * measurement_sd * period_s;
        Self { process, measurement_sd }
    }

    /// q/r, on which alone the gains depend.
    pub(crate) fn ratio(&self) -> f64 {
        self.process / (self.measurement_sd * self.measurement_sd)
    }

    /// The frequency [Hz] at which the smoother halves the amplitude; inverse of [`Noise::from_bandwidth`].
    pub fn bandwidth_hz(&self, model: MotionModel, period_s: f64) -> f64 {
        (self.ratio() / period_s).powf(0.5 / model.order() as f64) / std::f64::consts::TAU
    }
}

/// What a smoother needs to know.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Motion model, the same for all joints.
    pub model: MotionModel,
    /// Noise per joint.
    pub noise: Vec<Noise>,
    /// A step longer than this [s] starts anew: nothing is carried across.
    pub gap_s: f64,
    /// Steps that differ from the period by less than this fraction of it use the period's gains; the motion
    /// itself is always carried over the true step.
    pub period_tolerance: f64,
    /// Covariance update.
    pub update: CovarianceUpdate,
    /// Reuse gains where steps repeat; `false` computes every step anew (the exact path, for checks).
    pub steady_state: bool,
}

impl Settings {
    /// Settings with the defaults: constant acceleration, no gap detection, tolerance 1e-4, Joseph, steady state on.
    pub fn new(model: MotionModel, noise: Vec<Noise>) -> Self {
        Self {
            model,
            noise,
            gap_s: f64::INFINITY,
            period_tolerance: 1e-4,
            update: CovarianceUpdate::Joseph,
            steady_state: true,
        }
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`EstimationError::Setting`] for a value outside its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        if self.noise.is_empty() {
            return Err(EstimationError::Length { what: "noise per joint", found: 0, expected: 1 });
        }
        for n in &self.noise {
            positive("process noise", n.process)?;
            positive("measurement standard deviation", n.measurement_sd)?;
        }
        if self.gap_s.is_nan() || self.gap_s <= 0.0 {
            return Err(EstimationError::Setting { what: "gap_s", found: self.gap_s, expected: "a positive number" });
        }
        if !(0.0..0.1).contains(&self.period_tolerance) {
            return Err(EstimationError::Setting {
                what: "period tolerance",
                found: self.period_tolerance,
                expected: "a fraction from 0 to below 0.1",
            });
        }
        Ok(())
    }
}

/// A smoothed recording, joint-major like the recording itself: `q_rad[joint][sample]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Smoothed {
    /// Position θ [rad].
    pub q_rad: Vec<Vec<f64>>,
    /// Velocity θ̇ [rad/s].
    pub qd_rad_s: Vec<Vec<f64>>,
    /// Acceleration θ̈ [rad/s²].
    pub qdd_rad_s2: Vec<Vec<f64>>,
    /// Index of the first sample of every stretch without a gap; the first is 0.
    pub starts: Vec<usize>,
    /// Standard deviations of θ, θ̇, θ̈ over time in units of √r: one set for all joints of equal q/r.
    deviations: Vec<[Vec<f64>; 3]>,
    /// Which set is a joint's, and its √r.
    group_of: Vec<usize>,
    measurement_sd: Vec<f64>,
    /// Memory for the fourth state.
    spare: Vec<Vec<f64>>,
}

impl Smoothed {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.q_rad.first().map_or(0, Vec::len)
    }

    /// True if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Standard deviation of a joint's θ [rad] over time; empty for a joint that does not exist.
    pub fn sd_q_rad(&self, joint: usize) -> Deviation<'_> {
        self.deviation(joint, 0)
    }

    /// Standard deviation of a joint's θ̇ [rad/s] over time.
    pub fn sd_qd_rad_s(&self, joint: usize) -> Deviation<'_> {
        self.deviation(joint, 1)
    }

    /// Standard deviation of a joint's θ̈ [rad/s²] over time.
    pub fn sd_qdd_rad_s2(&self, joint: usize) -> Deviation<'_> {
        self.deviation(joint, 2)
    }

    fn deviation(&self, joint: usize, order: usize) -> Deviation<'_> {
        let unit = self.group_of.get(joint).and_then(|g| self.deviations.get(*g)).map_or(&[][..], |sd| &sd[order]);
        Deviation { unit, order, measurement_sd: self.measurement_sd.get(joint).copied().unwrap_or(f64::NAN) }
    }
}

/// A standard deviation over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation<'a> {
    unit: &'a [f64],
    order: usize,
    measurement_sd: f64,
}

impl Deviation<'_> {
    /// At a sample; NaN beyond the recording.
    pub fn at(&self, sample: usize) -> f64 {
        self.unit.get(sample).map_or(f64::NAN, |u| gain::scaled(*u, self.order, self.measurement_sd))
    }

    /// Over all samples.
    pub fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        self.unit.iter().map(|u| gain::scaled(*u, self.order, self.measurement_sd))
    }
}

/// One joint's smoothed state.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct JointState {
    /// Position θ [rad].
    pub q: f64,
    /// Velocity θ̇ [rad/s].
    pub qd: f64,
    /// Acceleration θ̈ [rad/s²].
    pub qdd: f64,
    /// Standard deviation of θ [rad].
    pub sd_q: f64,
    /// Standard deviation of θ̇ [rad/s].
    pub sd_qd: f64,
    /// Standard deviation of θ̈ [rad/s²].
    pub sd_qdd: f64,
}

/// How much future a sample waits for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lag {
    /// This many later samples.
    Samples(usize),
    /// Until a sample at least this much later [s] has come, or `most` samples wait.
    Seconds {
        /// The time [s].
        lag_s: f64,
        /// Most samples that may wait.
        most: usize,
    },
}
