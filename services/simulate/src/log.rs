//! The drive's log: from controller ticks to samples, with the sensors' noise.
//!
//! A sample at t holds the encoder reading at t and the mean of the executed torque over one log period
//! centred on t, so it is known only when the ticks after t are. The log keeps as many ticks as that takes
//! and no more: an hour's recording needs the memory of its samples.

use crate::plant::TrueRobot;
use crate::random::Random;
use lacuna_interfaces::{BadInput, Joints};
use std::collections::VecDeque;

/// One logged trajectory, joint-major.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Logged {
    /// Time [s].
    pub t_s: Vec<f64>,
    /// Encoder readings [rad].
    pub q_rad: Vec<Vec<f64>>,
    /// Logged torques [Nm].
    pub tau_nm: Vec<Vec<f64>>,
    /// Noise-free torque of everything that the robot file does not say [Nm]: executed torque minus the
    /// nominal inverse dynamics at the noise-free motion that the encoders see.
    pub hidden_nm: Vec<Vec<f64>>,
    /// Noise-free motor speeds [rad/s].
    pub qd_rad_s: Vec<Vec<f64>>,
    /// Noise-free motor accelerations [rad/s²], mean over the log's window.
    pub qdd_rad_s2: Vec<Vec<f64>>,
    /// Commanded positions [rad].
    pub reference_rad: Vec<Vec<f64>>,
    /// Largest tracking error [rad].
    pub tracking_error_rad: f64,
}

/// One controller period.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tick {
    /// Torque command, executed until the next tick [Nm].
    pub command: Joints,
    /// Encoder reading at its begin [rad].
    pub reading: Joints,
    /// Noise-free encoder position [rad].
    pub position: Joints,
    /// Motor speed [rad/s].
    pub speed: Joints,
    /// Commanded position [rad].
    pub reference: Joints,
}

/// What the log does to the signals.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LogSettings {
    /// Controller periods per second and per sample.
    pub rate_hz: f64,
    pub divider: usize,
    /// Samples to log.
    pub samples: usize,
    /// Tick of the first sample.
    pub zero: usize,
    /// Torque late against position [s].
    pub delay_s: f64,
    /// Torque noise [Nm].
    pub noise: Joints,
    /// Spikes per second and joint.
    pub spikes_per_s: f64,
}

/// The log while it is written.
pub(crate) struct Log<'a> {
    settings: LogSettings,
    nominal: &'a TrueRobot,
    random: Random,
    window: VecDeque<Tick>,
    /// Index of the window's first tick.
    first: usize,
    logged: Logged,
}

impl<'a> Log<'a> {
    pub fn new(settings: LogSettings, nominal: &'a TrueRobot, random: Random) -> Self {
        let n = nominal.joints.len();
        let columns = || vec![Vec::with_capacity(settings.samples); n];
        let logged = Logged {
            t_s: Vec::with_capacity(settings.samples),
            q_rad: columns(),
            tau_nm: columns(),
            hidden_nm: columns(),
            qd_rad_s: columns(),
            qdd_rad_s2: columns(),
            reference_rad: columns(),
            tracking_error_rad: 0.0,
        };
        Self { settings, nominal, random, window: VecDeque::new(), first: 0, logged }
    }

    /// The finished log.
    pub fn finish(mut self, tracking_error_rad: f64) -> Logged {
        self.logged.tracking_error_rad = tracking_error_rad;
        self.logged
    }

    /// True when every sample is logged.
    pub fn is_full(&self) -> bool {
        self.logged.t_s.len() >= self.settings.samples
    }

    /// Ticks before and after a sample's own that it needs.
    fn reach(&self) -> (usize, usize) {
        let s = &self.settings;
        let half = 0.5 * s.divider as f64;
        let late = s.delay_s * s.rate_hz;
        let step = (s.divider / 2).max(1);
        ((half + late).ceil().max(0.0) as usize + step, ((half - late).ceil().max(0.0) as usize).max(step))
    }

    /// Takes the next tick and logs the samples that it completes.
    ///
    /// # Errors
    /// [`BadInput`] if the nominal robot does not exist at a recorded pose.
    pub fn push(&mut self, tick: Tick) -> Result<(), BadInput> {
        self.window.push_back(tick);
        let (before, after) = self.reach();
        while !self.is_full() {
            let at = self.settings.zero + self.logged.t_s.len() * self.settings.divider;
            if at + after >= self.first + self.window.len() {
                while self.first + before < at && self.window.len() > 1 {
                    self.window.pop_front();
                    self.first += 1;
                }
                break;
            }
            self.sample(at)?;
        }
        Ok(())
    }

    fn tick(&self, index: usize) -> &Tick {
        // The window always spans what `reach` asks for; before its begin the robot stood still.
        &self.window[index.saturating_sub(self.first).min(self.window.len() - 1)]
    }

    /// Mean of the commands, each held for one tick, over [from, to] in ticks.
    fn held_mean(&self, i: usize, from: f64, to: f64) -> f64 {
        let mut sum = 0.0;
        let mut k = from.floor();
        while k < to {
            let held = (k + 1.0).min(to) - k.max(from);
            sum += self.tick(k.max(0.0) as usize).command[i] * held;
            k += 1.0;
        }
        sum / (to - from)
    }

    fn sample(&mut self, at: usize) -> Result<(), BadInput> {
        let s = self.settings;
        let n = self.nominal.joints.len();
        let half = 0.5 * s.divider as f64;
        let middle = at as f64 - s.delay_s * s.rate_hz;
        let reach = (s.divider / 2).max(1);
        let (now, ahead, behind) = (*self.tick(at), *self.tick(at + reach), *self.tick(at.saturating_sub(reach)));
        let (mut acceleration, mut torque) = (Joints::default(), Joints::default());
        for i in 0..n {
            acceleration[i] = (ahead.speed[i] - behind.speed[i]) * s.rate_hz / (2 * reach) as f64;
            torque[i] = self.held_mean(i, middle - half, middle + half);
        }
        let loads = self.nominal.loads(0.0, &[]);
        let known = self
            .nominal
            .mechanism
            .inverse(&now.position, &now.speed, &acceleration, &loads)
            .map_err(|_| BadInput::new("simulation: a recorded pose does not exist for the nominal robot"))?;
        let spike = s.spikes_per_s * s.divider as f64 / s.rate_hz;
        let logged = &mut self.logged;
        logged.t_s.push((at - s.zero) as f64 / s.rate_hz);
        for i in 0..n {
            let rotor = self.nominal.joints[i].rotor * acceleration[i];
            logged.q_rad[i].push(now.reading[i]);
            logged.reference_rad[i].push(now.reference[i]);
            logged.qd_rad_s[i].push(now.speed[i]);
            logged.qdd_rad_s2[i].push(acceleration[i]);
            logged.hidden_nm[i].push(torque[i] - known[i] - rotor);
            let mut reading = torque[i] + s.noise[i] * self.random.normal();
            if spike > 0.0 && self.random.unit() < spike {
                reading += self.random.sign() * self.random.uniform(20.0, 60.0) * (s.noise[i] + 1e-3);
            }
            logged.tau_nm[i].push(reading);
        }
        Ok(())
    }
}
