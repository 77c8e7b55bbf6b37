//! The process around a link: a live stream leaves a graph here and enters another graph on another machine.
//!
//! The sender is a reader of its topic like any other and hands every sample to what carries it. The receiver is a
//! source: it numbers nothing anew, so that a hole in the numbers is what was lost on the way; it is counted and flagged.

use crate::any::with_messages;
use crate::bus::shift_hops;
use crate::bus::{Input, LinkReader, LinkWriter, Output, Received, Wake, end_of_stream, wait_for_type};
use crate::clock::{monotonic_ns, wall_ahead_ns};
use crate::control::{Event, Gauge, StageReport};
use crate::domain::{Domain, RunDir};
use crate::latency::{EdgeMeter, LatencyMeter};
use crate::process::{Failure, Process, Pulse, main_with};
use lacuna_interfaces::graph::Mode;
use lacuna_interfaces::wire::MAX_HOPS;
use lacuna_interfaces::{
    BadInput, FrictionTorque, Header, JointMeasured, JointSmoothed, PayloadEstimate, ResidualWatch, TorqueModel, Wire,
    flag,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// How often the carrier is looked at.
const LOOK: Duration = Duration::from_millis(100);
/// A receiver that found nothing looks again after this; its sender on another machine cannot ring.
const POLL: Duration = Duration::from_micros(250);
/// The end of the stream is said so often: a receiver that joins late or loses one must hear it, too.
const FAREWELLS: u32 = 25;
const BETWEEN_FAREWELLS: Duration = Duration::from_millis(20);

/// How the clocks of the two machines go together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clocks {
    /// Nothing is known: stamps of hops before the link are cleared, latencies begin there.
    #[default]
    Apart,
    /// Both ends run on one machine, in network namespaces or containers.
    One,
    /// The wall clocks are synchronised (PTP): stamps cross by them, and latencies are as good as that.
    Synchronised,
}

/// What a carrier is told.
#[derive(Debug, Clone, Copy)]
pub struct LinkContext<'a> {
    /// The run's directory: `domain.toml` is there.
    pub run: &'a RunDir,
    /// Node name.
    pub node: &'a str,
    /// Topic of the graph whose stream is carried.
    pub topic: &'a str,
    /// True at the end where the stream leaves.
    pub sends: bool,
}

/// What carries the stream between the machines: a process beside this one that attaches to the link's topic.
pub trait Carrier: Sized {
    /// The node's `[config]` table.
    type Config: DeserializeOwned;

    /// Checks the configuration.
    ///
    /// # Errors
    /// [`BadInput`] if it cannot be used.
    fn new(config: Self::Config, context: &LinkContext<'_>) -> Result<Self, BadInput>;

    /// Name of the message that is carried: a receiver cannot ask the other machine.
    fn message(&self) -> Option<&str>;

    /// How long the machines may take to find each other before the stream begins.
    fn settle(&self) -> Duration;

    /// How the clocks of the two machines go together; the same at both ends.
    fn clocks(&self) -> Clocks;

    /// Starts it.
    ///
    /// # Errors
    /// A reason, if it cannot be started.
    fn start(&mut self) -> Result<(), String>;

    /// Looks after it.
    ///
    /// # Errors
    /// A reason, if it has ended.
    fn check(&mut self) -> Result<(), String>;
}

/// `main` of a link process: a node with an input sends, a node with an output receives.
pub fn run_link<C: Carrier>() -> ExitCode {
    main_with(body::<C>)
}

macro_rules! dispatch {
    ($($message:ident),*) => {
        /// Sends the stream of the message whose type name on the bus is `found`.
        fn send_any<C: Carrier>(found: &str, process: &Process, domain: &Domain, topic: &str, carrier: C) -> Result<StageReport, Failure> {
            $(if found == $message::type_name() {
                return send::<$message, C>(process, domain, topic, carrier);
            })*
            Err(unknown(found, &[$($message::type_name()),*]))
        }

        /// Receives the stream of the message of this name.
        fn receive_any<C: Carrier>(name: &str, process: &Process, domain: &Domain, topic: &str, carrier: C) -> Result<StageReport, Failure> {
            $(if name == $message::NAME {
                return receive::<$message, C>(process, domain, topic, carrier);
            })*
            Err(unknown(name, &[$($message::NAME.to_owned()),*]))
        }
    };
}

with_messages!(dispatch);

fn unknown(found: &str, known: &[String]) -> Failure {
    Failure::usage(format!("link: found message {found}; expected one of {}", known.join(", ")))
}

fn body<C: Carrier>(process: &Process) -> Result<StageReport, Failure> {
    let name = &process.node.name;
    let bad = |what: String| Failure::usage(format!("node \"{name}\": {what}"));
    if process.graph.mode != Mode::Live {
        return Err(bad("a link carries live streams only, and this graph is a replay; expected mode = \"live\" (move the recording instead)".to_owned()));
    }
    let (topic, sends) = match (process.node.inputs.as_slice(), process.node.output.as_deref()) {
        ([topic], None) => (topic.as_str(), true),
        ([], Some(topic)) => (topic, false),
        _ => return Err(bad("found neither a sender nor a receiver; expected one input, or one output".to_owned())),
    };
    let context = LinkContext { run: &process.run, node: name, topic, sends };
    let carrier = C::new(process.config()?, &context).map_err(|e| bad(e.to_string()))?;
    let domain = process.domain()?;
    if sends {
        let Some(found) = wait_for_type(topic, &process.stop, || process.ended(topic))? else {
            Event::Ready.emit();
            return Ok(StageReport::default());
        };
        send_any(&found, process, &domain, topic, carrier)
    } else {
        let found = carrier.message().unwrap_or(JointMeasured::NAME).to_owned();
        receive_any(&found, process, &domain, topic, carrier)
    }
}

/// Waits, looking after the carrier.
fn settle<C: Carrier>(carrier: &mut C, process: &Process) -> Result<(), Failure> {
    let until = Instant::now() + carrier.settle();
    while Instant::now() < until && !process.stop.requested() {
        carrier.check().map_err(Failure::run)?;
        std::thread::sleep(LOOK.min(carrier.settle()));
    }
    Ok(())
}

fn send<W: Wire, C: Carrier>(
    process: &Process,
    domain: &Domain,
    topic: &str,
    mut carrier: C,
) -> Result<StageReport, Failure> {
    let mut wake = Wake::open(domain, &process.node.name)?;
    let mut input = Input::<W>::open(domain, &process.graph, topic, process.buffer())?;
    let mut link = LinkWriter::<W>::open(domain, topic)?;
    carrier.start().map_err(Failure::run)?;
    settle(&mut carrier, process)?;
    Event::Ready.emit();

    let by_wall = carrier.clocks() == Clocks::Synchronised;
    let mut pulse = Pulse::new();
    let mut looked = Instant::now();
    let mut last: Option<Header> = None;
    loop {
        let ended = process.ended(topic);
        match input.receive()? {
            None if ended => break,
            // A bell would not ring for what waits here.
            None if link.flush_if_due()? => std::thread::sleep(POLL),
            None => wake.wait(),
            Some(Received::End) => break,
            Some(Received::Sample { sample, missing }) => {
                let mut message = sample.payload().0;
                let header = message.header_mut();
                header.restarts += process.restarts;
                if missing > 0 || (process.restarts > 0 && last.is_none()) {
                    header.flags |= flag::GAP;
                }
                if process.restarts > 0 && last.is_none() {
                    Event::Flowing { at_ns: monotonic_ns() }.emit();
                }
                last = Some(*header);
                link.send(&message, by_wall)?;
            }
        }
        if process.stop.requested() {
            return Err(Failure::Stopped);
        }
        if looked.elapsed() > LOOK {
            looked = Instant::now();
            carrier.check().map_err(Failure::run)?;
        }
        pulse.progress(input.received(), None, || Gauge {
            dropped: link.dropped,
            missing: input.missing(),
            ..Gauge::default()
        });
    }
    link.flush()?;
    let report = StageReport {
        received: [(topic.to_owned(), input.received())].into(),
        dropped: link.dropped,
        missing: input.missing(),
        details: serde_json::json!({ "sent": link.sent }),
        ..StageReport::default()
    };
    // Letting go of the input tells the writer that the sentinel was taken.
    drop(input);
    farewell(&mut link, last)?;
    Ok(report)
}

/// Says several times that the stream is over, then gives the carrier the time to carry it.
fn farewell<W: Wire>(link: &mut LinkWriter<W>, last: Option<Header>) -> Result<(), Failure> {
    let end = end_of_stream::<W>(last.map_or(0, |h| h.seq) + 1, last.map_or(0, |h| h.joints));
    for _ in 0..FAREWELLS {
        link.send(&end, false)?;
        link.flush()?;
        std::thread::sleep(BETWEEN_FAREWELLS);
    }
    Ok(())
}

fn receive<W: Wire, C: Carrier>(
    process: &Process,
    domain: &Domain,
    topic: &str,
    mut carrier: C,
) -> Result<StageReport, Failure> {
    let mut link = LinkReader::<W>::open(domain, topic)?;
    let mut output = Output::<W>::open(domain, &process.graph, topic, &process.stop)?;
    carrier.start().map_err(Failure::run)?;
    Event::Ready.emit();
    process.wait_for_go();

    let mut pulse = Pulse::new();
    let mut looked = Instant::now();
    let mut arrival = Arrival::new(carrier.clocks());
    let mut meter = EdgeMeter::new(arrival.clocks != Clocks::Apart);
    while !process.stop.requested() {
        match link.receive()? {
            None => {
                output.flush();
                std::thread::sleep(POLL);
            }
            Some(message) if message.header().has(flag::END_OF_STREAM) => {
                arrival.missing += message.header().seq.saturating_sub(arrival.last_seq + 1);
                break;
            }
            Some(mut message) => {
                if arrival.takes(message.header_mut(), process.restarts) {
                    meter.record(message.header());
                    output.send(&message)?;
                }
            }
        }
        if looked.elapsed() > LOOK {
            looked = Instant::now();
            carrier.check().map_err(Failure::run)?;
        }
        pulse.progress(arrival.received, None, || meter.take(output.dropped(), arrival.missing));
    }
    let report = StageReport {
        published: output.published(),
        last_seq: arrival.last_seq,
        dropped: output.dropped(),
        missing: arrival.missing,
        latency: arrival.latency.report(),
        details: serde_json::json!({
            "before_joining": arrival.before_joining,
            "repeated": arrival.repeated,
            "stamped_later_than_they_came": arrival.ahead,
        }),
        ..StageReport::default()
    };
    process.stop.clear();
    output.finish(arrival.last_seq + 1, process.robot.file.joint_count() as u32)?;
    Ok(report)
}

/// What has come so far.
struct Arrival {
    clocks: Clocks,
    last_seq: u64,
    received: u64,
    /// Numbers that never came, since the first that did.
    missing: u64,
    /// Numbers before the first that came: the stream had begun when the machines found each other.
    before_joining: u64,
    /// Numbers that came again, or late.
    repeated: u64,
    /// Samples that came before they were sent, by the clocks: these do not go together then.
    ahead: u64,
    latency: LatencyMeter,
}

impl Arrival {
    fn new(clocks: Clocks) -> Self {
        let latency = LatencyMeter::new();
        Self { clocks, last_seq: 0, received: 0, missing: 0, before_joining: 0, repeated: 0, ahead: 0, latency }
    }

    /// Takes note of a sample and makes it one of this graph; `false` for one that must not go on.
    fn takes(&mut self, header: &mut Header, restarts: u32) -> bool {
        if header.seq <= self.last_seq {
            self.repeated += 1;
            return false;
        }
        let hole = header.seq - self.last_seq - 1;
        if self.received > 0 {
            self.missing += hole;
        } else {
            self.before_joining = hole;
        }
        if hole > 0 {
            header.flags |= flag::GAP;
        }
        self.last_seq = header.seq;
        self.received += 1;
        header.restarts += restarts;
        match self.clocks {
            // Stamps of another machine's clock say nothing here.
            Clocks::Apart => {
                (header.hops, header.hop_ns) = (0, [0; MAX_HOPS]);
                return true;
            }
            Clocks::One => {}
            Clocks::Synchronised => shift_hops(header, wall_ahead_ns().saturating_neg()),
        }
        let now_ns = monotonic_ns();
        let sent = (header.hops as usize).min(MAX_HOPS).checked_sub(1).and_then(|i| header.hop_ns.get(i));
        self.ahead += u64::from(sent.is_some_and(|at| *at > now_ns));
        self.latency.record(header, now_ns);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(seq: u64) -> Header {
        Header { seq, hops: 2, hop_ns: [5, 6, 0, 0, 0, 0, 0, 0], ..Header::default() }
    }

    #[test]
    fn holes_are_counted_from_the_first_sample_on_and_flagged() {
        let mut arrival = Arrival::new(Clocks::Apart);
        let mut take = |seq: u64| {
            let mut h = header(seq);
            let taken = arrival.takes(&mut h, 0);
            (taken, h.has(flag::GAP), h.hops, h.hop_ns[0])
        };
        // 1 to 4 were gone before the machines found each other; 7 is lost; 6 comes twice.
        assert_eq!(take(5), (true, true, 0, 0));
        assert_eq!(take(6), (true, false, 0, 0));
        assert!(!take(6).0);
        assert_eq!(take(8), (true, true, 0, 0));
        assert_eq!((arrival.before_joining, arrival.missing, arrival.repeated, arrival.received), (4, 1, 1, 3));
    }

    #[test]
    fn with_one_clock_the_stamps_go_on() {
        let mut arrival = Arrival::new(Clocks::One);
        let mut h = header(1);
        assert!(arrival.takes(&mut h, 3) && h.hops == 2 && h.restarts == 3 && !h.has(flag::GAP));
        assert_eq!((h.hop_ns[1], arrival.ahead), (6, 0));
    }

    #[test]
    fn stamps_cross_by_the_wall_clock() {
        let mut arrival = Arrival::new(Clocks::Synchronised);
        let now = monotonic_ns();
        let mut h = header(1);
        h.hop_ns = [now - 9_000_000, now - 5_000_000, 0, 0, 0, 0, 0, 0];
        shift_hops(&mut h, wall_ahead_ns());
        assert!(h.hop_ns[0] > 1_700_000_000_000_000_000 && h.hop_ns[2] == 0, "since 1970, hops alone");
        assert!(arrival.takes(&mut h, 0));
        assert!(h.hop_ns[1].abs_diff(now - 5_000_000) < 1_000_000 && h.hop_ns[1] - h.hop_ns[0] == 4_000_000);
        // A sender whose clock is an hour fast: told, since such latencies mean nothing.
        let mut h = header(2);
        h.hop_ns[1] = now + 3_600_000_000_000;
        shift_hops(&mut h, wall_ahead_ns());
        assert!(arrival.takes(&mut h, 0) && arrival.ahead == 1);
    }
}
