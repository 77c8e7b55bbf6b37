//! What to simulate, as a TOML table.

use crate::control::ControlConfig;
use crate::effects::TrueEffect;
use crate::reference::Kinds;
use lacuna_interfaces::{BadInput, RobotFile};
use serde::{Deserialize, Serialize};

/// A group of trajectories of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryGroup {
    /// Kind of motion.
    pub kind: Kinds,
    /// Duration of each [s].
    #[serde(default = "default_duration")]
    pub duration_s: f64,
    /// How many.
    #[serde(default = "default_count")]
    pub count: u32,
    /// Share of the speed limits, 0 to 1.
    #[serde(default = "default_intensity")]
    pub intensity: f64,
}

fn default_duration() -> f64 {
    5.0
}

fn default_count() -> u32 {
    1
}

fn default_intensity() -> f64 {
    0.9
}

/// Coulomb and viscous friction: given, or drawn if a list is empty.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionConfig {
    /// No friction at all, whatever the lists say.
    pub none: bool,
    /// f_c per joint [Nm].
    pub f_c: Vec<f64>,
    /// f_v per joint [Nm s/rad].
    pub f_v: Vec<f64>,
}

/// Noise of sensors and drives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseConfig {
    /// Torque noise on the log, standard deviation [Nm]; empty: drawn around 0.4 % of the torque scale.
    pub torque_nm: Vec<f64>,
    /// Encoder noise, standard deviation in steps of the encoder.
    pub encoder_steps: f64,
    /// Disturbance torque that truly acts, drawn anew every controller period, as a share of the torque scale.
    pub process_share: f64,
    /// Single-sample torque spikes per second and joint (as real drives log them).
    pub spikes_per_s: f64,
    /// Encoder step at the joint side [rad]; absent: from the robot file's bits and gear ratio.
    pub encoder_step_rad: Option<f64>,
}

impl Default for NoiseConfig {
    fn default() -> Self {
        Self {
            torque_nm: Vec::new(),
            encoder_steps: 3.0,
            process_share: 0.002,
            spikes_per_s: 0.0,
            encoder_step_rad: None,
        }
    }
}

/// How recordings are logged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogConfig {
    /// Sample rate [Hz]; divides the controller's rate. Absent: the robot file's, or 1 kHz.
    pub rate_hz: Option<f64>,
    /// Temperature columns temp1, temp2, ….
    pub temperature: bool,
    /// Columns of the commanded positions, qref1, qref2, ….
    pub reference: bool,
    /// Pause between trajectories, drawn from 0 to twice this [s].
    pub pause_s: f64,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { rate_hz: None, temperature: false, reference: false, pause_s: 8.0 }
    }
}

/// The whole table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationConfig {
    /// Seed of everything drawn.
    pub seed: u64,
    /// Real masses and inertias differ from the robot file's by up to this share.
    pub mass_error: f64,
    /// Rotor inertia per joint at the joint side where the robot's description has none, as a URDF [kg m²];
    /// added to what it has, and known to the controller. Empty: nothing is added.
    pub rotor_inertia: Vec<f64>,
    /// Trajectories.
    #[serde(rename = "trajectory")]
    pub trajectories: Vec<TrajectoryGroup>,
    /// Friction.
    pub friction: FrictionConfig,
    /// Noise.
    pub noise: NoiseConfig,
    /// Controller and step size.
    pub control: ControlConfig,
    /// Log.
    pub log: LogConfig,
    /// Simulate once more without each effect, to say in the truth how much torque it is behind.
    pub measure_effects: bool,
    /// What is truly there beyond the robot file and friction.
    #[serde(rename = "effect")]
    pub effects: Vec<TrueEffect>,
}

impl Default for SimulationConfig {
    /// Six trajectories of five seconds, drawn friction, nothing hidden.
    fn default() -> Self {
        let group = |kind, count| TrajectoryGroup { kind, duration_s: 5.0, count, intensity: default_intensity() };
        Self {
            seed: 1,
            mass_error: 0.0,
            rotor_inertia: Vec::new(),
            trajectories: vec![
                group(Kinds::PointToPoint, 1),
                group(Kinds::PickPlace, 1),
                group(Kinds::Fourier, 3),
                group(Kinds::Sweep, 1),
            ],
            friction: FrictionConfig::default(),
            noise: NoiseConfig::default(),
            control: ControlConfig::default(),
            log: LogConfig::default(),
            measure_effects: false,
            effects: Vec::new(),
        }
    }
}

impl SimulationConfig {
    /// Parses a configuration.
    ///
    /// # Errors
    /// [`BadInput`] with the line.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))
    }

    /// Log rate for `robot` [Hz].
    pub fn log_rate_hz(&self, robot: &RobotFile) -> f64 {
        self.log.rate_hz.or(robot.drive.sample_rate_hz).unwrap_or(1000.0)
    }

    /// Controller periods per log sample.
    ///
    /// # Errors
    /// [`BadInput`] if the rates do not divide.
    pub fn log_divider(&self, robot: &RobotFile) -> Result<usize, BadInput> {
        let rate = self.log_rate_hz(robot);
        let ratio = self.control.rate_hz / rate;
        if !(ratio >= 1.0 && (ratio - ratio.round()).abs() < 1e-9 && ratio <= 1e4) {
            return Err(BadInput::new(format!(
                "log.rate_hz: found {rate}; expected a whole fraction of the controller's {} Hz",
                self.control.rate_hz
            )));
        }
        Ok(ratio.round() as usize)
    }

    /// Checks the configuration against a robot.
    ///
    /// # Errors
    /// [`BadInput`] naming the key, what was found and what was expected.
    pub fn validate(&self, robot: &RobotFile) -> Result<(), BadInput> {
        let n = robot.joint_count();
        self.control.validate()?;
        self.log_divider(robot)?;
        if self.trajectories.iter().map(|t| t.count).sum::<u32>() == 0 {
            return Err(BadInput::new("trajectory: found none; expected at least one"));
        }
        for (i, t) in self.trajectories.iter().enumerate() {
            range(&format!("trajectory[{i}].duration_s"), t.duration_s, 0.5, 7_200.0)?;
            range(&format!("trajectory[{i}].intensity"), t.intensity, 0.01, 1.0)?;
        }
        for (key, list) in [
            ("friction.f_c", &self.friction.f_c),
            ("friction.f_v", &self.friction.f_v),
            ("noise.torque_nm", &self.noise.torque_nm),
            ("rotor_inertia", &self.rotor_inertia),
        ] {
            if !list.is_empty() && list.len() != n {
                return Err(BadInput::new(format!("{key}: found {} values; expected {n}, one per joint", list.len())));
            }
            for v in list {
                range(key, *v, 0.0, 1e6)?;
            }
        }
        range("mass_error", self.mass_error, 0.0, 0.5)?;
        range("noise.encoder_steps", self.noise.encoder_steps, 0.0, 1e6)?;
        range("noise.process_share", self.noise.process_share, 0.0, 1.0)?;
        range("noise.spikes_per_s", self.noise.spikes_per_s, 0.0, 100.0)?;
        range("log.pause_s", self.log.pause_s, 0.0, 1e6)?;
        if let Some(step) = self.noise.encoder_step_rad {
            range("noise.encoder_step_rad", step, 0.0, 1.0)?;
        }
        Ok(())
    }
}

fn range(key: &str, v: f64, low: f64, high: f64) -> Result<(), BadInput> {
    if v >= low && v <= high {
        Ok(())
    } else {
        Err(BadInput::new(format!("{key}: found {v}; expected {low} to {high}")))
    }
}
