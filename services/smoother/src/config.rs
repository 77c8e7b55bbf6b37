//! What a user may say about the smoother, and how the rest is found.

use lacuna_estimation::kalman::{Lag, MotionModel, Noise, Settings, estimate_noise};
use lacuna_interfaces::robot::PerJoint;
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use serde::Deserialize;
use std::f64::consts::{PI, TAU};

/// Bandwidth where the configuration gives none [Hz].
pub const DEFAULT_BANDWIDTH_HZ: f64 = 80.0;
/// The default bandwidth is at most this fraction of the sampling rate.
pub const DEFAULT_BANDWIDTH_SHARE: f64 = 0.125;
/// No bandwidth is above this fraction of the sampling rate: nothing would be smoothed.
pub const MOST_BANDWIDTH_SHARE: f64 = 0.4;
/// Most samples that may wait on the stream.
pub const MOST_WAITING: usize = 1024;
/// Most samples `"auto"` looks at on the stream.
pub const MOST_PROBED: usize = 4096;
/// Samples whose steps give the period.
pub const PERIOD_SAMPLES: usize = 33;
/// Positions are not known better than this [rad], whatever the data say.
const LEAST_SD: f64 = 1e-9;
/// A joint that moved less than this many measurement standard deviations shows no motion noise.
const MOVED: f64 = 50.0;

/// How the process noise is chosen.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum ProcessNoise {
    /// By the frequency up to which motion passes.
    Bandwidth(Bandwidth),
    /// Intensity q, for all joints or per joint [rad²/s⁵; constant jerk: rad²/s⁷].
    Value(PerJoint),
    /// By maximum likelihood from the first stretch of the stream (offline: from the recording). Commanded motion
    /// is smoother than white jerk, for which constant acceleration then opens the band; constant jerk fits it.
    Auto(Auto),
}

/// `{ bandwidth_hz = … }`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bandwidth {
    /// Frequency at which the smoother halves the amplitude [Hz]; at most 0.4 of the sampling rate is used.
    pub bandwidth_hz: f64,
}

/// The word `"auto"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Auto {
    /// `"auto"`.
    Auto,
}

/// Configuration of the smoother stage. Everything has a default.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Motion model.
    pub model: MotionModel,
    /// Process noise; default: a bandwidth of 80 Hz, at most an eighth of the sampling rate.
    pub process_noise: Option<ProcessNoise>,
    /// Standard deviation of the position measurement [rad], for all joints or per joint; default: the model
    /// file's, else the encoder's resolution/√12, else estimated from the first stretch.
    pub measurement_sd_rad: Option<PerJoint>,
    /// How long a sample waits for later ones [s]; not together with `lag_samples`. Default: four time
    /// constants of the smoother (25 ms at 80 Hz), beyond which the future tells nothing.
    pub lag_s: Option<f64>,
    /// For how many later samples a sample waits.
    pub lag_samples: Option<usize>,
    /// A step longer than this starts anew [s]; default 5 periods.
    pub gap_s: Option<f64>,
    /// Sample period [s]; default: median of the first 32 steps.
    pub period_s: Option<f64>,
    /// Length of the stretch that `"auto"` and an unknown measurement noise look at [s]; the stream waits
    /// for it once, at most 4096 samples.
    pub auto_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: MotionModel::default(),
            process_noise: None,
            measurement_sd_rad: None,
            lag_s: None,
            lag_samples: None,
            gap_s: None,
            period_s: None,
            auto_s: 2.0,
        }
    }
}

/// The configuration held against a robot: what is known before any sample.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Known {
    config: Config,
    /// Per joint; `None`: to be estimated.
    sd: Vec<Option<f64>>,
    /// The configuration itself gives the standard deviation, so that `"auto"` may not change it.
    sd_given: bool,
    /// Resolution of the encoder per joint, a lower bound of any estimate.
    floor: Vec<f64>,
}

impl Known {
    pub fn new(config: Config, robot: &RobotFile, model: Option<&ModelFile>) -> Result<Self, BadInput> {
        let n = robot.message_joints()?;
        positive("auto_s", config.auto_s)?;
        for (key, value) in [("gap_s", config.gap_s), ("period_s", config.period_s)] {
            value.map_or(Ok(()), |v| positive(key, v))?;
        }
        if let Some(lag) = config.lag_s
            && !(lag.is_finite() && lag >= 0.0)
        {
            return Err(BadInput::new(format!("lag_s: found {lag}; expected zero or a positive number")));
        }
        if config.lag_s.is_some() && config.lag_samples.is_some() {
            return Err(BadInput::new("found both lag_s and lag_samples; expected one of them"));
        }
        if let Some(lag) = config.lag_samples
            && lag > MOST_WAITING
        {
            return Err(BadInput::new(format!("lag_samples: found {lag}; expected at most {MOST_WAITING}")));
        }
        match &config.process_noise {
            Some(ProcessNoise::Bandwidth(b)) => positive("process_noise.bandwidth_hz", b.bandwidth_hz)?,
            Some(ProcessNoise::Value(q)) => per_joint("process_noise", q, n)?,
            Some(ProcessNoise::Auto(_)) | None => {}
        }
        let given = config.measurement_sd_rad.as_ref();
        given.map_or(Ok(()), |sd| per_joint("measurement_sd_rad", sd, n))?;
        if let Some(model) = model {
            model.check(robot)?;
        }
        let of_model = |j: usize| model.and_then(|m| m.noise.sd_q_rad.get(j)).copied().filter(|sd| *sd > 0.0);
        let encoder: Vec<Option<f64>> = (0..n).map(|j| resolution_sd(robot, j)).collect();
        let sd = (0..n).map(|j| given.and_then(|g| g.get(j)).or_else(|| of_model(j)).or(encoder[j])).collect();
        let floor = encoder.iter().map(|e| e.unwrap_or(LEAST_SD).max(LEAST_SD)).collect();
        Ok(Self { sd, sd_given: given.is_some(), floor, config })
    }

    pub fn auto_s(&self) -> f64 {
        self.config.auto_s
    }

    /// True if the first stretch must be looked at for noise, and not for the period alone.
    pub fn needs_data(&self) -> bool {
        self.config.process_noise == Some(ProcessNoise::Auto(Auto::Auto)) || self.sd.iter().any(Option::is_none)
    }

    /// Period, if the configuration gives it.
    pub fn period_s(&self) -> Option<f64> {
        self.config.period_s
    }

    pub fn gap_s(&self, period_s: f64) -> f64 {
        self.config.gap_s.unwrap_or(5.0 * period_s)
    }

    fn bandwidth_hz(&self, period_s: f64) -> f64 {
        match &self.config.process_noise {
            Some(ProcessNoise::Bandwidth(b)) => b.bandwidth_hz.min(MOST_BANDWIDTH_SHARE / period_s),
            _ => DEFAULT_BANDWIDTH_HZ.min(DEFAULT_BANDWIDTH_SHARE / period_s),
        }
    }

    /// Noise of joint `j` sampled every `period_s`, from the stretch (`t_s`, `q_rad`) where it is not known.
    /// Does not allocate.
    pub fn noise(&self, j: usize, period_s: f64, t_s: &[f64], q_rad: &[f64]) -> Noise {
        let model = self.config.model;
        let auto = self.config.process_noise == Some(ProcessNoise::Auto(Auto::Auto));
        let known = self.sd[j];
        let estimate =
            |sd: Option<f64>| estimate_noise(model, t_s, q_rad, period_s, self.gap_s(period_s), sd, self.floor[j]).ok();
        let found = if auto || known.is_none() { estimate(known.filter(|_| self.sd_given)) } else { None };
        let sd = match (known, found) {
            (Some(sd), None) => sd,
            (Some(sd), Some(_)) if self.sd_given || !auto => sd,
            (_, Some(found)) => found.noise.measurement_sd,
            (None, None) => self.floor[j],
        };
        if let Some(ProcessNoise::Value(q)) = &self.config.process_noise {
            return Noise { process: q.get(j).unwrap_or(1.0), measurement_sd: sd };
        }
        if let Some(found) = found.filter(|f| auto && !f.at_limit && range(q_rad) > MOVED * f.noise.measurement_sd) {
            return found.noise;
        }
        Noise::from_bandwidth(model, self.bandwidth_hz(period_s), sd, period_s)
    }

    pub fn settings(&self, noise: Vec<Noise>, period_s: f64) -> Settings {
        Settings { gap_s: self.gap_s(period_s), ..Settings::new(self.config.model, noise) }
    }

    /// The lag: as configured, or four time constants of the slowest joint's smoother. With the poles of the
    /// two-sided smoother at ω_c on a circle, the slowest decays at ω_c sin(π/2N).
    pub fn lag(&self, noise: &[Noise], period_s: f64) -> Lag {
        if let Some(samples) = self.config.lag_samples {
            return Lag::Samples(samples);
        }
        let model = self.config.model;
        let bandwidth = noise.iter().map(|n| n.bandwidth_hz(model, period_s)).fold(f64::INFINITY, f64::min);
        let rate = TAU * bandwidth * (0.5 * PI / model.order() as f64).sin();
        let lag_s = self.config.lag_s.unwrap_or(TAU / rate).clamp(0.0, 1e3);
        Lag::Seconds { lag_s, most: MOST_WAITING }
    }
}

fn range(q: &[f64]) -> f64 {
    let (low, high) = q.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    high - low
}

/// Standard deviation of the motor encoder's rounding, seen at the joint: 2π/(2^bits · gear)/√12.
fn resolution_sd(robot: &RobotFile, j: usize) -> Option<f64> {
    let bits = robot.drive.encoder_bits.as_ref()?.get(j)?;
    let gear = robot.drive.gear_ratio.as_ref().and_then(|g| g.get(j)).unwrap_or(1.0).abs();
    let sd = TAU / (bits.exp2() * gear) / 12f64.sqrt();
    (sd.is_finite() && sd > 0.0).then_some(sd)
}

fn positive(key: &str, v: f64) -> Result<(), BadInput> {
    if v.is_finite() && v > 0.0 {
        Ok(())
    } else {
        Err(BadInput::new(format!("{key}: found {v}; expected a positive number")))
    }
}

fn per_joint(key: &str, values: &PerJoint, n: usize) -> Result<(), BadInput> {
    if let PerJoint::Each(v) = values
        && v.len() != n
    {
        return Err(BadInput::new(format!("{key}: found {} values; expected one, or one per joint ({n})", v.len())));
    }
    (0..n).try_for_each(|j| positive(key, values.get(j).unwrap_or(f64::NAN)))
}
