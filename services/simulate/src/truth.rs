//! What is true of simulated recordings: the sealed answer.

use crate::effects::{self, Class, TrueEffect};
use crate::oracle::Oracle;
use crate::plant::robot::TipEvent;
use lacuna_interfaces::{BadInput, RobotFile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Coulomb and viscous friction of every joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BaseFriction {
    /// f_c [Nm].
    pub fc: Vec<f64>,
    /// f_v [Nm s/rad].
    pub fv: Vec<f64>,
}

/// One effect that is truly there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectTruth {
    /// Effect id.
    pub id: String,
    /// Catalogue or unknown.
    pub cls: Class,
    /// Ids that are as good an answer.
    pub also_accept: Vec<String>,
    /// Joints by name; empty for the whole structure.
    pub joints: Vec<String>,
    /// Parameters by symbol.
    pub params: BTreeMap<String, f64>,
    /// The law in words.
    pub law: String,
    /// RMS torque per joint that the effect is behind [Nm]; empty unless the configuration asks for it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rms_nm: Vec<f64>,
}

impl EffectTruth {
    pub(crate) fn of(effect: &TrueEffect, robot: &RobotFile) -> Result<Self, BadInput> {
        let kind = effects::find(&effect.id)?;
        let all = kind.scope == effects::Scope::Joint && effect.joints.is_empty();
        Ok(Self {
            id: effect.id.clone(),
            cls: kind.class,
            also_accept: kind.also_accept.iter().map(|s| (*s).to_owned()).collect(),
            joints: if all { robot.joints.clone() } else { effect.joints.clone() },
            params: effect.params.clone(),
            law: kind.law.to_owned(),
            rms_nm: Vec::new(),
        })
    }

    /// True if a diagnosis can name it.
    pub fn in_catalogue(&self) -> bool {
        self.cls == Class::Catalogue
    }
}

/// Something that happened at a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventTruth {
    /// `payload` or `collision`.
    pub kind: String,
    /// Begin [s].
    pub t_on: f64,
    /// End [s].
    pub t_off: f64,
    /// Payload mass [kg]; 0 for a collision.
    pub mass: f64,
    /// Peak force, base frame [N]; 0 for a payload.
    pub force: [f64; 3],
}

impl EventTruth {
    pub(crate) fn of(events: &[TipEvent]) -> Vec<Self> {
        let entry = |event: &TipEvent| match *event {
            TipEvent::Payload { on, off, mass, .. } => {
                Self { kind: "payload".to_owned(), t_on: on, t_off: off, mass, force: [0.0; 3] }
            }
            TipEvent::Push { on, duration, force } => {
                Self { kind: "collision".to_owned(), t_on: on, t_off: on + duration, mass: 0.0, force }
            }
        };
        events.iter().map(entry).collect()
    }
}

/// Noise of the sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NoiseTruth {
    /// Standard deviation on the logged torque [Nm].
    pub torque_nm: Vec<f64>,
    /// Encoder step at the joint side [rad].
    pub encoder_step_rad: Vec<f64>,
    /// Encoder noise, standard deviation in steps.
    pub encoder_steps: f64,
}

/// The whole answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// [`Truth::SCHEMA`].
    pub schema: String,
    /// Robot's name.
    pub robot: String,
    /// Seed.
    pub seed: u64,
    /// Masses differ from the robot file's by up to this share.
    pub mass_error: f64,
    /// `friction`, or `ideal` for a robot without any.
    pub base: String,
    /// Coulomb and viscous friction.
    pub base_params: BaseFriction,
    /// What is there beyond robot file and base friction.
    pub effects: Vec<EffectTruth>,
    /// Per file: what happened when.
    pub events: BTreeMap<String, Vec<EventTruth>>,
    /// Noise.
    pub noise: NoiseTruth,
    /// RMS per joint of the noise-free torque that the robot file alone does not explain [Nm].
    pub hidden_rms_nm: Vec<f64>,
    /// What the true model itself would leave of these recordings.
    pub oracle: Oracle,
    /// Largest tracking error [rad].
    pub tracking_error_rad: f64,
}

impl Truth {
    /// Schema of this version.
    pub const SCHEMA: &'static str = "lacuna.truth/1";

    /// The answer as JSON.
    ///
    /// # Errors
    /// [`BadInput`] if a number is not finite.
    pub fn to_json(&self) -> Result<String, BadInput> {
        serde_json::to_string_pretty(self).map_err(|e| BadInput::new(format!("truth cannot be written as JSON: {e}")))
    }
}

/// RMS over several stretches; 0 without samples.
pub(crate) fn pooled_rms<'a>(stretches: impl Iterator<Item = &'a [f64]>) -> f64 {
    let (sum, count) = stretches.flatten().fold((0.0, 0usize), |(s, n), v| (s + v * v, n + 1));
    if count == 0 { 0.0 } else { (sum / count as f64).sqrt() }
}
