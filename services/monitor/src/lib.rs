//! The monitor stage: an alarm per joint when the torque residual leaves what the model and its noise allow.
//!
//! ```text
//! m_b = mean of the residual over a block of sliding          z_b = (m_b/s_b − r m_{b−1}/s_{b−1}) / u
//! S ← max(0, S + ½ (1 − 1/ρ²) z_b² − ln ρ)                     alarm: S ≥ h = ln(blocks between false alarms)
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | m_b, s_b | block mean and the standard deviation it may have | Nm |
//! | r, u | correlation of successive blocks, standard deviation of what is new in one | – |
//! | ρ | growth of the residual that is found quickest, `growth` | – |
//! | S, h | evidence and its threshold | nats |
//!
//! **The test** is Page's CUSUM of the log-likelihood ratio "ρ times the noise" against "the noise": it answers to a
//! mismatch of either sign, brief and large as well as small and lasting, and to one that changes sign with the motion,
//! as friction does. For independent blocks the mean time between false alarms of such a CUSUM is at least e^h blocks
//! (Lorden 1971, theorem 2), so h follows from `false_alarms_per_hour`, shared out over the joints; the real rate lies
//! somewhat below it.
//!
//! **The noise.** Residuals are correlated: filtered, and the model's own small errors repeat with the motion. Blocks
//! take in the correlation that is shorter than they are, r and u what reaches into the next. One part of s² is the
//! noise: it starts at the model file's `noise.sd_tau_nm` (all noise in one: nothing is larger) and is learnt downwards
//! over `learn_s`, by octaves of acceleration, since smoothing and model err more where the motion is sharp. It never
//! exceeds the model file's, never falls below what independent samples would give, and is not learnt under an alarm.
//! The other part is the share `model_error` of the block's model torque. A joint without noise in the model file is
//! not watched.
//!
//! **What is left out**: standing joints and the moments about a reversal (friction holds any torque there), the start
//! of a stretch, samples without a model torque or with the drive off.
//!
//! **Where.** Since the onset of the evidence the mean residual is mapped over velocity, position and load; under an
//! alarm the variable that explains most of it names the region.

mod region;
mod watch;

use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, PayloadEstimate, ResidualWatch, Stage, StageContext, flag};
use serde::Deserialize;
use watch::{Slide, Test, Watch};

/// Which residual is watched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Residual {
    /// Measured torque less the model without payload: a load that is picked up is a mismatch.
    #[default]
    Model,
    /// Less the estimated payload too: for robots that carry loads on purpose.
    Payload,
}

/// Configuration of the monitor. Everything has a default.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// False alarms of the whole robot per hour of motion that are accepted.
    pub false_alarms_per_hour: f64,
    /// Time of sliding over which a residual is averaged [s].
    pub block_s: f64,
    /// Growth of the residual against its noise that is to be found quickest.
    pub growth: f64,
    /// Time of sliding over which the noise is learnt [s].
    pub learn_s: f64,
    /// Share of the model torque that the model may be wrong by, beyond what its noise tells.
    pub model_error: f64,
    /// Samples of a joint within this time of its reversal are left out [s].
    pub reversal_s: f64,
    /// Speed below which a joint counts as standing still [rad/s], where the model file gives none.
    pub standstill_rad_s: f64,
    /// Which residual is watched.
    pub residual: Residual,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            false_alarms_per_hour: 0.1,
            block_s: 0.1,
            growth: 2.0,
            learn_s: 60.0,
            model_error: 0.0,
            reversal_s: 0.03,
            standstill_rad_s: 0.02,
            residual: Residual::Model,
        }
    }
}

impl Config {
    fn validate(&self) -> Result<(), BadInput> {
        for (key, v) in [
            ("false_alarms_per_hour", self.false_alarms_per_hour),
            ("block_s", self.block_s),
            ("learn_s", self.learn_s),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return Err(BadInput::new(format!("{key}: found {v}; expected a positive number")));
            }
        }
        for (key, v) in [
            ("reversal_s", self.reversal_s),
            ("standstill_rad_s", self.standstill_rad_s),
            ("model_error", self.model_error),
        ] {
            if !(v.is_finite() && v >= 0.0) {
                return Err(BadInput::new(format!("{key}: found {v}; expected zero or a positive number")));
            }
        }
        if !(self.growth > 1.0 && self.growth <= 100.0) {
            let v = self.growth;
            return Err(BadInput::new(format!("growth: found {v}; expected a number above 1, at most 100")));
        }
        if self.learn_s < 10.0 * self.block_s {
            return Err(BadInput::new(format!(
                "learn_s: found {}; expected at least ten times block_s = {}",
                self.learn_s, self.block_s
            )));
        }
        // Fewer than a handful of blocks between false alarms is no test any more.
        let blocks = 3600.0 / (self.false_alarms_per_hour * self.block_s);
        if blocks < 10.0 {
            return Err(BadInput::new(format!(
                "false_alarms_per_hour: found {}; expected at most {:.0} with block_s = {}",
                self.false_alarms_per_hour,
                360.0 / self.block_s,
                self.block_s
            )));
        }
        Ok(())
    }
}

/// Samples from which nothing is learnt, whatever the joints do.
const UNUSABLE: u32 = flag::DRIVE_OFF | flag::UNREACHABLE | flag::SHORT_LAG;

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Motion {
    last_qd: f64,
    /// Time since the joint last stood or reversed [s].
    sliding_s: f64,
}

impl Motion {
    /// The acceleration [rad/s²] if the joint slides, did so for `margin_s` and will for as long at this rate.
    fn slides(&mut self, qd: f64, standstill: f64, dt: f64, margin_s: f64) -> Option<f64> {
        let change = qd - self.last_qd;
        let reversed = self.last_qd * qd <= 0.0;
        self.last_qd = if qd.is_finite() { qd } else { 0.0 };
        if !qd.is_finite() || qd.abs() < standstill || reversed || dt <= 0.0 {
            self.sliding_s = 0.0;
            return None;
        }
        self.sliding_s += dt;
        // Time to standstill qd/−q̈ with q̈ = change/dt, compared without dividing.
        let stops_soon = change * qd < 0.0 && qd.abs() * dt < margin_s * change.abs();
        (self.sliding_s >= margin_s && !stops_soon).then_some(change / dt)
    }
}

/// The stage.
#[derive(Debug, Clone)]
pub struct Monitor {
    config: Config,
    test: Test,
    count: usize,
    standstill_rad_s: Joints,
    /// Joints whose noise is known.
    watched: u32,
    joints: [Watch; MAX_JOINTS],
    motion: [Motion; MAX_JOINTS],
    last_ns: Option<i64>,
    /// Time since the stretch began [s]: the smoother's first samples are uncertain.
    since_start_s: f64,
}

impl Stage for Monitor {
    const NAME: &'static str = "monitor";
    type Config = Config;
    type Input = PayloadEstimate;
    type Output = ResidualWatch;

    fn new(config: Config, context: &StageContext<'_>) -> Result<Self, BadInput> {
        config.validate()?;
        let count = context.robot.message_joints()?;
        let mut sd: &[f64] = &[];
        let mut standstill_rad_s = [config.standstill_rad_s; MAX_JOINTS];
        if let Some(model) = context.model {
            model.check(context.robot)?;
            sd = &model.noise.sd_tau_nm;
            for (slot, v) in standstill_rad_s.iter_mut().zip(&model.friction.standstill_rad_s) {
                *slot = v.max(0.0);
            }
        }
        let known = |i: usize| sd.get(i).copied().filter(|v| *v > 0.0);
        let watched = (0..count).filter(|&i| known(i).is_some()).map(|i| 1 << i).sum();
        // Every joint may raise its share of the false alarms.
        let blocks = 3600.0 * count as f64 / (config.false_alarms_per_hour * config.block_s);
        let test = Test {
            block_s: config.block_s,
            growth: config.growth,
            threshold: blocks.ln(),
            memory: config.learn_s / config.block_s,
            model_error: config.model_error,
        };
        Ok(Self {
            config,
            test,
            count,
            standstill_rad_s,
            watched,
            joints: std::array::from_fn(|i| Watch::new(known(i).unwrap_or(0.0))),
            motion: [Motion::default(); MAX_JOINTS],
            last_ns: None,
            since_start_s: 0.0,
        })
    }

    fn step(&mut self, input: &PayloadEstimate, emit: &mut dyn FnMut(&ResidualWatch)) {
        let header = &input.header;
        let dt = self.last_ns.map_or(0.0, |last| header.stamp_ns.saturating_sub(last).max(0) as f64 * 1e-9);
        self.last_ns = Some(header.stamp_ns);
        if header.flags & (flag::STATE_RESET | flag::GAP) != 0 {
            self.since_start_s = 0.0;
            self.motion = [Motion::default(); MAX_JOINTS];
            self.joints.iter_mut().for_each(Watch::break_off);
        } else {
            self.since_start_s += dt;
        }
        let usable = header.flags & UNUSABLE == 0 && self.since_start_s >= 2.0 * self.config.reversal_s;
        let residual = match self.config.residual {
            Residual::Model => &input.residual_nm,
            Residual::Payload => &input.residual_payload_nm,
        };
        for i in (0..self.count).filter(|&i| self.watched >> i & 1 == 1) {
            let qd = input.qd_rad_s[i];
            let qdd = self.motion[i].slides(qd, self.standstill_rad_s[i], dt, self.config.reversal_s);
            let Some(qdd) = qdd.filter(|_| usable && residual[i].is_finite()) else {
                self.joints[i].pause();
                continue;
            };
            let slide = Slide {
                stamp_ns: header.stamp_ns,
                dt_s: dt,
                q_rad: input.q_rad[i],
                qd_rad_s: qd,
                qdd_rad_s2: qdd,
                load_nm: input.tau_model_nm[i],
                residual_nm: residual[i],
            };
            self.joints[i].take(&slide, &self.test);
        }
        emit(&self.message(input));
    }

    fn finish(&mut self, _emit: &mut dyn FnMut(&ResidualWatch)) {}
}

impl Monitor {
    fn message(&self, input: &PayloadEstimate) -> ResidualWatch {
        let mut out = ResidualWatch { header: input.header, watched: self.watched, ..ResidualWatch::default() };
        for i in (0..self.count).filter(|&i| self.watched >> i & 1 == 1) {
            let joint = &self.joints[i];
            out.residual_nm[i] = joint.last_nm;
            out.sd_nm[i] = joint.last_sd_nm;
            out.score[i] = joint.score(&self.test);
            if out.score[i] > 0.0 {
                out.since_ns[i] = joint.since_ns;
            }
            if joint.alarm {
                out.alarm |= 1 << i;
                (out.region_variable[i], out.region_low[i], out.region_high[i]) = joint.place;
            }
        }
        if out.alarm != 0 {
            out.header.flags |= flag::MISMATCH;
        }
        out
    }
}
