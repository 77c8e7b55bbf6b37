//! The payload stage: recursive least squares for the payload mass, in torque space.

use lacuna_interfaces::{BadInput, FrictionTorque, PayloadEstimate, Stage, StageContext};
use serde::Deserialize;

/// Configuration of the payload stage.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Time over which the estimate forgets [s].
    pub forgetting_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { forgetting_s: 0.5 }
    }
}
