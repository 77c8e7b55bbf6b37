//! A stage whose `JointMeasured` has two fields swapped: same name, size and alignment, another meaning.

use lacuna_interfaces::wire::{Field, Header, Joints, Wire};
use lacuna_interfaces::{BadInput, Stage, StageContext};
use lacuna_stage::run_stage;
use serde::Deserialize;
use std::process::ExitCode;

#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
struct Swapped {
    header: Header,
    tau_nm: Joints,
    q_rad: Joints,
    temperature_degc: Joints,
    link_q_rad: Joints,
    link_tau_nm: Joints,
}

#[expect(unsafe_code, reason = "a foreign message, made to be refused")]
// SAFETY: repr(C), plain numbers.
unsafe impl Wire for Swapped {
    const NAME: &'static str = "JointMeasured";
    const LAYOUT_HASH: u64 = 0xbad;
    const FIELDS: &'static [Field] = &[];
    fn header(&self) -> &Header {
        &self.header
    }
    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {}

struct Other;

impl Stage for Other {
    const NAME: &'static str = "other-layout";
    type Config = Config;
    type Input = Swapped;
    type Output = Swapped;

    fn new(_: Config, _: &StageContext<'_>) -> Result<Self, BadInput> {
        Ok(Self)
    }

    fn step(&mut self, input: &Swapped, emit: &mut dyn FnMut(&Swapped)) {
        emit(input);
    }

    fn finish(&mut self, _: &mut dyn FnMut(&Swapped)) {}
}

fn main() -> ExitCode {
    run_stage::<Other>()
}
