//! Simulated robots with models identified from their recordings, and recordings run through all stages.

#![allow(dead_code, reason = "each test file uses a part of this")]

use lacuna_friction::Friction;
use lacuna_identify::Options;
use lacuna_interfaces::{
    JointMeasured, ModelFile, PayloadEstimate, Recording, ResidualWatch, RobotFile, Stage, StageContext,
};
use lacuna_monitor::Monitor;
use lacuna_payload::Payload;
use lacuna_simulate::case::{Case, CaseOptions, draw_case};
use lacuna_simulate::{SimulationConfig, TrueEffect, simulate};
use lacuna_smoother::Smoother;
use lacuna_torque::Torque;

/// A robot, a model identified from clean recordings of it, and what simulates more of them.
pub struct Identified {
    pub robot: RobotFile,
    pub model: ModelFile,
    config: SimulationConfig,
    training: usize,
    seed: u64,
}

/// The case that robot number `seed` is drawn from.
fn case(seed: u64, ids: &[&str]) -> Case {
    let options = CaseOptions {
        effects: ids.len(),
        ids: ids.iter().map(|s| (*s).to_owned()).collect(),
        severity: [1.0, 1.0],
        mass_error: 0.02,
        trajectories: 12,
        duration_s: 6.0,
        ..CaseOptions::default()
    };
    draw_case(seed, &options).unwrap()
}

impl Identified {
    /// Robot and model number `seed`: masses 2 % off, twelve motions of 6 s to identify from.
    pub fn new(seed: u64) -> Self {
        let case = case(seed, &[]);
        let training = simulate(&case.robot, None, &case.config).unwrap().recordings;
        let body = lacuna_physics::build(&case.robot, None).unwrap();
        let count = training.len();
        let outcome = lacuna_identify::identify_recordings(
            &Options::default(),
            &case.robot,
            body.as_ref(),
            training,
            &(Vec::new(), Vec::new()),
            &mut |_, _| (),
        )
        .unwrap();
        Self { robot: case.robot, model: outcome.model, config: case.config, training: count, seed }
    }

    /// An effect of usual strength for this robot.
    pub fn effect(&self, id: &str) -> TrueEffect {
        let case = case(self.seed, &[id]);
        assert_eq!(case.robot, self.robot, "the robot is drawn before its effects");
        case.config.effects[0].clone()
    }

    /// `seconds` of motions like those of the training, none of which the model has seen; clean, or with effects.
    pub fn recordings(&self, seconds: f64, effects: &[TrueEffect]) -> Vec<Recording> {
        self.simulation(seconds, effects).0
    }

    /// The same, with begin and end of what happened in each recording [s].
    pub fn simulation(&self, seconds: f64, effects: &[TrueEffect]) -> (Vec<Recording>, Vec<Option<(f64, f64)>>) {
        let mut config = self.config.clone();
        let duration: f64 = config.trajectories.iter().map(|g| g.duration_s * f64::from(g.count)).sum();
        // The same robot; motions after those of the training come from streams of their own.
        let rounds = (seconds / duration).ceil() as usize + 1;
        config.trajectories =
            config.trajectories.iter().cycle().take(rounds * config.trajectories.len()).cloned().collect();
        config.effects = effects.to_vec();
        let simulation = simulate(&self.robot, None, &config).unwrap();
        let event = |r: &Recording| simulation.truth.events.get(&r.name)?.first().map(|e| (e.t_on, e.t_off));
        let events = simulation.recordings.iter().skip(self.training).map(event).collect();
        (simulation.recordings.into_iter().skip(self.training).collect(), events)
    }

    fn context(&self) -> StageContext<'_> {
        StageContext { robot: &self.robot, urdf: None, model: Some(&self.model) }
    }

    /// The stages before the monitor.
    pub fn residuals(&self, recordings: &[Recording]) -> Vec<PayloadEstimate> {
        let context = self.context();
        let mut smoother = Smoother::new(Default::default(), &context).unwrap();
        let mut torque = Torque::new(Default::default(), &context).unwrap();
        let mut friction = Friction::new(Default::default(), &context).unwrap();
        let mut payload = Payload::new(Default::default(), &context).unwrap();
        let (mut smoothed, mut out) = (Vec::new(), Vec::new());
        for m in measured(recordings) {
            smoother.step(&m, &mut |o| smoothed.push(*o));
        }
        smoother.finish(&mut |o| smoothed.push(*o));
        for m in &smoothed {
            torque.step(m, &mut |t| friction.step(t, &mut |f| payload.step(f, &mut |p| out.push(*p))));
        }
        out
    }

    /// The monitor with this configuration.
    pub fn monitor(&self, config: &str) -> Monitor {
        Monitor::new(toml::from_str(config).unwrap(), &self.context()).unwrap()
    }
}

/// Recordings one after the other, with pauses of a second that the smoother takes for gaps.
fn measured(recordings: &[Recording]) -> Vec<JointMeasured> {
    let mut out: Vec<JointMeasured> = Vec::new();
    let mut start_ns: i64 = 0;
    for r in recordings {
        let first_s = r.t_s.first().copied().unwrap_or(0.0);
        for k in 0..r.len() {
            let mut m = JointMeasured { temperature_degc: [f64::NAN; 8], ..JointMeasured::default() };
            m.header.seq = out.len() as u64 + 1;
            m.header.stamp_ns = start_ns + ((r.t_s[k] - first_s) * 1e9).round() as i64;
            m.header.joints = r.joints.len() as u32;
            for j in 0..r.joints.len() {
                m.q_rad[j] = r.q_rad[j][k];
                m.tau_nm[j] = r.tau_nm[j][k];
            }
            out.push(m);
        }
        start_ns = out.last().map_or(0, |m| m.header.stamp_ns) + 1_000_000_000;
    }
    out
}

/// What the monitor says of every sample.
pub fn watch(monitor: &mut Monitor, samples: &[PayloadEstimate]) -> Vec<ResidualWatch> {
    let mut out = Vec::with_capacity(samples.len());
    samples.iter().for_each(|s| monitor.step(s, &mut |o| out.push(*o)));
    out
}

/// Alarms that begin, over all joints.
pub fn onsets(messages: &[ResidualWatch]) -> u32 {
    messages.windows(2).map(|w| (w[1].alarm & !w[0].alarm).count_ones()).sum()
}
