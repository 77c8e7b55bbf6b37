//! The source process: a recording, or a live tap, onto the bus.

use lacuna_interfaces::{BadInput, JointMeasured};
use lacuna_source::tap::Tap;
use lacuna_stage::{Next, Source, SourceContext, run_source};
use std::process::ExitCode;

enum Process {
    Recording(Box<lacuna_source::Source>),
    Tap(Box<Tap>),
}

impl Source for Process {
    type Config = lacuna_source::Config;
    type Output = JointMeasured;

    fn new(config: Self::Config, context: &SourceContext<'_>) -> Result<Self, BadInput> {
        match &config.interface {
            Some(interface) if config.recording.is_empty() => {
                Ok(Self::Tap(Box::new(Tap::open(interface, context.robot)?)))
            }
            _ => Ok(Self::Recording(Box::new(lacuna_source::Source::new(config, context.robot)?))),
        }
    }

    fn next_sample(&mut self) -> Result<Next<JointMeasured>, BadInput> {
        match self {
            Self::Recording(source) => {
                let mut sample = JointMeasured::default();
                Ok(source.next_sample(&mut sample)?.then_some(sample).into())
            }
            Self::Tap(tap) => Ok(tap.next_sample()?.map_or(Next::Wait, Next::Sample)),
        }
    }

    fn due_ns(&self, sample: &JointMeasured) -> Option<u64> {
        match self {
            Self::Recording(source) => source.due_ns(sample.header.stamp_ns),
            Self::Tap(_) => None,
        }
    }

    fn is_live(&self) -> bool {
        matches!(self, Self::Tap(_))
    }

    fn fraction(&self) -> Option<f64> {
        match self {
            Self::Recording(source) => Some(source.fraction()),
            Self::Tap(_) => None,
        }
    }

    fn report(&self) -> serde_json::Value {
        match self {
            Self::Recording(source) => serde_json::json!({ "samples": source.count(), "repairs": source.repairs() }),
            Self::Tap(tap) => {
                let [frames, damaged, refused] = tap.frames();
                serde_json::json!({
                    "samples": tap.count(),
                    "repairs": tap.repairs(),
                    "frames": frames,
                    "frames_damaged": damaged,
                    "frames_dropped_by_kernel": tap.dropped(),
                    "samples_refused": refused,
                    "clock_steps": tap.clock_steps(),
                })
            }
        }
    }
}

fn main() -> ExitCode {
    run_source::<Process>()
}
