//! The friction stage: adds friction and the model file's further terms to the rigid-body torque.
//!
//! ```text
//! sliding, abs θ̇ ≥ v_s:     τ_f = f_v θ̇ + f_c sgn θ̇ + offset + Σ terms
//! standing, abs θ̇ < v_s:    τ_f = f_v θ̇ + h         + offset + Σ terms,
//!                            h = clamp(τ − τ_rigid − f_v θ̇ − offset − Σ terms, ± f_c)
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | f_v, f_c, offset | friction of the model file, per joint | Nm s/rad, Nm, Nm |
//! | v_s | standstill speed: model file's, else the configuration's | rad/s |
//! | h | what holds a standing joint: whatever balances the rest, at most f_c | Nm |
//! | τ, τ_rigid | measured and rigid-body torque | Nm |
//!
//! The paper's Φ = [θ̇, sgn θ̇] goes with [f_v, f_c] (NOTATION.md, erratum 6).
//!
//! **Standstill.** A stuck joint holds any torque within ± f_c, so no model can say what its friction is.
//! A smooth sign would put a number there that is wrong by up to f_c; the stage instead attributes to
//! friction what friction can explain, and says so: the joint's bit in `standstill` and
//! [`flag::STANDSTILL`] are set, and later stages leave the joint out. What exceeds ± f_c remains in the
//! residual, since a stuck joint cannot explain that.
//!
//! **Terms.** All `[[term]]`s of the model file run here, whatever stage their cause belongs to: this is the
//! first stage that has motion, rigid-body torque and temperature together. They are those of the catalogue
//! ([`lacuna_physics::effects`]), see the friction above as part of the drive's torque, take the direction of a
//! standing joint as 0, and start anew at [`flag::STATE_RESET`], [`flag::GAP`] and [`flag::UNREACHABLE`]; where
//! there is no rigid-body torque there are no terms. A payload that the model file knows with its times is
//! thereby gone from what the payload stage sees.

use lacuna_interfaces::{BadInput, FrictionTorque, Joints, MAX_JOINTS, Stage, StageContext, TorqueModel, flag};
use lacuna_physics::effects::{EffectContext, TermInput, Terms, build_terms};
use lacuna_physics::{build, parameters_of};
use serde::Deserialize;

/// Configuration of the friction stage.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Speed below which a joint counts as standing still [rad/s], where the model file gives none.
    pub standstill_rad_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { standstill_rad_s: 0.02 }
    }
}

/// The stage.
pub struct Friction {
    joints: usize,
    f_v: Joints,
    f_c: Joints,
    offset: Joints,
    standstill_rad_s: Joints,
    /// Speed over which terms ramp the sign of speeds that are no joint's own [rad/s].
    ramp_rad_s: f64,
    terms: Option<Terms>,
}

impl Friction {
    /// Velocity of joint `i`, and its direction of sliding: 0 if it stands still. A velocity that is not a
    /// number is no motion: the joint is then reported as standing.
    fn sliding(&self, qd: &Joints, i: usize) -> (f64, f64) {
        let qd = if qd[i].is_finite() { qd[i] } else { 0.0 };
        let slides = qd.abs() >= self.standstill_rad_s[i] && qd != 0.0;
        (qd, if slides { qd.signum() } else { 0.0 })
    }

    /// Adds the torque of all terms to the friction in `tau_nm`.
    fn add_terms(&mut self, input: &TorqueModel, direction: &Joints, tau_nm: &mut Joints) {
        let Some(terms) = &mut self.terms else { return };
        if input.header.flags & (flag::STATE_RESET | flag::GAP | flag::UNREACHABLE) != 0 {
            terms.reset();
        }
        if input.header.has(flag::UNREACHABLE) {
            return;
        }
        let sample = TermInput {
            stamp_ns: input.header.stamp_ns,
            q_rad: &input.q_rad,
            qd_rad_s: &input.qd_rad_s,
            qdd_rad_s2: &input.qdd_rad_s2,
            direction,
            ramp_rad_s: self.ramp_rad_s,
            tau_rigid_nm: &input.tau_rigid_nm,
            temperature_degc: &input.temperature_degc,
        };
        terms.add_torque(&sample, tau_nm);
    }
}

impl Stage for Friction {
    const NAME: &'static str = "friction";
    type Config = Config;
    type Input = TorqueModel;
    type Output = FrictionTorque;

    fn new(config: Config, context: &StageContext<'_>) -> Result<Self, BadInput> {
        let v = config.standstill_rad_s;
        if !(v.is_finite() && v >= 0.0) {
            return Err(BadInput::new(format!("standstill_rad_s: found {v}; expected zero or a positive number")));
        }
        let mut stage = Self {
            joints: context.robot.joint_count(),
            f_v: [0.0; MAX_JOINTS],
            f_c: [0.0; MAX_JOINTS],
            offset: [0.0; MAX_JOINTS],
            standstill_rad_s: [v; MAX_JOINTS],
            ramp_rad_s: v,
            terms: None,
        };
        let Some(model) = context.model else { return Ok(stage) };
        model.check(context.robot)?;
        let friction = &model.friction;
        copy("friction.f_v", &friction.f_v, 0.0, &mut stage.f_v)?;
        copy("friction.f_c", &friction.f_c, 0.0, &mut stage.f_c)?;
        copy("friction.offset", &friction.offset, f64::NEG_INFINITY, &mut stage.offset)?;
        copy("friction.standstill_rad_s", &friction.standstill_rad_s, 0.0, &mut stage.standstill_rad_s)?;
        if !model.terms.is_empty() {
            let body = build(context.robot, context.urdf)?;
            let pi = parameters_of(body.as_ref(), &model.rigid_body)?;
            let effects = EffectContext { robot: context.robot, urdf: context.urdf, body: body.as_ref(), pi: &pi };
            stage.terms = Some(build_terms(model, &effects)?);
        }
        Ok(stage)
    }

    fn step(&mut self, input: &TorqueModel, emit: &mut dyn FnMut(&FrictionTorque)) {
        let mut output = FrictionTorque {
            header: input.header,
            q_rad: input.q_rad,
            qd_rad_s: input.qd_rad_s,
            tau_nm: input.tau_nm,
            tau_nominal_nm: input.tau_nominal_nm,
            tau_rigid_nm: input.tau_rigid_nm,
            tau_friction_nm: self.offset,
            payload_column_nm_kg: input.payload_column_nm_kg,
            standstill: 0,
            reserved: 0,
        };
        let n = self.joints.min(MAX_JOINTS);
        let mut direction = [0.0; MAX_JOINTS];
        for i in 0..n {
            let (qd, sign) = self.sliding(&input.qd_rad_s, i);
            direction[i] = sign;
            output.tau_friction_nm[i] += self.f_v[i] * qd + self.f_c[i] * sign;
        }
        self.add_terms(input, &direction, &mut output.tau_friction_nm);
        let drive_off = input.header.has(flag::DRIVE_OFF);
        let no_model = input.header.has(flag::UNREACHABLE);
        for i in (0..n).filter(|&i| direction[i] == 0.0) {
            output.standstill |= 1 << i;
            // With the drive off nothing but friction and the mechanics acts; without a rigid-body torque
            // there is nothing to balance.
            let applied = if drive_off { 0.0 } else { input.tau_nm[i] };
            let held = if no_model { 0.0 } else { applied - input.tau_rigid_nm[i] - output.tau_friction_nm[i] };
            output.tau_friction_nm[i] += hold(held, self.f_c[i]);
        }
        if output.standstill != 0 {
            output.header.flags |= flag::STANDSTILL;
        }
        emit(&output);
    }

    fn finish(&mut self, _emit: &mut dyn FnMut(&FrictionTorque)) {}
}

/// `torque` as far as Coulomb friction of level `f_c` can hold it; 0 for a torque that is not a number.
fn hold(torque: f64, f_c: f64) -> f64 {
    if torque.is_nan() { 0.0 } else { torque.clamp(-f_c, f_c) }
}

/// Copies a per-joint list of the model file; an empty one leaves the target as it is.
fn copy(key: &str, from: &[f64], least: f64, to: &mut Joints) -> Result<(), BadInput> {
    for (i, (&v, slot)) in from.iter().zip(to.iter_mut()).enumerate() {
        if !(v.is_finite() && v >= least) {
            return Err(BadInput::new(format!(
                "{key}: found {v} for joint {}; expected zero or a positive number",
                i + 1
            )));
        }
        *slot = v;
    }
    Ok(())
}
