//! From a recording to signals that a torque model can be fitted to.
//!
//! ```text
//! recording ── unwrap, spikes ── regular sampling ── low-pass H_p on q and τ ── q̇, q̈ (seven points)
//!           ── every k-th sample ── regressor columns (by the caller) ── low-pass H on τ and every column ── rows
//! ```
//!
//! H and H_p are zero-phase Butterworth low-passes. What is linear in q and its derivatives has then passed
//! exactly the same filters as τ, so that a band limit biases no parameter; H_p is wide (twice the band of H), so
//! that what is not linear (gravity, Coulomb friction) sees the motion nearly as it was.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | band | half-amplitude frequency of H | Hz |
//! | position band | half-amplitude frequency of H_p | Hz |
//! | moving | speed above which a joint counts as moving | rad/s |
//! | standstill | speed below which sgn q̇ is a ramp | rad/s |
//! | reversal | time around slow motion that the fit leaves out: there a joint may stick, and a stuck joint holds any torque up to its Coulomb level | s |

mod mask;
mod motion;
mod prepared;
mod signals;

pub use mask::{Saturation, saturation};
pub use prepared::{Prepared, Stretched, prepare};
pub use signals::{SPIKE_SHARE_POSITION, SPIKE_SHARE_TORQUE};

use lacuna_estimation::filter::ZeroPhase;
use lacuna_interfaces::{BadInput, Recording, Repair, RobotFile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Order of both low-passes (per pass).
const ORDER: usize = 4;
/// Working rate over band: what the regressor columns are sampled at before the band filter.
const WORKING_RATE: f64 = 10.0;
/// Row rate over band: at 2.5 × band the filter passes 0.07 % of the amplitude.
const ROW_RATE: f64 = 5.0;

/// Movements [rad] over which Coulomb friction may build up after a reversal. A joint that sticks keeps its torque and
/// changes it over such a movement; a sign that jumps at zero speed is wrong by up to 2 f_c until the band filter has
/// forgotten the reversal. Presliding of a size worth naming (milliradians) is beyond them: that is a missing effect.
pub const BRISTLE_WIDTHS_RAD: [f64; 8] = [1e-5, 2e-5, 4e-5, 8e-5, 1.6e-4, 3.2e-4, 6.4e-4, 1e-3];

/// What a user may choose; `None` is chosen from the recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Conditioning {
    /// Band of the fit [Hz]. Default: a 25th of the slowest sampling rate, from 2 to 40 Hz.
    pub band_hz: Option<f64>,
    /// Low-pass on positions and torques before differentiation [Hz]. Default: twice the band.
    pub position_band_hz: Option<f64>,
    /// A joint counts as moving above this speed [rad/s]; 0: every sample counts.
    pub moving_rad_s: f64,
    /// Below this speed the sign of the velocity is a ramp through zero [rad/s].
    pub standstill_rad_s: f64,
    /// Time left out around slow motion by the fit, not by the evaluation [s]. Default: half a period of the band.
    pub reversal_s: Option<f64>,
    /// Time left out at both ends of a recording [s]. Default: two periods of the band, at most a tenth of it.
    pub cut_s: Option<f64>,
    /// Sampling rate that irregular recordings are brought to [Hz]. Default: that of the median step.
    pub rate_hz: Option<f64>,
    /// A torque or position sample this many robust standard deviations off its neighbours is a spike; 0: keep all.
    pub spike_threshold: f64,
    /// Let Coulomb friction build up over a small movement after a reversal ([`BRISTLE_WIDTHS_RAD`], chosen per joint),
    /// instead of changing sign at once.
    pub bristle: bool,
}

impl Default for Conditioning {
    fn default() -> Self {
        Self {
            band_hz: None,
            position_band_hz: None,
            moving_rad_s: 0.05,
            standstill_rad_s: 0.01,
            reversal_s: None,
            cut_s: None,
            rate_hz: None,
            spike_threshold: 8.0,
            bristle: true,
        }
    }
}

/// [`Conditioning`] with everything decided: the same for all recordings of a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// Band of the fit [Hz].
    pub band_hz: f64,
    /// Low-pass on positions and torques [Hz].
    pub position_band_hz: f64,
    /// Speed above which a joint counts as moving [rad/s].
    pub moving_rad_s: f64,
    /// Speed below which sgn q̇ is a ramp [rad/s].
    pub standstill_rad_s: f64,
    /// Time left out around slow motion [s].
    pub reversal_s: f64,
    /// Time left out at both ends [s]; `None`: two periods of the band, at most a tenth of the recording.
    pub cut_s: Option<f64>,
    /// Rate for irregular recordings [Hz]; `None`: that of the median step.
    pub rate_hz: Option<f64>,
    /// Spike threshold in robust standard deviations; 0: keep all.
    pub spike_threshold: f64,
    /// Whether bristle columns are made.
    pub bristle: bool,
    /// The torque signal is late against the position by this much [s]; undone before anything else.
    pub torque_delay_s: f64,
}

impl Conditioning {
    /// Decides what was left open.
    ///
    /// # Errors
    /// [`BadInput`] for a value out of range, a recording of fewer than two samples, or a band that the slowest
    /// sampling rate cannot carry.
    pub fn plan(&self, recordings: &[&Recording]) -> Result<Plan, BadInput> {
        let mut rate = f64::INFINITY;
        for recording in recordings {
            let period = recording.median_period_s().filter(|p| p.is_finite() && *p > 0.0).ok_or_else(|| {
                BadInput::new(format!("found {} samples; expected at least 2", recording.len()))
                    .in_file(&recording.name)
            })?;
            rate = rate.min(self.rate_hz.unwrap_or(1.0 / period));
        }
        if !rate.is_finite() {
            return Err(BadInput::new("found no recording; expected at least one"));
        }
        let positive = |key: &str, v: Option<f64>| match v {
            Some(v) if !(v.is_finite() && v > 0.0) => {
                Err(BadInput::new(format!("{key}: found {v}; expected a positive number")))
            }
            _ => Ok(()),
        };
        positive("rate_hz", self.rate_hz)?;
        positive("band_hz", self.band_hz)?;
        positive("position_band_hz", self.position_band_hz)?;
        for (key, v) in [
            ("moving_rad_s", Some(self.moving_rad_s)),
            ("standstill_rad_s", Some(self.standstill_rad_s)),
            ("reversal_s", self.reversal_s),
            ("cut_s", self.cut_s),
            ("spike_threshold", Some(self.spike_threshold)),
        ] {
            if let Some(v) = v
                && !(v.is_finite() && v >= 0.0)
            {
                return Err(BadInput::new(format!("{key}: found {v}; expected zero or a positive number")));
            }
        }
        let band_hz = self.band_hz.unwrap_or((rate / 25.0).clamp(2.0_f64.min(rate / 5.0), 40.0));
        // A band close to half the sampling rate leaves no room for twice of it: positions then pass as they are recorded.
        let position_band_hz = self.position_band_hz.unwrap_or((2.0 * band_hz).min(0.45 * rate));
        for (key, v, most) in [("band_hz", band_hz, 0.4), ("position_band_hz", position_band_hz, 0.49)] {
            if v > most * rate {
                return Err(BadInput::new(format!(
                    "{key}: found {v} Hz; expected at most {:.4} Hz, {most} of the slowest sampling rate ({rate:.4} Hz)",
                    most * rate
                )));
            }
        }
        if position_band_hz < band_hz {
            return Err(BadInput::new(format!(
                "position_band_hz: found {position_band_hz} Hz; expected at least the band, {band_hz} Hz"
            )));
        }
        Ok(Plan {
            band_hz,
            position_band_hz,
            moving_rad_s: self.moving_rad_s,
            standstill_rad_s: self.standstill_rad_s,
            reversal_s: self.reversal_s.unwrap_or(0.5 / band_hz),
            cut_s: self.cut_s,
            rate_hz: self.rate_hz,
            spike_threshold: self.spike_threshold,
            bristle: self.bristle,
            torque_delay_s: 0.0,
        })
    }
}

/// A conditioned recording: its gap-free stretches.
#[derive(Debug, Clone)]
pub struct Conditioned {
    /// File name of the recording.
    pub name: String,
    /// Stretches without gaps, in time order.
    pub stretches: Vec<Stretch>,
    /// Repairs of the reader and of the conditioning.
    pub repairs: Vec<Repair>,
    /// Sampling rate before decimation [Hz].
    pub sample_rate_hz: f64,
    /// Whether the sampling was irregular and the signals were interpolated to a regular grid.
    pub resampled: bool,
    /// Time in stretches too short to use [s].
    pub dropped_s: f64,
    /// Clipped torques found, per joint.
    pub saturation: Vec<Option<Saturation>>,
}

/// Signals of all joints over a stretch without gaps, regularly sampled; every list is `[joint][sample]`.
///
/// `q`, `qd`, `qdd` and `tau` have passed the position low-pass. Regressor columns are to be computed at every
/// sample and then passed, with `tau`, through [`Stretch::band`]; of the result, [`Stretch::rows`] names the
/// samples to keep.
#[derive(Debug, Clone)]
pub struct Stretch {
    /// Time of the first sample [s], in the recording's own time.
    pub start_s: f64,
    /// Sample period [s].
    pub period_s: f64,
    /// Positions [rad].
    pub q_rad: Vec<Vec<f64>>,
    /// Velocities [rad/s].
    pub qd_rad_s: Vec<Vec<f64>>,
    /// Accelerations [rad/s²].
    pub qdd_rad_s2: Vec<Vec<f64>>,
    /// Sign of the velocity, −1 to 1: a ramp through standstill, averaged over the sample period.
    pub sign: Vec<Vec<f64>>,
    /// The same with a bristle, per joint for every width of [`BRISTLE_WIDTHS_RAD`]: `[joint][width][sample]`; empty unless
    /// the plan asks for it.
    pub bristles: Vec<Vec<Vec<f64>>>,
    /// Torques [Nm or the robot file's unit].
    pub tau_nm: Vec<Vec<f64>>,
    /// Further columns by name, interpolated, not filtered.
    pub extra: BTreeMap<String, Vec<f64>>,
    /// Samples with the drive on, moving or not; `[sample]`.
    pub usable: Vec<bool>,
    /// Samples that count in an evaluation: the drive is on and the joint moves.
    pub counted: Vec<Vec<bool>>,
    /// Samples that the fit uses: `counted`, not close to slow motion of that joint, and not at the torque's limit.
    pub fitted: Vec<Vec<bool>>,
    /// Samples at each end that the filters' start may have touched.
    pub cut: usize,
    /// Every how many samples a row is kept.
    pub row_step: usize,
    filter: ZeroPhase,
}

impl Stretch {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.q_rad.first().map_or(0, Vec::len)
    }

    /// True if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of sample `k` [s].
    pub fn time_s(&self, k: usize) -> f64 {
        self.start_s + k as f64 * self.period_s
    }

    /// Samples that become rows, ends left out.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = usize> + Clone + use<> {
        (self.cut..self.len().saturating_sub(self.cut)).step_by(self.row_step.max(1))
    }

    /// Time between rows [s].
    pub fn row_period_s(&self) -> f64 {
        self.row_step as f64 * self.period_s
    }

    /// Passes columns of the stretch's length through the band filter, in place.
    ///
    /// # Errors
    /// [`BadInput`] for a column of another length or a value that is not finite.
    pub fn band(&self, columns: &mut [&mut [f64]]) -> Result<(), BadInput> {
        Ok(self.filter.apply_columns(columns)?)
    }
}

/// Conditions a whole recording of `robot` by `plan`, in memory.
///
/// # Errors
/// [`BadInput`] with the recording's name: other joints than the robot's, columns of unequal length, values that are
/// not finite, or nothing long enough to filter.
pub fn condition(recording: &Recording, robot: &RobotFile, plan: &Plan) -> Result<Conditioned, BadInput> {
    let mut own = recording.clone();
    let prepared = prepare(&mut own, robot, plan)?;
    let whole = |s: usize| prepared.part(&own, robot, plan, s, 0..prepared.stretches[s].working);
    Ok(Conditioned {
        stretches: (0..prepared.stretches.len()).map(whole).collect::<Result<_, _>>()?,
        name: prepared.name,
        repairs: prepared.repairs,
        sample_rate_hz: prepared.sample_rate_hz,
        resampled: prepared.resampled,
        dropped_s: prepared.dropped_s,
        saturation: prepared.saturation,
    })
}

#[cfg(test)]
mod tests;
