//! A stage that passes measured samples on as they are.

use lacuna_interfaces::{BadInput, JointMeasured, Stage, StageContext};
use lacuna_stage::run_stage;
use serde::Deserialize;
use std::process::ExitCode;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {}

struct Relay;

impl Stage for Relay {
    const NAME: &'static str = "relay";
    type Config = Config;
    type Input = JointMeasured;
    type Output = JointMeasured;

    fn new(_: Config, _: &StageContext<'_>) -> Result<Self, BadInput> {
        Ok(Self)
    }

    fn step(&mut self, input: &JointMeasured, emit: &mut dyn FnMut(&JointMeasured)) {
        emit(input);
    }

    fn finish(&mut self, _: &mut dyn FnMut(&JointMeasured)) {}
}

fn main() -> ExitCode {
    run_stage::<Relay>()
}
