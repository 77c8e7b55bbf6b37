//! A torque stage of another make: a pure inertia of 2 kg m² on every joint.

use lacuna_interfaces::{BadInput, JointSmoothed, Stage, StageContext, TorqueModel};
use lacuna_stage::run_stage;
use serde::Deserialize;
use std::process::ExitCode;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {}

struct Inertia;

impl Stage for Inertia {
    const NAME: &'static str = "inertia";
    type Config = Config;
    type Input = JointSmoothed;
    type Output = TorqueModel;

    fn new(_: Config, _: &StageContext<'_>) -> Result<Self, BadInput> {
        Ok(Self)
    }

    fn step(&mut self, input: &JointSmoothed, emit: &mut dyn FnMut(&TorqueModel)) {
        let torque = input.qdd_rad_s2.map(|qdd| 2.0 * qdd);
        emit(&TorqueModel {
            header: input.header,
            q_rad: input.q_rad,
            qd_rad_s: input.qd_rad_s,
            qdd_rad_s2: input.qdd_rad_s2,
            tau_nm: input.tau_nm,
            temperature_degc: input.temperature_degc,
            tau_nominal_nm: torque,
            tau_rigid_nm: torque,
            ..TorqueModel::default()
        });
    }

    fn finish(&mut self, _: &mut dyn FnMut(&TorqueModel)) {}
}

fn main() -> ExitCode {
    run_stage::<Inertia>()
}
