//! The process around a [`Sink`]: a reader of any number of topics, whatever known message they carry.

use crate::any::{AnyMessage, with_messages};
use crate::bus::{Input, Received, Wake, wait_for_type};
use crate::clock::monotonic_ns;
use crate::control::{Event, StageReport};
use crate::domain::Domain;
use crate::latency::{EdgeMeter, LatencyMeter};
use crate::process::{Failure, Process, Pulse, main_with};
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::{
    BadInput, FrictionTorque, JointMeasured, JointSmoothed, ModelFile, PayloadEstimate, ResidualWatch, RobotFile,
    TorqueModel, Wire, flag,
};
use serde::de::DeserializeOwned;
use std::process::ExitCode;

/// Samples taken from one topic before the next one is looked at.
const BURST: usize = 64;

macro_rules! messages {
    ($($name:ident),*) => {
        enum AnyInput { $($name(Input<$name>),)* }

        impl AnyInput {
            fn open(domain: &Domain, process: &Process, topic: &str, type_name: &str) -> Result<Self, Failure> {
                $(if type_name == $name::type_name() {
                    return Ok(Self::$name(Input::open(domain, &process.graph, topic, process.buffer())?));
                })*
                let known = [$($name::type_name()),*].join(", ");
                Err(Failure::usage(format!(
                    "topic \"{topic}\": it carries {type_name}, this process reads {known}; expected one of these messages in this layout"
                )))
            }

            fn counts(&self) -> (&str, u64, u64) {
                match self { $(Self::$name(i) => (i.topic(), i.received(), i.missing()),)* }
            }

            fn message(&self) -> &'static str {
                match self { $(Self::$name(_) => $name::NAME,)* }
            }

            /// Takes up to `BURST` samples; returns how many, and whether the stream ended. A sample after a hole carries
            /// the flag "gap", and so does the first of a process that was `restarted`.
            fn drain(&mut self, restarted: bool, take: &mut dyn FnMut(&str, AnyMessage<'_>, u64) -> Result<(), Failure>) -> Result<(usize, bool), Failure> {
                match self { $(Self::$name(input) => {
                    for n in 0..BURST {
                        match input.receive()? {
                            None => return Ok((n, false)),
                            Some(Received::End) => return Ok((n, true)),
                            Some(Received::Sample { sample, missing }) => {
                                let message = &sample.payload().0;
                                if missing > 0 || (restarted && input.received() == 1) {
                                    // Live only: the copy is worth it, the hole must travel with the sample.
                                    let mut marked = *message;
                                    marked.header.flags |= flag::GAP;
                                    take(input.topic(), AnyMessage::$name(&marked), missing)?;
                                } else {
                                    take(input.topic(), AnyMessage::$name(message), missing)?;
                                }
                            }
                        }
                    }
                    Ok((BURST, false))
                })* }
            }
        }
    };
}

with_messages!(messages);

/// What a sink may know when it is made.
#[derive(Debug, Clone, Copy)]
pub struct SinkContext<'a> {
    /// The robot file.
    pub robot: &'a RobotFile,
    /// Its text, for the record.
    pub robot_text: &'a str,
    /// Text of the URDF, if the robot file names one.
    pub urdf: Option<&'a str>,
    /// The model file, if there is one.
    pub model: Option<&'a ModelFile>,
    /// Its text.
    pub model_text: Option<&'a str>,
    /// Text of the model file of every namespace that has its own.
    pub branch_models: &'a [(String, String)],
    /// The resolved graph.
    pub graph: &'a GraphFile,
    /// Topics it reads, in the graph's order, each with the name of its message.
    pub topics: &'a [(String, &'static str)],
    /// How often this node has been restarted in this run: what it wrote before must not be overwritten.
    pub restarts: u32,
    /// Name of the run, unlike that of any other.
    pub run: &'a str,
    /// Replay: wait rather than lose. Live: drop and count rather than wait.
    pub mode: Mode,
}

/// How a sink that was started again went on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resumption {
    /// Samples that went by between its processes: delivered to one that died with them, or sent while there was none.
    pub while_down: u64,
    /// Number of the last sample that one of its processes kept, 0 if it cannot say. 32 bits of it will do.
    pub last_seq: u64,
}

/// Where a stream ends.
pub trait Sink: Sized {
    /// The node's `[config]` table.
    type Config: DeserializeOwned;

    /// Checks the configuration. Nothing may be written before the first sample: the run may still fail to start.
    ///
    /// # Errors
    /// [`BadInput`] if the configuration cannot be used.
    fn new(config: Self::Config, context: &SinkContext<'_>) -> Result<Self, BadInput>;

    /// Takes a sample of `topic`; `missing` samples before it were lost.
    ///
    /// # Errors
    /// A reason, if the output failed.
    fn take(&mut self, topic: &str, message: AnyMessage<'_>, missing: u64) -> Result<(), String>;

    /// Nothing to read right now: a chance to flush.
    fn idle(&mut self);

    /// Samples that it took and could not keep, so far: a recorder's disk may be too slow.
    fn unkept(&self) -> u64 {
        0
    }

    /// What went by between the node's processes of this run; asked once, at the end of one that was started again. For
    /// sinks that leave something behind which tells.
    fn resumption(&mut self) -> Resumption {
        Resumption::default()
    }

    /// All streams ended (`complete`), or the process is being stopped before they did.
    ///
    /// # Errors
    /// A reason, if the output could not be completed.
    fn finish(self, complete: bool) -> Result<serde_json::Value, String>;
}

/// `main` of a sink process.
pub fn run_sink<S: Sink>() -> ExitCode {
    main_with(body::<S>)
}

fn body<S: Sink>(process: &Process) -> Result<StageReport, Failure> {
    let domain = process.domain()?;
    let mut wake = Wake::open(&domain, &process.node.name)?;
    let mut inputs = open_inputs(&domain, process)?;
    let topics: Vec<(String, &'static str)> =
        inputs.iter().flatten().map(|i| (i.counts().0.to_owned(), i.message())).collect();
    let branch_models = process
        .graph
        .branch_models()
        .into_iter()
        .map(|(space, path)| Ok((space.to_owned(), lacuna_recording::load_model(path, &process.robot.file)?.1)))
        .collect::<Result<Vec<_>, BadInput>>()?;
    let context = SinkContext {
        robot: &process.robot.file,
        robot_text: &process.robot.toml,
        urdf: process.robot.urdf.as_deref(),
        model: process.model.as_ref(),
        model_text: process.model_text.as_deref(),
        branch_models: &branch_models,
        graph: &process.graph,
        topics: &topics,
        restarts: process.restarts,
        run: process.run.name(),
        mode: process.graph.mode,
    };
    let mut sink = S::new(process.config()?, &context)?;
    Event::Ready.emit();

    let mut report = StageReport::default();
    let mut latency = LatencyMeter::new();
    let mut pulse = Pulse::new();
    let result = pump(process, &mut sink, &mut inputs, &mut wake, &mut report, &mut latency, &mut pulse);
    if result.is_ok() && process.restarts > 0 {
        let Resumption { while_down, last_seq } = sink.resumption();
        (report.while_down, report.last_seq) = (while_down, last_seq);
    }
    report.dropped = sink.unkept();
    let finished = sink.finish(result.is_ok()).map_err(Failure::run);
    result?;
    report.details = finished?;
    report.latency = latency.report();
    Ok(report)
}

/// Opens every input by the message its writer declared.
fn open_inputs(domain: &Domain, process: &Process) -> Result<Vec<Option<AnyInput>>, Failure> {
    let mut inputs = Vec::new();
    for topic in &process.node.inputs {
        let type_name = wait_for_type(topic, &process.stop, || process.ended(topic))?;
        inputs.push(type_name.map(|name| AnyInput::open(domain, process, topic, &name)).transpose()?);
    }
    Ok(inputs)
}

/// Reads all topics until each has ended.
fn pump<S: Sink>(
    process: &Process,
    sink: &mut S,
    inputs: &mut [Option<AnyInput>],
    wake: &mut Wake,
    report: &mut StageReport,
    latency: &mut LatencyMeter,
    pulse: &mut Pulse,
) -> Result<(), Failure> {
    let last = inputs.len().saturating_sub(1);
    let mut meter = EdgeMeter::new(process.graph.mode == Mode::Live);
    let mut flowing = process.restarts == 0;
    while inputs.iter().any(Option::is_some) {
        let mut taken = 0;
        for (index, slot) in inputs.iter_mut().enumerate() {
            let Some(input) = slot else { continue };
            // Asked before the buffer is looked at: what came until then is still taken.
            let left = process.ended(input.counts().0);
            let (n, ended) = input.drain(process.restarts > 0, &mut |topic, message, missing| {
                meter.flags_of(message.header());
                // The last topic has passed every stage: it tells the whole way.
                if index == last {
                    latency.record(message.header(), monotonic_ns());
                    meter.record(message.header());
                }
                sink.take(topic, message, missing).map_err(Failure::run)
            })?;
            taken += n;
            if ended || (left && n == 0) {
                let (topic, received, missing) = input.counts();
                report.received.insert(topic.to_owned(), received);
                report.missing = report.missing.max(missing);
                *slot = None;
            }
        }
        if process.stop.requested() {
            return Err(Failure::Stopped);
        }
        if taken > 0 && !flowing {
            flowing = true;
            Event::Flowing { at_ns: monotonic_ns() }.emit();
        }
        if taken == 0 && inputs.iter().any(Option::is_some) {
            sink.idle();
            wake.wait();
        }
        let samples = inputs.iter().flatten().map(|i| i.counts().1).max().unwrap_or(0);
        let missing = inputs.iter().flatten().map(|i| i.counts().2).fold(report.missing, u64::max);
        pulse.progress(samples, None, || meter.take(sink.unkept(), missing));
    }
    Ok(())
}
