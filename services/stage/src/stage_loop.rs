//! The process around a [`Stage`].

use crate::bus::{Input, Output, Received, Wake};
use crate::clock::monotonic_ns;
use crate::control::{Event, StageReport};
use crate::latency::EdgeMeter;
use crate::process::{Failure, Process, Pulse, main_with};
use lacuna_interfaces::graph::Mode;
use lacuna_interfaces::{Stage, StageContext, Wire, flag};
use std::process::ExitCode;

/// Samples handled between two looks at the stop flag and the progress clock.
const BURST: usize = 256;

/// `main` of a stage process.
pub fn run_stage<S: Stage>() -> ExitCode {
    main_with(body::<S>)
}

fn body<S: Stage>(process: &Process) -> Result<StageReport, Failure> {
    let context =
        StageContext { robot: &process.robot.file, urdf: process.robot.urdf.as_deref(), model: process.model.as_ref() };
    let mut stage = S::new(process.config()?, &context)
        .map_err(|e| Failure::usage(format!("node \"{}\": {e}", process.node.name)))?;
    let domain = process.domain()?;
    let mut wake = Wake::open(&domain, &process.node.name)?;
    let mut input = Input::<S::Input>::open(&domain, &process.graph, process.single_input()?, process.buffer())?;
    let topic = process
        .node
        .output
        .as_deref()
        .ok_or_else(|| Failure::usage(format!("node \"{}\": found no output; expected one", process.node.name)))?;
    let mut output = Output::<S::Output>::open(&domain, &process.graph, topic, &process.stop)?;
    Event::Ready.emit();

    let mut relay = Relay::new(process);
    let mut pulse = Pulse::new();
    let mut meter = EdgeMeter::new(process.graph.mode == Mode::Live);
    let mut joints = process.robot.file.joint_count() as u32;
    'stream: loop {
        for _ in 0..BURST {
            // Asked before the buffer is looked at: what came until then is still taken.
            let ended = process.ended(input.topic());
            match input.receive()? {
                None if ended => break 'stream,
                None => {
                    output.flush();
                    wake.wait();
                    break;
                }
                Some(Received::End) => break 'stream,
                Some(Received::Sample { sample, missing }) => {
                    let message = &sample.payload().0;
                    joints = message.header().joints;
                    meter.record(message.header());
                    if missing > 0 || (relay.restarts > 0 && relay.last_seq == 0) {
                        // Live only: the copy is worth it, the hole must travel with the sample.
                        let mut marked = *message;
                        marked.header_mut().flags |= flag::GAP;
                        stage.step(&marked, &mut |out| relay.send(&mut output, out));
                    } else {
                        stage.step(message, &mut |out| relay.send(&mut output, out));
                    }
                    relay.check()?;
                }
            }
        }
        if process.stop.requested() {
            return Err(Failure::Stopped);
        }
        pulse.progress(input.received(), None, || meter.take(output.dropped(), input.missing()));
    }
    stage.finish(&mut |out| relay.send(&mut output, out));
    relay.check()?;
    let report = account(process, &input, &output)?;
    // Letting go of the input tells the writer that the sentinel was taken.
    drop(input);
    output.finish(relay.last_seq + 1, joints)?;
    Ok(report)
}

/// The final counts; in a replay they must agree.
fn account<I: Wire, O: Wire>(process: &Process, input: &Input<I>, output: &Output<O>) -> Result<StageReport, Failure> {
    let report = StageReport {
        received: [(input.topic().to_owned(), input.received())].into(),
        published: output.published(),
        dropped: output.dropped(),
        missing: input.missing(),
        ..StageReport::default()
    };
    if process.graph.mode == Mode::Replay && report.published != input.received() {
        return Err(Failure::run(format!(
            "node \"{}\": took {} samples and gave {}; expected one for one",
            process.node.name,
            input.received(),
            report.published
        )));
    }
    Ok(report)
}

/// Sends what a stage emits; the first error is kept, since a stage's callback cannot return one.
struct Relay {
    restarts: u32,
    error: Option<Failure>,
    last_seq: u64,
    /// True once a sample was passed on.
    flowing: bool,
    /// What is replayed, to name it in an error; `None` for a live graph.
    replayed: Option<String>,
}

impl Relay {
    fn new(process: &Process) -> Self {
        let replayed = (process.graph.mode == Mode::Replay).then(|| process.recording());
        Self { restarts: process.restarts, error: None, last_seq: 0, flowing: false, replayed }
    }

    fn send<W: Wire>(&mut self, output: &mut Output<W>, message: &W) {
        if self.error.is_some() {
            return;
        }
        self.last_seq = message.header().seq;
        // Live, the flag travels and the robot goes on; a recording that leaves the workspace is not this robot's.
        if let Some(recording) = &self.replayed
            && message.header().has(flag::UNREACHABLE)
        {
            let t_s = message.header().stamp_ns as f64 * 1e-9;
            self.error = Some(Failure::usage(format!(
                "{recording}: sample {} at {t_s:.6} s: found a pose outside the workspace of the robot file; expected a recording of this robot",
                self.last_seq
            )));
            return;
        }
        let result = if self.restarts == 0 {
            output.send(message)
        } else {
            let mut marked = *message;
            marked.header_mut().restarts += self.restarts;
            output.send(&marked)
        };
        if self.restarts > 0 && !self.flowing && result.is_ok() {
            self.flowing = true;
            output.flush();
            Event::Flowing { at_ns: monotonic_ns() }.emit();
        }
        self.error = result.err();
    }

    fn check(&mut self) -> Result<(), Failure> {
        self.error.take().map_or(Ok(()), Err)
    }
}
