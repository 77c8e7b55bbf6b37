//! How wide a band the encoders' noise allows.

use super::Piece;
use lacuna_estimation::filter::noise_sd;
use lacuna_estimation::stats;
use lacuna_physics::{Motion, RigidBody};

/// Widest band [Hz].
const MAX_BAND_HZ: f64 = 40.0;
/// Narrowest band that is chosen without being asked for [Hz].
const MIN_BAND_HZ: f64 = 8.0;
/// Share of the torque's size that counts as its noise where the signal itself is cleaner and the inertia only a
/// guess: a current that the drive has smoothed would otherwise ask for an encoder without noise.
const CLEAN: f64 = 0.0005;

/// The band in which the encoder's noise, twice differentiated and times the inertia, stays below half the
/// torque's noise: (2πf)² = ½ √5 σ_τ / (M σ_q).
pub(super) fn choose(body: &dyn RigidBody, pi: &[f64], pieces: &[Piece], rate_hz: f64) -> f64 {
    let n = body.joint_count();
    let mut band = MAX_BAND_HZ;
    let top = (rate_hz / 6.0).min(MAX_BAND_HZ);
    for j in 0..n {
        let sd = |signals: &dyn Fn(&Piece) -> &Vec<f64>| {
            let mut all: Vec<f64> = pieces.iter().filter_map(|p| noise_sd(signals(p)).ok()).collect();
            stats::median_in_place(&mut all)
        };
        let sd_q = sd(&|p| &p.q[j]);
        let mut sizes: Vec<f64> = pieces.iter().map(|p| stats::standard_deviation(&p.tau[j])).collect();
        let mut sd_tau = sd(&|p| &p.tau[j]);
        let inertia = stated_inertia(body, pi, pieces, j).unwrap_or_else(|| {
            sd_tau = sd_tau.max(CLEAN * stats::median_in_place(&mut sizes));
            slope_inertia(pieces, j, rate_hz)
        });
        let f = (0.5 * 5f64.sqrt() * sd_tau / (inertia * sd_q)).sqrt() / std::f64::consts::TAU;
        if f.is_finite() {
            band = band.min(f);
        }
    }
    band.clamp(MIN_BAND_HZ.min(top), top)
}

/// Own inertia of joint `j` at its median pose by the robot file; `None` if that has no masses.
fn stated_inertia(body: &dyn RigidBody, pi: &[f64], pieces: &[Piece], j: usize) -> Option<f64> {
    let n = body.joint_count();
    let q: Vec<f64> = (0..n)
        .map(|i| stats::median(&pieces.iter().flat_map(|p| p.q[i].iter().copied().step_by(50)).collect::<Vec<_>>()))
        .collect();
    let zero = vec![0.0; n];
    let mut unit = zero.clone();
    unit[j] = 1.0;
    let (mut with, mut without) = (zero.clone(), zero.clone());
    let a = body.torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &unit }, pi, &mut with);
    let b = body.torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &zero }, pi, &mut without);
    let own = with[j] - without[j];
    (a.is_ok() && b.is_ok() && own > 1e-9).then_some(own)
}

/// Inertia of joint `j` from its torque: the slope over second differences of a tenth of a second, slow enough to
/// be motion rather than noise. Gravity and friction bias it; a band needs no more than its order of magnitude.
fn slope_inertia(pieces: &[Piece], j: usize, rate_hz: f64) -> f64 {
    let step = ((0.1 * rate_hz).round() as usize).max(1);
    let (mut up, mut down) = (0.0, 0.0);
    for p in pieces {
        let mean = stats::mean(&p.tau[j]);
        for (w, tau) in p.q[j].windows(2 * step + 1).zip(&p.tau[j][step.min(p.len())..]) {
            let bend = (w[0] + w[2 * step] - 2.0 * w[step]) * (rate_hz / step as f64).powi(2);
            up += bend * (tau - mean);
            down += bend * bend;
        }
    }
    (up / f64::max(down, 1e-30)).abs().max(1e-12)
}
