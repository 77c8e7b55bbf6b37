//! The smoother stage: measured positions in; position, velocity, acceleration and their standard deviations
//! out. On the stream it is a fixed-lag smoother, offline ([`smooth_recording`]) a full forward-backward one;
//! both run the steps of [`lacuna_estimation::kalman`], where the equations stand.
//!
//! A sample leaves when enough later ones have come (`header.lag_ns` says how much later the newest of them
//! is), with its torque and temperature as measured at its own stamp. A time gap starts anew:
//! [`flag::STATE_RESET`], [`flag::GAP`]; samples before a gap or the end had less future:
//! [`flag::SHORT_LAG`]; a position that is not a number is bridged and flagged [`flag::REPAIRED`].
//!
//! **What is not configured is found from the first samples**: the period from 33 of them, noise (if
//! `process_noise = "auto"`, or if neither configuration, model nor encoder tell the measurement noise) from
//! the first `auto_s` seconds, at most 4096 samples. The stream waits for them once, then runs on; replays
//! are identical.

mod config;
mod offline;

pub use config::{
    Auto, Bandwidth, Config, DEFAULT_BANDWIDTH_HZ, DEFAULT_BANDWIDTH_SHARE, MOST_BANDWIDTH_SHARE, MOST_PROBED,
    MOST_WAITING, ProcessNoise,
};
pub use offline::{settings_for, smooth_recording};

use config::{Known, PERIOD_SAMPLES};
use lacuna_estimation::kalman::{FixedLag, Lag, LagEstimate, Noise, Settings};
use lacuna_interfaces::{BadInput, JointMeasured, JointSmoothed, Stage, StageContext, flag};

/// The stage.
#[derive(Debug, Clone)]
pub struct Smoother {
    known: Known,
    joints: usize,
    /// Samples that wait for the noise to be known; then those that wait in the smoother: a ring.
    waiting: Ring,
    /// True until the first stretch has been looked at.
    probing: bool,
    fixed_lag: FixedLag,
    settings: Settings,
    /// Columns of the first stretch.
    probe_t_s: Vec<f64>,
    probe_q_rad: Vec<f64>,
}

impl Stage for Smoother {
    const NAME: &'static str = "smoother";
    type Config = Config;
    type Input = JointMeasured;
    type Output = JointSmoothed;

    fn new(config: Config, context: &StageContext<'_>) -> Result<Self, BadInput> {
        let joints = context.robot.joint_count();
        let known = Known::new(config, context.robot, context.model)?;
        let probed = if known.needs_data() { MOST_PROBED } else { PERIOD_SAMPLES };
        // Stands in until the noise is known; what counts here is the room it takes.
        let stand_in = Noise { process: 1.0, measurement_sd: 1.0 };
        let settings = known.settings(vec![stand_in; joints], 1.0);
        let fixed_lag = FixedLag::new(&settings, Lag::Samples(MOST_WAITING))?;
        Ok(Self {
            known,
            joints,
            waiting: Ring::new(probed.max(MOST_WAITING) + 2),
            probing: true,
            fixed_lag,
            settings,
            probe_t_s: Vec::with_capacity(probed),
            probe_q_rad: Vec::with_capacity(probed),
        })
    }

    fn step(&mut self, input: &JointMeasured, emit: &mut dyn FnMut(&JointSmoothed)) {
        self.waiting.push(input);
        if !self.probing {
            let newest = self.waiting.len - 1;
            feed(&mut self.fixed_lag, &mut self.waiting, newest, self.joints, emit);
            return;
        }
        let first = self.waiting.get(0).map_or(0, |m| m.header.stamp_ns);
        let seen_s = input.header.stamp_ns.saturating_sub(first) as f64 * 1e-9;
        let len = self.waiting.len;
        let enough = if self.known.needs_data() {
            len >= MOST_PROBED || (len >= PERIOD_SAMPLES && seen_s >= self.known.auto_s())
        } else {
            len >= PERIOD_SAMPLES || self.known.period_s().is_some()
        };
        if enough {
            self.conclude_probe(emit);
        }
    }

    fn finish(&mut self, emit: &mut dyn FnMut(&JointSmoothed)) {
        if self.probing && self.waiting.len > 0 {
            self.conclude_probe(emit);
        }
        let waiting = &mut self.waiting;
        let joints = self.joints;
        self.fixed_lag.finish(&mut |estimate| give_out(waiting, joints, estimate, emit));
    }
}

impl Smoother {
    /// Settles period and noise from the samples that wait, and runs them through the smoother.
    fn conclude_probe(&mut self, emit: &mut dyn FnMut(&JointSmoothed)) {
        self.probing = false;
        let count = self.waiting.len;
        let stamp = |k: usize| self.waiting.get(k).map_or(0, |m| m.header.stamp_ns);
        let origin = stamp(0);
        let period_s = self.known.period_s().unwrap_or_else(|| self.waiting.period_s());
        // Noise is judged on the samples before the first stamp that does not increase.
        self.probe_t_s.clear();
        for k in 0..count.min(MOST_PROBED) {
            let t = stamp(k).saturating_sub(origin) as f64 * 1e-9;
            if self.probe_t_s.last().is_some_and(|last| t <= *last) {
                break;
            }
            self.probe_t_s.push(t);
        }
        for j in 0..self.joints {
            self.probe_q_rad.clear();
            let q = (0..self.probe_t_s.len()).filter_map(|k| self.waiting.get(k)).map(|m| m.q_rad[j]);
            self.probe_q_rad.extend(q);
            self.settings.noise[j] = self.known.noise(j, period_s, &self.probe_t_s, &self.probe_q_rad);
        }
        self.settings.gap_s = self.known.gap_s(period_s);
        let lag = self.known.lag(&self.settings.noise, period_s);
        // Noise found is positive and the lag within the room; were it ever not, the stand-in noise goes on.
        let _kept = self.fixed_lag.set(&self.settings, lag, &mut |_| ());
        for k in 0..count {
            // Those given out meanwhile have left the front of the ring.
            let place = k - (count - self.waiting.len);
            feed(&mut self.fixed_lag, &mut self.waiting, place, self.joints, emit);
        }
    }
}

/// Takes the waiting sample at `place` into the smoother and gives out those that are ready.
fn feed(
    fixed_lag: &mut FixedLag,
    waiting: &mut Ring,
    place: usize,
    joints: usize,
    emit: &mut dyn FnMut(&JointSmoothed),
) {
    let Some(input) = waiting.get(place) else { return };
    let (stamp_ns, q_rad) = (input.header.stamp_ns, input.q_rad);
    let q_rad = &q_rad[..joints];
    fixed_lag.push(stamp_ns, q_rad, &mut |estimate| give_out(waiting, joints, estimate, emit));
}

/// Joins an estimate with the oldest waiting sample, whose it is.
fn give_out(waiting: &mut Ring, joints: usize, estimate: &LagEstimate<'_>, emit: &mut dyn FnMut(&JointSmoothed)) {
    let Some(measured) = waiting.pop() else { return };
    let mut output = JointSmoothed {
        header: measured.header,
        tau_nm: measured.tau_nm,
        temperature_degc: measured.temperature_degc,
        ..JointSmoothed::default()
    };
    let header = &mut output.header;
    header.lag_ns = estimate.newest_ns.saturating_sub(estimate.stamp_ns).max(0).unsigned_abs();
    for (set, bit) in [
        (estimate.start, flag::STATE_RESET),
        (estimate.gap, flag::GAP),
        (estimate.short, flag::SHORT_LAG),
        (estimate.bridged, flag::REPAIRED),
    ] {
        if set {
            header.flags |= bit;
        }
    }
    for (j, state) in estimate.joints.iter().enumerate().take(joints) {
        output.q_rad[j] = state.q;
        output.qd_rad_s[j] = state.qd;
        output.qdd_rad_s2[j] = state.qdd;
        output.sd_q_rad[j] = state.sd_q;
        output.sd_qd_rad_s[j] = state.sd_qd;
        output.sd_qdd_rad_s2[j] = state.sd_qdd;
    }
    emit(&output);
}

/// Waiting samples, oldest first, in a ring of fixed size.
#[derive(Debug, Clone)]
struct Ring {
    samples: Vec<JointMeasured>,
    first: usize,
    len: usize,
}

impl Ring {
    fn new(room: usize) -> Self {
        Self { samples: vec![JointMeasured::default(); room], first: 0, len: 0 }
    }

    /// Adds a sample. The smoother gives out samples before the ring is full.
    fn push(&mut self, sample: &JointMeasured) {
        let place = (self.first + self.len) % self.samples.len();
        self.samples[place] = *sample;
        self.len = (self.len + 1).min(self.samples.len());
    }

    fn get(&self, place: usize) -> Option<&JointMeasured> {
        if place < self.len { self.samples.get((self.first + place) % self.samples.len()) } else { None }
    }

    fn pop(&mut self) -> Option<JointMeasured> {
        let oldest = *self.get(0)?;
        self.first = (self.first + 1) % self.samples.len();
        self.len -= 1;
        Some(oldest)
    }

    /// Median of the first steps between stamps [s]; a millisecond where there is none.
    fn period_s(&self) -> f64 {
        let mut steps = [0i64; PERIOD_SAMPLES - 1];
        let mut count = 0;
        for k in 1..self.len.min(PERIOD_SAMPLES) {
            if let (Some(a), Some(b)) = (self.get(k - 1), self.get(k)) {
                let step = b.header.stamp_ns.saturating_sub(a.header.stamp_ns);
                if step > 0 {
                    steps[count] = step;
                    count += 1;
                }
            }
        }
        steps[..count].sort_unstable();
        steps[..count].get(count / 2).map_or(1e-3, |step| *step as f64 * 1e-9)
    }
}
