//! `model.toml`: what identification or diagnosis found, in the form the stages load.
//!
//! `[rigid_body]` belongs to the torque stage, `[friction]` and `[[term]]` to the friction stage (which runs
//! all terms, whatever stage their cause sits in), `[payload]` and `[noise]` to the payload stage.

use crate::robot::TorqueUnit;
use crate::{BadInput, RobotFile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Schema string of this version.
pub const SCHEMA: &str = "lacuna.model/1";

/// Rigid-body part.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigidBodyModel {
    /// Grey-box factor ρ1 on the inertia term of a Delta (paper eq. 6).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho1: Option<f64>,
    /// Grey-box factor ρ2 on the gravity term of a Delta (paper eq. 6).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho2: Option<f64>,
    /// Linear dynamic parameters π by symbol (`lacuna-physics` lists them per robot); a symbol that is
    /// absent keeps the robot file's value. Not together with ρ1, ρ2.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, f64>,
}

/// Friction of every joint: τ_f = f_v θ̇ + f_c sgn θ̇ + offset.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionModel {
    /// Viscous coefficients f_v [Nm s/rad].
    #[serde(default)]
    pub f_v: Vec<f64>,
    /// Coulomb levels f_c [Nm].
    #[serde(default)]
    pub f_c: Vec<f64>,
    /// Constant offsets [Nm].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub offset: Vec<f64>,
    /// Speed below which a joint counts as standing still [rad/s]; empty: the friction stage's configuration.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub standstill_rad_s: Vec<f64>,
}

/// One effect beyond rigid body, viscous and Coulomb friction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// Effect id of the catalogue.
    pub effect: String,
    /// Joints it acts on, by name; empty for effects of the whole structure.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Parameters by symbol, in SI units.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}

/// Payload carried during the recordings that the model was fitted to.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PayloadModel {
    /// Constant payload already contained in the rigid-body part [kg].
    #[serde(default)]
    pub mass_kg: f64,
}

/// Noise of the signals after the identification's filter.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseModel {
    /// Standard deviation of the torque residual per joint [Nm].
    #[serde(default)]
    pub sd_tau_nm: Vec<f64>,
    /// Standard deviation of the position measurement per joint [rad].
    #[serde(default)]
    pub sd_q_rad: Vec<f64>,
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Must be [`SCHEMA`].
    pub schema: String,
    /// Name of the robot it belongs to.
    pub robot: String,
    /// Unit of all torques in it.
    #[serde(default)]
    pub torque_unit: TorqueUnit,
    /// How it was made, in words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub origin: String,
    /// Rigid-body part.
    #[serde(default)]
    pub rigid_body: RigidBodyModel,
    /// Friction.
    #[serde(default)]
    pub friction: FrictionModel,
    /// Payload of the identification recordings.
    #[serde(default)]
    pub payload: PayloadModel,
    /// Noise.
    #[serde(default)]
    pub noise: NoiseModel,
    /// Further effects.
    #[serde(default, rename = "term", skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<Term>,
}

impl ModelFile {
    /// The model that says nothing beyond the robot file: nominal rigid body, no friction.
    pub fn nominal(robot: &RobotFile) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            robot: robot.name.clone(),
            torque_unit: robot.torque_unit,
            origin: "nominal: robot file only".to_owned(),
            rigid_body: RigidBodyModel::default(),
            friction: FrictionModel::default(),
            payload: PayloadModel::default(),
            noise: NoiseModel::default(),
            terms: Vec::new(),
        }
    }

    /// Parses a model file (syntax, keys and schema; [`ModelFile::check`] holds it against a robot).
    ///
    /// # Errors
    /// [`BadInput`] with the line.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        let model: Self = toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))?;
        if model.schema != SCHEMA {
            return Err(BadInput::new(format!("schema: found \"{}\"; expected \"{SCHEMA}\"", model.schema)));
        }
        Ok(model)
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`BadInput`] if a value cannot be written as TOML (it cannot for any model that passed [`ModelFile::check`]).
    pub fn to_toml(&self) -> Result<String, BadInput> {
        toml::to_string(self).map_err(|e| BadInput::new(format!("model cannot be written as TOML: {e}")))
    }

    /// Checks the model against the robot it is to be used with.
    ///
    /// # Errors
    /// [`BadInput`] naming the key, what was found and what was expected.
    pub fn check(&self, robot: &RobotFile) -> Result<(), BadInput> {
        let n = robot.joint_count();
        if self.robot != robot.name {
            return Err(BadInput::new(format!(
                "robot: the model is of \"{}\"; expected one of \"{}\"",
                self.robot, robot.name
            )));
        }
        if self.torque_unit != robot.torque_unit {
            return Err(BadInput::new(format!(
                "torque_unit: the model is in {}; expected {}, the robot file's unit",
                self.torque_unit.symbol(),
                robot.torque_unit.symbol()
            )));
        }
        for (key, list) in [
            ("friction.f_v", &self.friction.f_v),
            ("friction.f_c", &self.friction.f_c),
            ("friction.offset", &self.friction.offset),
            ("friction.standstill_rad_s", &self.friction.standstill_rad_s),
            ("noise.sd_tau_nm", &self.noise.sd_tau_nm),
            ("noise.sd_q_rad", &self.noise.sd_q_rad),
        ] {
            if !list.is_empty() && list.len() != n {
                return Err(BadInput::new(format!("{key}: found {} values; expected {n}, one per joint", list.len())));
            }
            if let Some(v) = list.iter().find(|v| !v.is_finite()) {
                return Err(BadInput::new(format!("{key}: found {v}; expected finite numbers")));
            }
        }
        let body = &self.rigid_body;
        if (body.rho1.is_some() || body.rho2.is_some()) && !body.parameters.is_empty() {
            return Err(BadInput::new(
                "rigid_body: found rho1 or rho2 together with parameters; expected one way or the other",
            ));
        }
        let numbers = [
            ("rigid_body.rho1", body.rho1),
            ("rigid_body.rho2", body.rho2),
            ("payload.mass_kg", Some(self.payload.mass_kg)),
        ];
        for (key, v) in numbers {
            if let Some(v) = v
                && !v.is_finite()
            {
                return Err(BadInput::new(format!("{key}: found {v}; expected a finite number")));
            }
        }
        for (symbol, v) in &body.parameters {
            if !v.is_finite() {
                return Err(BadInput::new(format!(
                    "rigid_body.parameters.{symbol}: found {v}; expected a finite number"
                )));
            }
        }
        for (i, term) in self.terms.iter().enumerate() {
            if let Some(j) = term.joints.iter().find(|j| !robot.joints.contains(j)) {
                return Err(BadInput::new(format!(
                    "term[{i}] ({}): joint '{j}' is not one of {}",
                    term.effect,
                    robot.joints.join(", ")
                )));
            }
            if let Some((s, v)) = term.parameters.iter().find(|(_, v)| !v.is_finite()) {
                return Err(BadInput::new(format!("term[{i}] ({}): {s} = {v}; expected a finite number", term.effect)));
            }
        }
        Ok(())
    }
}
