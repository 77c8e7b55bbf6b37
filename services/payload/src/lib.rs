//! The payload stage: the mass at the platform or tip, by recursive least squares in torque space.
//!
//! ```text
//! ΔT = τ − τ_rigid − τ_friction = m_p φ + e,   φ = Jᵀγ (serial arms: the tip-mass column)
//! once a sample  P ← P/σ,  σ = exp(−dt/forgetting_s)
//! row by row     K = P φ_i/(r_i + φ_i² P),  m̂ ← m̂ + K (ΔT_i − φ_i m̂),  P ← (1 − K φ_i) P
//! ```
//!
//! (NOTATION.md: a scalar in torque space instead of the paper's eq. 9-11, which divide by k_ii and
//! wind up; with r_i = 1 and σ taken into the first row it is the form printed there.)
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | m̂, P | mass and its variance for independent errors | kg, kg² |
//! | φ_i | torque per kilogram on joint i at this motion | Nm/kg |
//! | r_i | variance of joint i's innovation, tracked | Nm² |
//! | σ | forgetting over one sample | – |
//!
//! **Which rows count.** Not those of a standing joint, whose friction holds any torque; not those close to a
//! reversal, where the sign of friction and the smoothed acceleration are uncertain; not those at the edges
//! of a stretch, with the drive off, or without a model torque. Outliers are weighted down (Huber).
//!
//! **Pick and place.** Two windows over the last moments (`detection_s` and six times that) ask whether another
//! mass explains the innovations: likelihood ratio above 25 (5 standard deviations of the errors as correlated
//! as they are), *and* most of the misfit gone with it (a wrong friction sign or a collision is not explained
//! by mass), *and* a change that matters. Then the estimate starts anew from the samples that follow
//! ([`flag::PAYLOAD_STEP`]).
//!
//! **Honest doubt.** `sd_mass_kg` includes the correlation of the errors, over time and between joints, as
//! measured from the scores of blocks. [`flag::NOT_EXCITED`] is set where it, or what the windows alone could
//! tell, is above `max_sd_kg`, or where no joint has slid for a moment: a load could change then unseen. P
//! never exceeds its start value (no wind-up).
//!
//! The mass comes on top of a payload already contained in the model (`payload.mass_kg` of the model file).

mod estimator;
mod joint;

use estimator::{Estimator, Row};
use joint::Joint;
use lacuna_interfaces::{BadInput, FrictionTorque, MAX_JOINTS, PayloadEstimate, Stage, StageContext, flag};
use serde::Deserialize;

/// Configuration of the payload stage. Everything has a default.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Time constant with which the estimate forgets [s].
    pub forgetting_s: f64,
    /// Time constant of the shorter window that looks for a pick or place [s].
    pub detection_s: f64,
    /// Rows of a joint within this time of its reversal are left out [s]: about 1.2/bandwidth of the smoother.
    pub reversal_s: f64,
    /// Largest standard deviation with which the mass counts as known [kg], and smallest step that counts.
    /// Default: 3 % of the mass that would ask for as much torque as was measured.
    pub max_sd_kg: Option<f64>,
    /// Standard deviation of the mass before anything is known [kg].
    pub prior_sd_kg: f64,
    /// Publish negative estimates as 0. Off by default: their scatter about zero is information.
    pub clamp_at_zero: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            forgetting_s: 0.5,
            detection_s: 0.02,
            reversal_s: 0.015,
            max_sd_kg: None,
            prior_sd_kg: 1000.0,
            clamp_at_zero: false,
        }
    }
}

impl Config {
    fn validate(&self) -> Result<(), BadInput> {
        for (key, v) in [
            ("forgetting_s", self.forgetting_s),
            ("detection_s", self.detection_s),
            ("prior_sd_kg", self.prior_sd_kg),
            ("max_sd_kg", self.max_sd_kg.unwrap_or(1.0)),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return Err(BadInput::new(format!("{key}: found {v}; expected a positive number")));
            }
        }
        if !(self.reversal_s.is_finite() && self.reversal_s >= 0.0) {
            let v = self.reversal_s;
            return Err(BadInput::new(format!("reversal_s: found {v}; expected zero or a positive number")));
        }
        if self.detection_s > self.forgetting_s {
            return Err(BadInput::new(format!(
                "detection_s: found {}; expected at most forgetting_s = {}",
                self.detection_s, self.forgetting_s
            )));
        }
        Ok(())
    }
}

/// Samples from which nothing is learnt, whatever the joints do.
const UNUSABLE: u32 = flag::DRIVE_OFF | flag::UNREACHABLE | flag::SHORT_LAG;

/// The stage.
#[derive(Debug, Clone)]
pub struct Payload {
    config: Config,
    joints: [Joint; MAX_JOINTS],
    count: usize,
    estimator: Estimator,
    last_ns: Option<i64>,
    /// Time since the stretch began [s]: the smoother's first samples are uncertain.
    since_start_s: f64,
}

impl Stage for Payload {
    const NAME: &'static str = "payload";
    type Config = Config;
    type Input = FrictionTorque;
    type Output = PayloadEstimate;

    fn new(config: Config, context: &StageContext<'_>) -> Result<Self, BadInput> {
        config.validate()?;
        let count = context.robot.message_joints()?;
        let mut known_sd: &[f64] = &[];
        if let Some(model) = context.model {
            model.check(context.robot)?;
            known_sd = &model.noise.sd_tau_nm;
        }
        let joints = std::array::from_fn(|i| Joint::new(known_sd.get(i).copied()));
        let estimator = Estimator::new(&config);
        Ok(Self { config, joints, count, estimator, last_ns: None, since_start_s: 0.0 })
    }

    fn step(&mut self, input: &FrictionTorque, emit: &mut dyn FnMut(&PayloadEstimate)) {
        let header = &input.header;
        let dt = self.last_ns.map_or(0.0, |last| header.stamp_ns.saturating_sub(last).max(0) as f64 * 1e-9);
        self.last_ns = Some(header.stamp_ns);
        if header.flags & flag::STATE_RESET != 0 {
            self.since_start_s = 0.0;
            self.joints.iter_mut().for_each(Joint::start);
        } else {
            self.since_start_s += dt;
        }
        self.estimator.forget(dt);

        let usable = header.flags & UNUSABLE == 0 && self.since_start_s >= 2.0 * self.config.reversal_s;
        let mut rows = [Row::default(); MAX_JOINTS];
        let mut len = 0;
        let mut residual = [0.0; MAX_JOINTS];
        for i in 0..self.count {
            residual[i] = input.tau_nm[i] - input.tau_rigid_nm[i] - input.tau_friction_nm[i];
            let standing = input.standstill >> i & 1 == 1;
            let sliding = self.joints[i].slides(input.qd_rad_s[i], standing, dt, self.config.reversal_s);
            let column = input.payload_column_nm_kg[i];
            if usable && sliding && residual[i].is_finite() && column.is_finite() {
                rows[len] = Row { joint: i, column, residual: residual[i], torque: input.tau_nm[i], ..Row::default() };
                len += 1;
            }
        }
        let stepped = self.estimator.update(&mut rows[..len], &mut self.joints, dt);

        let mut output = PayloadEstimate {
            header: input.header,
            q_rad: input.q_rad,
            qd_rad_s: input.qd_rad_s,
            tau_nm: input.tau_nm,
            residual_nm: residual,
            mass_kg: self.estimator.mass_kg(),
            sd_mass_kg: self.estimator.sd_kg(),
            ..PayloadEstimate::default()
        };
        if self.config.clamp_at_zero {
            output.mass_kg = output.mass_kg.max(0.0);
        }
        for i in 0..self.count {
            output.tau_model_nm[i] = input.tau_rigid_nm[i] + input.tau_friction_nm[i];
            output.residual_payload_nm[i] = residual[i] - output.mass_kg * input.payload_column_nm_kg[i];
        }
        if stepped {
            output.header.flags |= flag::PAYLOAD_STEP;
        }
        if header.flags & UNUSABLE != 0 || !self.estimator.supported() {
            output.header.flags |= flag::NOT_EXCITED;
        }
        emit(&output);
    }

    fn finish(&mut self, _emit: &mut dyn FnMut(&PayloadEstimate)) {}
}
