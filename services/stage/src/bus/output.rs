//! The writing end of a topic.

use super::tap::Tap;
use super::{Envelope, Factory, OPEN_TIMEOUT, STALL_TIMEOUT, end_of_stream, open_topic, open_wake, stamp_hop};
use crate::domain::Domain;
use crate::process::{Failure, Stop};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::{BackpressureAction, SendError};
use iceoryx2::prelude::*;
use lacuna_interfaces::Wire;
use lacuna_interfaces::graph::{GraphFile, Mode};
use std::time::{Duration, Instant};

/// How long a live writer waits for readers before its first sample. All were ready when the stream was let go, so
/// one that is missing has died since; the others must not wait for it.
const LIVE_CONNECT: Duration = Duration::from_millis(100);
/// How often a live writer says again that the stream is over: a reader may have been started again since.
const END_AGAIN: Duration = Duration::from_millis(20);
/// A blocked writer yields so often, then sleeps between looks.
const BLOCKED_YIELDS: u64 = 4;
/// A writer wakes its readers at the latest after this many samples.
const NOTIFY_EVERY: u32 = 64;

/// How long a blocked writer sleeps: what a reader takes for a quarter of the buffer at a million samples a second.
fn blocked_pause(buffer: usize) -> Duration {
    Duration::from_micros((buffer as u64 / 4).clamp(10, 200))
}

/// The writing end of a topic.
pub struct Output<W: Wire> {
    topic: String,
    port: Publisher<ipc::Service, Envelope<W>, ()>,
    factory: Factory<W>,
    notifiers: Vec<Notifier<ipc::Service>>,
    /// For observers; never in a replay.
    tap: Option<Tap<W>>,
    mode: Mode,
    expected: usize,
    notify_every: u32,
    unnotified: u32,
    connected: bool,
    stop: Stop,
    published: u64,
    dropped: u64,
}

impl<W: Wire> Output<W> {
    /// Opens the writing end of `topic` for the readers that `graph` names.
    ///
    /// # Errors
    /// [`Failure`] if the topic carries another message, or the bus refuses.
    pub fn open(domain: &Domain, graph: &GraphFile, topic: &str, stop: &Stop) -> Result<Self, Failure> {
        let factory = open_topic::<W>(domain, graph, topic)?;
        let readers: Vec<String> = graph.readers(topic).map(|n| n.name.clone()).collect();
        let handler_stop = stop.clone();
        let smallest = graph.buffers(topic).0;
        let pause = blocked_pause(smallest);
        let builder = factory.publisher_builder().max_loaned_samples(1);
        let builder = match graph.mode {
            Mode::Live => builder.backpressure_strategy(BackpressureStrategy::DiscardData),
            Mode::Replay => builder
                .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
                .set_backpressure_handler(move |info| {
                    if handler_stop.requested() || info.elapsed_time > STALL_TIMEOUT {
                        BackpressureAction::DiscardDataAndFail
                    } else {
                        // The bus itself would yield ten thousand times first and take the processor from the
                        // very reader it waits for.
                        if info.retries > BLOCKED_YIELDS {
                            std::thread::sleep(pause);
                        }
                        BackpressureAction::Retry
                    }
                }),
        };
        let port = builder.create().map_err(|e| {
            Failure::run(format!("topic \"{topic}\": cannot write to it: {e:?} (is another writer running?)"))
        })?;
        let notifiers = readers
            .iter()
            .map(|node| {
                open_wake(domain, node)?
                    .notifier_builder()
                    .create()
                    .map_err(|e| Failure::run(format!("wake-up of node \"{node}\": {e:?}")))
            })
            .collect::<Result<Vec<_>, Failure>>()?;
        let tap = match graph.mode {
            Mode::Replay => None,
            // A graph runs without being looked at.
            Mode::Live => Tap::open(domain, topic).inspect_err(|e| tracing::warn!("no observers: {e}")).ok(),
        };
        Ok(Self {
            topic: topic.to_owned(),
            port,
            factory,
            notifiers,
            tap,
            mode: graph.mode,
            expected: readers.len(),
            // Never more unannounced samples than fit half the buffer: a full buffer then implies a rung bell.
            notify_every: NOTIFY_EVERY.min((smallest as u32 / 2).max(1)),
            unnotified: 0,
            connected: false,
            stop: stop.clone(),
            published: 0,
            dropped: 0,
        })
    }

    /// Samples published so far.
    pub fn published(&self) -> u64 {
        self.published
    }

    /// Deliveries that readers could not take so far.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    fn readers(&self) -> usize {
        self.factory.dynamic_config().number_of_subscribers()
    }

    /// Waits until all readers of the graph are connected; a live writer does not wait long.
    fn connect(&mut self) -> Result<(), Failure> {
        let started = Instant::now();
        while self.readers() < self.expected {
            if self.stop.requested() {
                return Err(Failure::Stopped);
            }
            let limit = if self.mode == Mode::Live { LIVE_CONNECT } else { OPEN_TIMEOUT };
            if started.elapsed() > limit {
                if self.mode == Mode::Live {
                    break;
                }
                return Err(Failure::run(format!(
                    "topic \"{}\": {} of {} readers connected after {} s",
                    self.topic,
                    self.readers(),
                    self.expected,
                    limit.as_secs()
                )));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        self.connected = true;
        Ok(())
    }

    /// Publishes a sample with the stamp of this hop. Replay: returns once every reader's buffer holds it.
    ///
    /// # Errors
    /// [`Failure::Stopped`] on a stop request; [`Failure`] if a reader went away or stalled (replay).
    pub fn send(&mut self, message: &W) -> Result<(), Failure> {
        if !self.connected {
            self.connect()?;
        }
        let delivered = self.deliver(message)?;
        if delivered < self.expected {
            match self.mode {
                Mode::Live => self.dropped += (self.expected - delivered) as u64,
                Mode::Replay => self.deliver_again(message)?,
            }
        }
        self.published += 1;
        self.unnotified += 1;
        if self.unnotified >= self.notify_every {
            self.ring();
        }
        Ok(())
    }

    /// A reader that is registered but has not looked at its port yet does not take part in backpressure: the
    /// bus then drops what does not fit its buffer. Send the sample again until all have it; those that have
    /// it already recognise it by its sequence number.
    fn deliver_again(&mut self, message: &W) -> Result<(), Failure> {
        let started = Instant::now();
        while self.readers() >= self.expected && started.elapsed() < OPEN_TIMEOUT {
            self.ring();
            std::thread::sleep(Duration::from_micros(200));
            if self.deliver(message)? >= self.expected {
                return Ok(());
            }
        }
        Err(Failure::run(format!(
            "topic \"{}\": sample {} did not reach all of {} readers; one has gone or hangs",
            self.topic,
            message.header().seq,
            self.expected
        )))
    }

    fn deliver(&mut self, message: &W) -> Result<usize, Failure> {
        let sample = self
            .port
            .loan_uninit()
            .map_err(|e| Failure::run(format!("topic \"{}\": no memory for a sample: {e:?}", self.topic)))?;
        let mut sample = sample.write_payload(Envelope(*message));
        stamp_hop(sample.payload_mut().0.header_mut(), self.dropped);
        let watched = self.tap.as_ref().filter(|tap| tap.is_watched()).map(|tap| (tap, sample.payload().0));
        let delivered = sample.send().map_err(|e| match e {
            _ if self.stop.requested() => Failure::Stopped,
            SendError::UnableToDeliver => Failure::run(format!(
                "topic \"{}\": a reader took nothing for {} s; it hangs or is stopped",
                self.topic,
                STALL_TIMEOUT.as_secs()
            )),
            e => Failure::run(format!("topic \"{}\": cannot send: {e:?}", self.topic)),
        })?;
        if let Some((tap, message)) = watched {
            tap.show(message);
        }
        Ok(delivered)
    }

    /// Wakes the readers if there is anything they were not told of. Call it before waiting for input.
    pub fn flush(&mut self) {
        if self.unnotified > 0 {
            self.ring();
        }
    }

    fn ring(&mut self) {
        self.unnotified = 0;
        for notifier in &self.notifiers {
            // A reader that is gone cannot be woken; sending to it fails where it matters.
            let _ = notifier.notify();
        }
    }

    /// Publishes the end-of-stream sentinel and waits until every reader has taken it and let go.
    ///
    /// # Errors
    /// [`Failure`] if readers do not take it in time.
    pub fn finish(mut self, seq: u64, joints: u32) -> Result<(), Failure> {
        if !self.connected {
            self.connect()?;
        }
        let end = end_of_stream::<W>(seq, joints);
        let started = Instant::now();
        while self.deliver(&end)? < self.expected && self.readers() > 0 {
            // Live readers with a full buffer: once more. Readers drop the copies by their sequence number.
            self.ring();
            std::thread::sleep(Duration::from_millis(1));
            if started.elapsed() > OPEN_TIMEOUT {
                break;
            }
        }
        self.ring();
        let mut said = Instant::now();
        while self.readers() > 0 {
            if self.mode == Mode::Live && said.elapsed() > END_AGAIN {
                said = Instant::now();
                self.deliver(&end)?;
                self.ring();
            }
            if self.stop.requested() {
                return Err(Failure::Stopped);
            }
            if started.elapsed() > STALL_TIMEOUT {
                return Err(Failure::run(format!(
                    "topic \"{}\": {} readers did not take the end of the stream within {} s",
                    self.topic,
                    self.readers(),
                    STALL_TIMEOUT.as_secs()
                )));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }
}
