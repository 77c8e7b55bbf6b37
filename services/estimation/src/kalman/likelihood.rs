//! Noise from the data: the innovations of the right filter are white with the variance it predicts.
//!
//! ```text
//! −2 ln L = Σ ln(2π S_k) + ν_k²/S_k,   ν = z − θ⁻        (Harvey 1989, section 3.4)
//! ```
//!
//! Gains depend on q/r alone, so with r unknown r̂ = mean(ν²/S̃) at S̃ = S/r, and one parameter is left: the
//! bandwidth (see [`Noise::from_bandwidth`]), searched on a grid and refined by golden section.

use super::gain::{Gains, Mean, Period};
use super::model::carried;
use super::{CovarianceUpdate, MotionModel, Noise};
use crate::error::{EstimationError, all_finite, increasing, positive, same_length};

/// What [`estimate_noise`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseEstimate {
    /// The noise.
    pub noise: Noise,
    /// Its log likelihood.
    pub log_likelihood: f64,
    /// Bandwidth of the smoother with it [Hz].
    pub bandwidth_hz: f64,
    /// The likelihood rises to the end of the searched range: the data do not show this noise (a joint at
    /// rest, or motion faster than sampling).
    pub at_limit: bool,
}

/// Lowest and highest bandwidth searched, as a fraction of the sampling rate.
const RANGE: [f64; 2] = [5e-4, 0.45];
const GRID: usize = 14;

/// Log likelihood of positions `q_rad` at times `t_s` under `noise`. Steps longer than `gap_s` begin a new
/// stretch; the first N samples of each only determine the state.
///
/// # Errors
/// [`EstimationError`] for noise that is not positive, unequal lengths, time that does not increase or a
/// sample that is not finite.
pub fn log_likelihood(
    model: MotionModel,
    noise: Noise,
    gap_s: f64,
    t_s: &[f64],
    q_rad: &[f64],
) -> Result<f64, EstimationError> {
    positive("process noise", noise.process)?;
    positive("measurement standard deviation", noise.measurement_sd)?;
    check(t_s, q_rad)?;
    let sums = innovations(model, noise, gap_s, t_s, q_rad);
    Ok(-0.5 * (sums.count * std::f64::consts::TAU.ln() + sums.log_variance + sums.square))
}

/// Maximum-likelihood noise of one joint sampled about every `period_s`, which only sets the range of the
/// search. `measurement_sd` [rad] if it is known, else it is estimated too, not below `least_sd`. Does not
/// allocate.
///
/// # Errors
/// As [`log_likelihood`]; [`EstimationError::TooShort`] for fewer than 50 samples.
pub fn estimate_noise(
    model: MotionModel,
    t_s: &[f64],
    q_rad: &[f64],
    period_s: f64,
    gap_s: f64,
    measurement_sd: Option<f64>,
    least_sd: f64,
) -> Result<NoiseEstimate, EstimationError> {
    check(t_s, q_rad)?;
    if let Some(sd) = measurement_sd {
        positive("measurement standard deviation", sd)?;
    }
    positive("least measurement standard deviation", least_sd)?;
    positive("period_s", period_s)?;
    if t_s.len() < 50 {
        return Err(EstimationError::TooShort { what: "noise estimate", found: t_s.len(), needed: 50 });
    }
    let score = |ln_bandwidth: f64| profile(model, ln_bandwidth, period_s, gap_s, t_s, q_rad, measurement_sd, least_sd);
    let [low, high] = RANGE.map(|share| (share / period_s).ln());
    let step = (high - low) / (GRID - 1) as f64;
    let mut best = (0, f64::NEG_INFINITY);
    for i in 0..GRID {
        let (likelihood, _) = score(low + i as f64 * step);
        if likelihood > best.1 {
            best = (i, likelihood);
        }
    }
    let centre = low + best.0 as f64 * step;
    let ln_bandwidth = golden_section((centre - step).max(low), (centre + step).min(high), |b| score(b).0);
    let (log_likelihood, noise) = score(ln_bandwidth);
    Ok(NoiseEstimate {
        noise,
        log_likelihood,
        bandwidth_hz: ln_bandwidth.exp(),
        at_limit: ln_bandwidth < low + 0.05 || ln_bandwidth > high - 0.05,
    })
}

#[expect(clippy::too_many_arguments, reason = "a closure's captures, spelled out")]
fn profile(
    model: MotionModel,
    ln_bandwidth: f64,
    period_s: f64,
    gap_s: f64,
    t_s: &[f64],
    q_rad: &[f64],
    measurement_sd: Option<f64>,
    least_sd: f64,
) -> (f64, Noise) {
    let bandwidth = ln_bandwidth.exp();
    // Run with the known or least r: with another r at the same q/r all S and P scale with it.
    let base = measurement_sd.unwrap_or(least_sd);
    let noise = Noise::from_bandwidth(model, bandwidth, base, period_s);
    let sums = innovations(model, noise, gap_s, t_s, q_rad);
    let scale = match measurement_sd {
        Some(_) => 1.0,
        None => (sums.square / sums.count.max(1.0)).max(1.0),
    };
    let likelihood =
        -0.5 * (sums.count * (std::f64::consts::TAU * scale).ln() + sums.log_variance + sums.square / scale);
    let noise = Noise { process: noise.process * scale, measurement_sd: base * scale.sqrt() };
    (if likelihood.is_finite() { likelihood } else { f64::NEG_INFINITY }, noise)
}

fn check(t_s: &[f64], q_rad: &[f64]) -> Result<(), EstimationError> {
    same_length("positions", q_rad.len(), t_s.len())?;
    increasing(t_s)?;
    all_finite("position", q_rad)
}

/// Σ 1, Σ ln S, Σ ν²/S over the innovations.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: f64,
    log_variance: f64,
    square: f64,
}

fn innovations(model: MotionModel, noise: Noise, gap_s: f64, t_s: &[f64], q_rad: &[f64]) -> Sums {
    match model {
        MotionModel::ConstantAcceleration => run::<3>(noise, gap_s, t_s, q_rad),
        MotionModel::ConstantJerk => run::<4>(noise, gap_s, t_s, q_rad),
    }
}

fn run<const N: usize>(noise: Noise, gap_s: f64, t_s: &[f64], q_rad: &[f64]) -> Sums {
    let mut gains = Gains::<N>::new(noise.ratio(), CovarianceUpdate::Joseph);
    let mut period = Period::repeating(1e-4);
    let r = noise.measurement_sd * noise.measurement_sd;
    let mut sums = Sums::default();
    let Some((&first, rest)) = q_rad.split_first() else { return sums };
    let mut mean = Mean::<N>::start(first);
    let mut last_s = 0.0f64;
    let mut log_last = 0.0;
    for (&z, t) in rest.iter().zip(t_s.windows(2)) {
        let dt = t[1] - t[0];
        if dt > gap_s {
            gains.start();
            mean = Mean::start(z);
            continue;
        }
        gains.advance(period.classify(dt));
        let step = gains.step();
        if step.determined() {
            let (k, s) = (&step.k, step.s * r);
            let predicted = carried(&mean.x, dt);
            let innovation = z - predicted[0];
            mean.x = std::array::from_fn(|i| predicted[i] + k[i] * innovation);
            if s != last_s {
                last_s = s;
                log_last = s.ln();
            }
            sums.count += 1.0;
            sums.log_variance += log_last;
            sums.square += innovation * innovation / s;
        } else {
            mean.advance(step, gains.information(), dt, z);
        }
    }
    sums
}

/// Place of the maximum of `f` in \[a, b\], to 0.5 % of a natural logarithm's unit.
fn golden_section(mut a: f64, mut b: f64, f: impl Fn(f64) -> f64) -> f64 {
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let (mut c, mut d) = (b - ratio * (b - a), a + ratio * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    while b - a > 5e-3 {
        if fc > fd {
            (b, d, fd) = (d, c, fc);
            c = b - ratio * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + ratio * (b - a);
            fd = f(d);
        }
    }
    0.5 * (a + b)
}
