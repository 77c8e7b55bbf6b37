//! The torque stage: what the rigid body alone asks of the motors at every smoothed sample.
//!
//! Three things leave it: the torque of the robot file's nominal model (Delta: M_KH), that of the identified
//! model (Delta: M_Id, or any parameters by symbol), and ∂τ/∂m_p, the column the payload stage estimates
//! with. All come from one kinematic pass ([`RigidBody::evaluate`]). Friction is the next stage's work.
//!
//! A sample without a model torque (pose outside the workspace, a value that is not finite, another number
//! of joints) passes with [`flag::UNREACHABLE`] and zeros in the three fields.

use lacuna_interfaces::{BadInput, JointSmoothed, Stage, StageContext, TorqueModel, flag};
use lacuna_physics::{Evaluation, Motion, RigidBody, build, parameters_of};
use serde::Deserialize;

/// Which parameters make `tau_rigid_nm`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// The model file's `[rigid_body]`; the robot file's values without a model file.
    #[default]
    Identified,
    /// The robot file's values, whatever the model file says.
    Nominal,
}

/// The node's configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Which parameters make `tau_rigid_nm`.
    pub rigid_body: Source,
}

/// The torque stage.
#[derive(Debug)]
pub struct Torque {
    body: Box<dyn RigidBody>,
    nominal: Vec<f64>,
    rigid: Vec<f64>,
}

impl Torque {
    fn evaluate(&self, input: &JointSmoothed) -> Option<Evaluation> {
        let n = self.body.joint_count();
        if input.header.joints as usize != n {
            return None;
        }
        let motion = Motion {
            q_rad: input.q_rad.get(..n)?,
            qd_rad_s: input.qd_rad_s.get(..n)?,
            qdd_rad_s2: input.qdd_rad_s2.get(..n)?,
        };
        self.body.evaluate(&motion, &self.nominal, &self.rigid).ok()
    }
}

impl Stage for Torque {
    const NAME: &'static str = "torque";
    type Config = Config;
    type Input = JointSmoothed;
    type Output = TorqueModel;

    fn new(config: Config, context: &StageContext<'_>) -> Result<Self, BadInput> {
        let body = build(context.robot, context.urdf)?;
        let nominal = body.nominal();
        let rigid = match (config.rigid_body, context.model) {
            (Source::Identified, Some(model)) => {
                model.check(context.robot)?;
                parameters_of(body.as_ref(), &model.rigid_body)?
            }
            (Source::Nominal, _) | (_, None) => nominal.clone(),
        };
        Ok(Self { body, nominal, rigid })
    }

    fn step(&mut self, input: &JointSmoothed, emit: &mut dyn FnMut(&TorqueModel)) {
        let mut header = input.header;
        let evaluation = self.evaluate(input).unwrap_or_else(|| {
            header.flags |= flag::UNREACHABLE;
            Evaluation::default()
        });
        emit(&TorqueModel {
            header,
            q_rad: input.q_rad,
            qd_rad_s: input.qd_rad_s,
            qdd_rad_s2: input.qdd_rad_s2,
            tau_nm: input.tau_nm,
            temperature_degc: input.temperature_degc,
            tau_nominal_nm: evaluation.tau_nominal_nm,
            tau_rigid_nm: evaluation.tau_rigid_nm,
            payload_column_nm_kg: evaluation.payload_column_nm_kg,
        });
    }

    fn finish(&mut self, _emit: &mut dyn FnMut(&TorqueModel)) {}
}
