//! The smoother stage: measured positions in; position, velocity, acceleration and their standard deviations out.

use lacuna_estimation::kalman::MotionModel;
use lacuna_interfaces::robot::PerJoint;
use serde::Deserialize;

/// How the process noise is chosen.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum ProcessNoise {
    /// By the frequency up to which motion passes.
    Bandwidth(Bandwidth),
    /// Intensity q, for all joints or per joint [rad²/s⁵; constant jerk: rad²/s⁷].
    Value(PerJoint),
    /// By maximum likelihood from the first stretch of the stream.
    Auto(Auto),
}

/// `{ bandwidth_hz = … }`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bandwidth {
    /// Frequency at which the smoother halves the amplitude [Hz].
    pub bandwidth_hz: f64,
}

/// The word `"auto"`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Auto {
    /// `"auto"`.
    Auto,
}

/// Configuration of the smoother stage.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Motion model.
    pub model: MotionModel,
    /// Process noise.
    pub process_noise: ProcessNoise,
    /// Standard deviation of the position measurement [rad]; default: model file, else encoder, else estimated.
    pub measurement_sd_rad: Option<PerJoint>,
    /// How long a sample waits for later ones [s]; not together with `lag_samples`.
    pub lag_s: Option<f64>,
    /// For how many later samples a sample waits.
    pub lag_samples: Option<usize>,
    /// A step longer than this starts anew [s]; default 5 periods.
    pub gap_s: Option<f64>,
    /// Sample period [s]; default: median of the first steps.
    pub period_s: Option<f64>,
    /// Length of the stretch that `"auto"` looks at [s].
    pub auto_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: MotionModel::default(),
            process_noise: ProcessNoise::Bandwidth(Bandwidth { bandwidth_hz: 80.0 }),
            measurement_sd_rad: None,
            lag_s: None,
            lag_samples: None,
            gap_s: None,
            period_s: None,
            auto_s: 2.0,
        }
    }
}
