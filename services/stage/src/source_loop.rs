//! The process around a [`Source`]: it alone knows wall-clock pacing.

use crate::bus::Output;
use crate::clock::monotonic_ns;
use crate::control::{Event, Gauge, StageReport};
use crate::process::{Failure, Process, Pulse, main_with};
use lacuna_interfaces::{BadInput, RobotFile, Wire, flag};
use serde::de::DeserializeOwned;
use std::process::ExitCode;
use std::time::Duration;

/// What a source may know when it is made.
#[derive(Debug, Clone, Copy)]
pub struct SourceContext<'a> {
    /// The robot file.
    pub robot: &'a RobotFile,
}

/// What a source has next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Next<T> {
    /// A sample with sequence number and measurement stamp.
    Sample(T),
    /// Nothing yet: a live source looked for a moment; ask again.
    Wait,
    /// The end of the stream.
    End,
}

impl<T> From<Option<T>> for Next<T> {
    fn from(sample: Option<T>) -> Self {
        sample.map_or(Self::End, Self::Sample)
    }
}

/// Where the stream begins.
pub trait Source: Sized {
    /// The node's `[config]` table.
    type Config: DeserializeOwned;
    /// What it writes.
    type Output: Wire;

    /// Opens the input and checks it against the robot.
    ///
    /// # Errors
    /// [`BadInput`] if configuration or input cannot be used.
    fn new(config: Self::Config, context: &SourceContext<'_>) -> Result<Self, BadInput>;

    /// What comes next. A live source returns [`Next::Wait`] at least every tenth of a second, so that a stop is heard.
    ///
    /// # Errors
    /// [`BadInput`] with the place where the input stops making sense.
    fn next_sample(&mut self) -> Result<Next<Self::Output>, BadInput>;

    /// When the sample is due, as time since the first one [ns]; `None` to send as fast as the graph accepts.
    fn due_ns(&self, sample: &Self::Output) -> Option<u64>;

    /// True for a source that takes what happens now; after a restart its numbers go on beyond those of before.
    fn is_live(&self) -> bool {
        false
    }

    /// Share of the input that is done, if known.
    fn fraction(&self) -> Option<f64>;

    /// What the source has to say at the end: files, repairs, counts.
    fn report(&self) -> serde_json::Value;
}

/// `main` of a source process.
pub fn run_source<S: Source>() -> ExitCode {
    main_with(body::<S>)
}

fn body<S: Source>(process: &Process) -> Result<StageReport, Failure> {
    let mut source = S::new(process.config()?, &SourceContext { robot: &process.robot.file })?;
    let domain = process.domain()?;
    let topic = process
        .node
        .output
        .as_deref()
        .ok_or_else(|| Failure::usage(format!("node \"{}\": found no output; expected one", process.node.name)))?;
    let mut output = Output::<S::Output>::open(&domain, &process.graph, topic, &process.stop)?;
    Event::Ready.emit();
    let (start, after_seq) = process.wait_for_go();

    let mut pulse = Pulse::new();
    let (mut last_seq, mut flags) = (0, 0);
    // What a live source missed while it was down is a hole in the numbers, as long as the stream was quick before.
    let shift = if source.is_live() { after_seq } else { 0 };
    let behind = process.restarts > 0 && !source.is_live();
    let mut first = if behind { catch_up(&mut source, start, process)? } else { None };
    let mut flowing = process.restarts == 0;
    // A stop request ends the stream here; the sentinel then ends it everywhere, in order.
    while !process.stop.requested() {
        let mut sample = match first.take().map_or_else(|| source.next_sample(), |s| Ok(Next::Sample(s)))? {
            Next::Sample(sample) => sample,
            Next::Wait => {
                output.flush();
                continue;
            }
            Next::End => break,
        };
        let header = sample.header_mut();
        header.restarts = process.restarts;
        header.seq += shift;
        if !flowing {
            header.flags |= flag::GAP;
        }
        if let Some(due) = source.due_ns(&sample) {
            sleep_until(start + due, &mut output, process);
        }
        match output.send(&sample) {
            // The stop may have come between two readers of this sample: send it again, so that all have it.
            Err(Failure::Stopped) => {
                process.stop.clear();
                output.send(&sample)?;
                last_seq = sample.header().seq;
                break;
            }
            other => other?,
        }
        last_seq = sample.header().seq;
        if !flowing {
            flowing = true;
            Event::Flowing { at_ns: monotonic_ns() }.emit();
        }
        flags |= sample.header().flags;
        if last_seq % 256 == 0 || source.due_ns(&sample).is_some() {
            pulse.progress(last_seq, source.fraction(), || Gauge {
                dropped: output.dropped(),
                flags: std::mem::take(&mut flags),
                ..Gauge::default()
            });
        }
    }
    let report = StageReport {
        published: output.published(),
        last_seq,
        dropped: output.dropped(),
        details: source.report(),
        ..StageReport::default()
    };
    process.stop.clear();
    output.finish(last_seq + 1, process.robot.file.joint_count() as u32)?;
    Ok(report)
}

/// A source that was started again goes on where the stream is now: the samples that came due while it was down are a
/// hole in the sequence, which every reader counts. Returns the first sample that is not late.
fn catch_up<S: Source>(source: &mut S, start: u64, process: &Process) -> Result<Option<S::Output>, Failure> {
    while !process.stop.requested() {
        let sample = match source.next_sample()? {
            Next::Sample(sample) => sample,
            Next::Wait => continue,
            Next::End => return Ok(None),
        };
        let Some(due) = source.due_ns(&sample) else {
            return Err(Failure::usage(format!(
                "node \"{}\": cannot go on after a restart, since nothing says where the stream is now; expected a rate",
                process.node.name
            )));
        };
        if start + due >= monotonic_ns() {
            return Ok(Some(sample));
        }
    }
    Ok(None)
}

/// Sleeps until the monotonic clock reads `due`; wakes the readers first, so that they work meanwhile.
fn sleep_until<W: Wire>(due: u64, output: &mut Output<W>, process: &Process) {
    loop {
        let now = monotonic_ns();
        if now >= due {
            return;
        }
        output.flush();
        if process.stop.requested() {
            return;
        }
        std::thread::sleep(Duration::from_nanos((due - now).min(100_000_000)));
    }
}
