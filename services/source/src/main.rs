//! The source process: a recording onto the bus.

use lacuna_interfaces::{BadInput, JointMeasured};
use lacuna_stage::{Source, SourceContext, run_source};
use std::process::ExitCode;

struct Process(lacuna_source::Source);

impl Source for Process {
    type Config = lacuna_source::Config;
    type Output = JointMeasured;

    fn new(config: Self::Config, context: &SourceContext<'_>) -> Result<Self, BadInput> {
        lacuna_source::Source::new(config, context.robot).map(Self)
    }

    fn next_sample(&mut self) -> Result<Option<JointMeasured>, BadInput> {
        let mut sample = JointMeasured::default();
        Ok(self.0.next_sample(&mut sample)?.then_some(sample))
    }

    fn due_ns(&self, sample: &JointMeasured) -> Option<u64> {
        self.0.due_ns(sample.header.stamp_ns)
    }

    fn fraction(&self) -> Option<f64> {
        Some(self.0.fraction())
    }

    fn report(&self) -> serde_json::Value {
        serde_json::json!({ "samples": self.0.count(), "repairs": self.0.repairs() })
    }
}

fn main() -> ExitCode {
    run_source::<Process>()
}
