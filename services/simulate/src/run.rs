//! One trajectory in closed loop: controller ticks, plant steps, and the drive's log.

use crate::control::{ControlConfig, Controller};
use crate::log::{Log, LogSettings, Logged, Tick};
use crate::plant::robot::TipEvent;
use crate::plant::{Stepper, TrueRobot, Unreachable};
use crate::random::Random;
use crate::reference::Reference;
use lacuna_interfaces::{BadInput, Joints, RobotFile};

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

/// Simulates one trajectory of `duration_s` that starts `start_s` after the cold drives were switched on.
/// `random` draws for the loop and for the log.
///
/// # Errors
/// [`BadInput`] if the robot leaves its workspace.
pub fn run(
    setup: &Setup<'_>,
    reference: &dyn Reference,
    events: &[TipEvent],
    duration_s: f64,
    start_s: f64,
    random: [Random; 2],
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
    let rate_hz = setup.control.rate_hz;
    let settings = LogSettings {
        rate_hz,
        divider: setup.divider,
        samples: (duration_s * rate_hz / setup.divider as f64).round() as usize,
        zero: (SETTLE_S * rate_hz).ceil() as usize,
        delay_s: setup.truth.torque_delay,
        noise: setup.torque_noise,
        spikes_per_s: setup.spikes_per_s,
    };
    let [loop_random, log_random] = random;
    let log = Log::new(settings, setup.nominal, log_random);
    close_loop(setup, reference, controller, plant, log, settings.zero, loop_random)
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

/// Runs the loop until the log is full; the first sample is that of tick `zero`.
fn close_loop(
    setup: &Setup<'_>,
    reference: &dyn Reference,
    mut controller: Controller<'_>,
    mut plant: Stepper<'_>,
    mut log: Log<'_>,
    zero: usize,
    mut random: Random,
) -> Result<Logged, BadInput> {
    let n = setup.truth.joints.len();
    let period = 1.0 / setup.control.rate_hz;
    let substeps = setup.control.substeps.max(1);
    let dt = period / f64::from(substeps);
    let mut worst = 0.0f64;
    let mut ticks = 0usize;
    while !log.is_full() {
        let t = (ticks as f64 - zero as f64) * period;
        let left = |Unreachable| Stop::Left(t).in_words();
        let (mut position, mut speed, mut reading) = (Joints::default(), Joints::default(), Joints::default());
        for i in 0..n {
            position[i] = plant.motor()[i] + setup.truth.joints[i].encoder_offset;
            speed[i] = plant.motor_speed(i);
            reading[i] = encoder(position[i], setup.encoder_step[i], setup.encoder_noise, &mut random);
        }
        let target = reference.at(t.max(0.0)).map_err(left)?;
        let command = controller.command(&reading, &target).map_err(left)?;
        let mut drive = Joints::default();
        for i in 0..n {
            drive[i] = setup.truth.joints[i].delivered(command[i]);
            if setup.process_noise[i] > 0.0 {
                drive[i] += setup.process_noise[i] * random.normal();
            }
            let error = (target.q[i] - position[i]).abs();
            if error.is_nan() || error > TRIP_RAD {
                return Err(Stop::Lost(t, i).in_words());
            }
            worst = if ticks >= zero { worst.max(error) } else { worst };
        }
        for k in 0..substeps {
            plant.step(t + f64::from(k) * dt, &drive).map_err(left)?;
        }
        log.push(Tick { command, reading, position, speed, reference: target.q })?;
        ticks += 1;
    }
    Ok(log.finish(worst))
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
