//! A friction stage of another make: a constant 1.5 Nm on every joint. It shows that a stage is swapped by naming
//! another executable in the launch file.

use lacuna_interfaces::{BadInput, FrictionTorque, Stage, StageContext, TorqueModel};
use lacuna_stage::run_stage;
use serde::Deserialize;
use std::process::ExitCode;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {}

struct Constant;

impl Stage for Constant {
    const NAME: &'static str = "constant-friction";
    type Config = Config;
    type Input = TorqueModel;
    type Output = FrictionTorque;

    fn new(_: Config, _: &StageContext<'_>) -> Result<Self, BadInput> {
        Ok(Self)
    }

    fn step(&mut self, input: &TorqueModel, emit: &mut dyn FnMut(&FrictionTorque)) {
        let mut out = FrictionTorque {
            header: input.header,
            q_rad: input.q_rad,
            qd_rad_s: input.qd_rad_s,
            tau_nm: input.tau_nm,
            tau_nominal_nm: input.tau_nominal_nm,
            tau_rigid_nm: input.tau_rigid_nm,
            payload_column_nm_kg: input.payload_column_nm_kg,
            ..FrictionTorque::default()
        };
        let n = input.header.joints as usize;
        out.tau_friction_nm.iter_mut().take(n).for_each(|tau| *tau = 1.5);
        emit(&out);
    }

    fn finish(&mut self, _: &mut dyn FnMut(&FrictionTorque)) {}
}

fn main() -> ExitCode {
    run_stage::<Constant>()
}
