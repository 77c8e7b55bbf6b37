//! One trajectory in closed loop: controller ticks, plant steps, and the drive's log.

use crate::control::{ControlConfig, Controller};
use crate::plant::robot::TipEvent;
use crate::plant::{Stepper, TrueRobot, Unreachable};
use crate::random::Random;
use crate::reference::Reference;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, RobotFile};

/// Time before the recording begins in which the loop comes to rest [s].
const SETTLE_S: f64 = 0.4;

/// What a run needs to know.
#[derive(Debug, Clone)]
pub struct Setup<'a> {
    /// Robot file, for drive limits.
    pub robot: &'a RobotFile,
    /// The robot as it is.
    pub truth: &'a TrueRobot,
    /// The robot as its file says: what the controller knows.
    pub nominal: &'a TrueRobot,
    /// Controller.
    pub control: ControlConfig,
    /// Controller periods per log sample.
    pub divider: usize,
    /// Torque noise of the log [Nm].
    pub torque_noise: Joints,
    /// Encoder step at the joint side [rad].
    pub encoder_step: Joints,
    /// Encoder noise [steps].
    pub encoder_noise: f64,
    /// Disturbance torque [Nm].
    pub process_noise: Joints,
    /// Spikes per second and joint.
    pub spikes_per_s: f64,
}

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
    /// Largest tracking error [rad].
    pub tracking_error_rad: f64,
}

/// Everything at controller rate, one entry a tick, before the log.
struct Ticks {
    command: Vec<Joints>,
    reading: Vec<Joints>,
    /// Noise-free encoder position and speed.
    position: Vec<Joints>,
    speed: Vec<Joints>,
    error: f64,
    /// Index of the tick at time 0.
    zero: usize,
}

impl Ticks {
    fn with_capacity(total: usize, zero: usize) -> Self {
        let list = || Vec::with_capacity(total);
        Self { command: list(), reading: list(), position: list(), speed: list(), error: 0.0, zero }
    }
}

/// Simulates one trajectory of `duration_s` that starts `start_s` after the cold drives were switched on.
///
/// # Errors
/// [`BadInput`] if the robot leaves its workspace.
pub fn run(
    setup: &Setup<'_>,
    reference: &dyn Reference,
    events: &[TipEvent],
    duration_s: f64,
    start_s: f64,
    random: &mut Random,
) -> Result<Logged, BadInput> {
    let begin = reference.at(0.0).map_err(|Unreachable| Stop::Left(0.0).in_words())?;
    let controller = Controller::new(&setup.control, setup.nominal, setup.truth, setup.robot, &begin.q)?;
    let mut motor = begin.q;
    for (i, joint) in setup.truth.joints.iter().enumerate() {
        motor[i] -= joint.encoder_offset;
    }
    let dt = 1.0 / setup.control.rate_hz / f64::from(setup.control.substeps.max(1));
    let plant =
        Stepper::at_rest(setup.truth, events, start_s, dt, &motor).map_err(|Unreachable| Stop::Left(0.0).in_words())?;
    let ticks = close_loop(setup, reference, duration_s, controller, plant, random).map_err(Stop::in_words)?;
    log(setup, &ticks, duration_s, random)
}

/// Why a run ended early.
enum Stop {
    /// The robot left its workspace at this time [s].
    Left(f64),
    /// At this time [s] this joint (0-based) was further from its reference than any drive would go on with.
    Lost(f64, usize),
}

/// Following error at which a drive trips [rad].
const TRIP_RAD: f64 = 0.5;

impl Stop {
    fn in_words(self) -> BadInput {
        let expected = "expected a motion, drives and effects with which the robot can follow";
        BadInput::new(match self {
            Self::Left(t) => format!("simulation: the robot left its workspace at t = {t:.3} s; {expected}"),
            Self::Lost(t, i) => {
                format!("simulation: joint {} was {TRIP_RAD} rad off its reference at t = {t:.3} s; {expected}", i + 1)
            }
        })
    }
}

/// Runs the loop.
fn close_loop(
    setup: &Setup<'_>,
    reference: &dyn Reference,
    duration_s: f64,
    mut controller: Controller<'_>,
    mut plant: Stepper<'_>,
    random: &mut Random,
) -> Result<Ticks, Stop> {
    let n = setup.truth.joints.len();
    let period = 1.0 / setup.control.rate_hz;
    let substeps = setup.control.substeps.max(1);
    let dt = period / f64::from(substeps);
    let zero = (SETTLE_S / period).ceil() as usize;
    // The log's window and a late torque reach past the last sample.
    let total = zero + (duration_s / period).round() as usize + setup.divider + 2;
    let mut ticks = Ticks::with_capacity(total, zero);
    for tick in 0..total {
        let t = (tick as f64 - zero as f64) * period;
        let (mut position, mut speed, mut reading) = (Joints::default(), Joints::default(), Joints::default());
        for i in 0..n {
            position[i] = plant.motor()[i] + setup.truth.joints[i].encoder_offset;
            speed[i] = plant.motor_speed(i);
            reading[i] = encoder(position[i], setup.encoder_step[i], setup.encoder_noise, random);
        }
        let target = reference.at(t.max(0.0)).map_err(|Unreachable| Stop::Left(t))?;
        let command = controller.command(&reading, &target).map_err(|Unreachable| Stop::Left(t))?;
        let mut drive = Joints::default();
        for i in 0..n {
            drive[i] = setup.truth.joints[i].delivered(command[i]);
            if setup.process_noise[i] > 0.0 {
                drive[i] += setup.process_noise[i] * random.normal();
            }
            let error = (target.q[i] - position[i]).abs();
            if error.is_nan() || error > TRIP_RAD {
                return Err(Stop::Lost(t, i));
            }
            if tick >= zero {
                ticks.error = ticks.error.max(error);
            }
        }
        for k in 0..substeps {
            plant.step(t + f64::from(k) * dt, &drive).map_err(|Unreachable| Stop::Left(t))?;
        }
        ticks.command.push(command);
        ticks.reading.push(reading);
        ticks.position.push(position);
        ticks.speed.push(speed);
    }
    Ok(ticks)
}

/// Reading of an encoder with steps of `step` [rad] and noise in steps; a step of 0 is an ideal encoder.
fn encoder(position: f64, step: f64, noise: f64, random: &mut Random) -> f64 {
    if step > 0.0 {
        let noise = if noise > 0.0 { noise * random.normal() } else { 0.0 };
        ((position / step + noise).round()) * step
    } else {
        position
    }
}

/// Mean of the commands, each held for one tick, over [from, to] in ticks.
fn held_mean(command: &[Joints], i: usize, from: f64, to: f64) -> f64 {
    let at = |k: f64| command.get(k.clamp(0.0, (command.len() - 1) as f64) as usize).map_or(0.0, |c| c[i]);
    let mut sum = 0.0;
    let mut k = from.floor();
    while k < to {
        sum += at(k) * ((k + 1.0).min(to) - k.max(from));
        k += 1.0;
    }
    sum / (to - from)
}

fn log(setup: &Setup<'_>, ticks: &Ticks, duration_s: f64, random: &mut Random) -> Result<Logged, BadInput> {
    let n = setup.truth.joints.len();
    let rate = setup.control.rate_hz;
    let samples = (duration_s * rate / setup.divider as f64).round() as usize;
    let columns = || vec![Vec::with_capacity(samples); n];
    let mut logged = Logged {
        t_s: Vec::with_capacity(samples),
        q_rad: columns(),
        tau_nm: columns(),
        hidden_nm: columns(),
        qd_rad_s: columns(),
        qdd_rad_s2: columns(),
        tracking_error_rad: ticks.error,
    };
    let half = 0.5 * setup.divider as f64;
    let reach = (setup.divider / 2).max(1);
    let late = setup.truth.torque_delay * rate;
    let loads = setup.nominal.loads(0.0, &[]);
    let spike = setup.spikes_per_s * setup.divider as f64 / rate;
    for k in 0..samples {
        let j = ticks.zero + k * setup.divider;
        let at = j as f64;
        let mut acceleration = [0.0; MAX_JOINTS];
        let mut torque = [0.0; MAX_JOINTS];
        for i in 0..n {
            acceleration[i] = (ticks.speed[j + reach][i] - ticks.speed[j - reach][i]) * rate / (2 * reach) as f64;
            torque[i] = held_mean(&ticks.command, i, at - late - half, at - late + half);
        }
        let known = setup
            .nominal
            .mechanism
            .inverse(&ticks.position[j], &ticks.speed[j], &acceleration, &loads)
            .map_err(|_| BadInput::new("simulation: the recorded pose does not exist for the nominal robot"))?;
        logged.t_s.push(k as f64 * setup.divider as f64 / rate);
        for i in 0..n {
            logged.q_rad[i].push(ticks.reading[j][i]);
            logged.qd_rad_s[i].push(ticks.speed[j][i]);
            logged.qdd_rad_s2[i].push(acceleration[i]);
            logged.hidden_nm[i].push(torque[i] - known[i] - setup.nominal.joints[i].rotor * acceleration[i]);
            let mut reading = torque[i] + setup.torque_noise[i] * random.normal();
            if spike > 0.0 && random.unit() < spike {
                reading += random.sign() * random.uniform(20.0, 60.0) * (setup.torque_noise[i] + 1e-3);
            }
            logged.tau_nm[i].push(reading);
        }
    }
    Ok(logged)
}
