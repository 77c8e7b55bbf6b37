//! Typed edges on the bus.
//!
//! Facts this rests on (measured with iceoryx2 0.10): the default edge drops silently; a struct is
//! recognised by name, size and alignment only; a writer that starts before its reader sends into the void;
//! a killed reader blocks a waiting writer until somebody cleans up after it; notifications coalesce, so a
//! reader must drain before it waits.

use crate::clock::monotonic_ns;
use crate::domain::Domain;
use crate::process::{Failure, Stop};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, SendError};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::wire::MAX_HOPS;
use lacuna_interfaces::{Wire, flag};
use std::any::TypeId;
use std::collections::HashMap;
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

/// How long ports may take to come up, and how long a reader may hold back its writer in a replay.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);
const STALL_TIMEOUT: Duration = Duration::from_secs(60);
/// A blocked writer yields so often, then sleeps between looks.
const BLOCKED_YIELDS: u64 = 4;
/// A writer wakes its readers at the latest after this many samples.
const NOTIFY_EVERY: u32 = 64;

/// A message as the bus sees it: the wire type under its name with the layout hash.
#[repr(transparent)]
#[derive(Debug, Clone, Copy)]
pub struct Envelope<W: Wire>(pub W);

#[expect(unsafe_code, reason = "the bus's marker trait; the promise is that of Wire")]
// SAFETY: Wire promises repr(C) plain data without pointers, and Envelope is transparent over it.
unsafe impl<W: Wire> ZeroCopySend for Envelope<W> {
    unsafe fn type_name() -> &'static str {
        static NAMES: OnceLock<Mutex<HashMap<TypeId, &'static str>>> = OnceLock::new();
        let mut names = NAMES.get_or_init(Mutex::default).lock().unwrap_or_else(|e| e.into_inner());
        // One small leak per message type and process: the bus wants a static name.
        names.entry(TypeId::of::<W>()).or_insert_with(|| Box::leak(W::type_name().into_boxed_str()))
    }
}

type Factory<W> = publish_subscribe::PortFactory<ipc::Service, Envelope<W>, ()>;

fn service_name(text: &str) -> Result<ServiceName, Failure> {
    text.try_into().map_err(|e| Failure::run(format!("\"{text}\" is not usable as a topic name: {e:?}")))
}

/// Type name of the message that `topic` carries, once somebody has opened it.
pub fn topic_type(topic: &str) -> Option<String> {
    let name = service_name(topic).ok()?;
    let details = ipc::Service::details(&name, Config::global_config(), MessagingPattern::PublishSubscribe).ok()??;
    Some(details.static_details.publish_subscribe().message_type_details().payload.type_name().to_string())
}

/// Retries `open` while the bus is busy creating or removing the service; any other error is final.
fn open_topic<W: Wire>(domain: &Domain, graph: &GraphFile, topic: &str) -> Result<Factory<W>, Failure> {
    let name = service_name(topic)?;
    let readers = graph.readers(topic).count();
    // A live reader or writer that was killed holds its place until it is cleaned up.
    let spare = if graph.mode == Mode::Live { 2 } else { 0 };
    let started = Instant::now();
    loop {
        let result = domain
            .node()
            .service_builder(&name)
            .publish_subscribe::<Envelope<W>>()
            .enable_safe_overflow(false)
            .history_size(0)
            .subscriber_max_buffer_size(graph.buffer)
            .subscriber_max_borrowed_samples(2)
            .max_publishers(1 + spare)
            .max_subscribers((readers + spare).max(1))
            .max_nodes(readers + 2 + 2 * spare)
            .open_or_create();
        let error = match result {
            Ok(factory) => return Ok(factory),
            Err(e) => e,
        };
        if let PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
            PublishSubscribeOpenError::IncompatibleTypes,
        ) = error
        {
            let other = topic_type(topic).unwrap_or_else(|| "another message".to_owned());
            return Err(Failure::usage(format!(
                "topic \"{topic}\": this stage speaks {}, the topic carries {other}; expected the same message and layout on both sides",
                W::type_name()
            )));
        }
        if started.elapsed() > OPEN_TIMEOUT {
            return Err(Failure::run(format!("topic \"{topic}\": cannot be opened on the bus: {error:?}")));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn open_wake(domain: &Domain, node: &str) -> Result<event::PortFactory<ipc::Service>, Failure> {
    let name = service_name(&format!("wake/{node}"))?;
    let started = Instant::now();
    loop {
        match domain
            .node()
            .service_builder(&name)
            .event()
            .max_listeners(4)
            .max_notifiers(32)
            .max_nodes(36)
            .open_or_create()
        {
            Ok(factory) => return Ok(factory),
            Err(e) if started.elapsed() > OPEN_TIMEOUT => {
                return Err(Failure::run(format!("wake-up of node \"{node}\": cannot be opened on the bus: {e:?}")));
            }
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// How long a blocked writer sleeps: what a reader takes for a quarter of the buffer at a million samples a second.
fn blocked_pause(buffer: usize) -> Duration {
    Duration::from_micros((buffer as u64 / 4).clamp(10, 200))
}

/// The bell that writers ring for one reading node.
#[derive(Debug)]
pub struct Wake {
    listener: Listener<ipc::Service>,
}

impl Wake {
    /// Opens the bell of `node`.
    ///
    /// # Errors
    /// [`Failure`] if the bus refuses.
    pub fn open(domain: &Domain, node: &str) -> Result<Self, Failure> {
        let listener = open_wake(domain, node)?
            .listener_builder()
            .create()
            .map_err(|e| Failure::run(format!("wake-up of node \"{node}\": {e:?}")))?;
        Ok(Self { listener })
    }

    /// Sleeps until a writer rings, a signal arrives or `timeout` passes. Drain the inputs before and after.
    pub fn wait(&self, timeout: Duration) {
        // An interrupt is a signal; the caller looks at its stop flag next. Other errors end as a timeout.
        if self.listener.timed_wait(|_| {}, timeout).is_err() {
            std::thread::sleep(Duration::from_micros(100));
        }
    }
}

/// The writing end of a topic.
pub struct Output<W: Wire> {
    topic: String,
    port: Publisher<ipc::Service, Envelope<W>, ()>,
    factory: Factory<W>,
    notifiers: Vec<Notifier<ipc::Service>>,
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
        let pause = blocked_pause(graph.buffer);
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
        Ok(Self {
            topic: topic.to_owned(),
            port,
            factory,
            notifiers,
            mode: graph.mode,
            expected: readers.len(),
            // Never more unannounced samples than fit half the buffer: a full buffer then implies a rung bell.
            notify_every: NOTIFY_EVERY.min((graph.buffer as u32 / 2).max(1)),
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

    /// Waits until all readers of the graph are connected. Live writers go on after two seconds.
    fn connect(&mut self) -> Result<(), Failure> {
        let started = Instant::now();
        while self.readers() < self.expected {
            if self.stop.requested() {
                return Err(Failure::Stopped);
            }
            let limit = if self.mode == Mode::Live { Duration::from_secs(2) } else { OPEN_TIMEOUT };
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
        let header = sample.payload_mut().0.header_mut();
        let hop = header.hops as usize;
        if hop < MAX_HOPS {
            header.hop_ns[hop] = monotonic_ns();
        }
        header.hops += 1;
        header.dropped += self.dropped;
        sample.send().map_err(|e| match e {
            _ if self.stop.requested() => Failure::Stopped,
            SendError::UnableToDeliver => Failure::run(format!(
                "topic \"{}\": a reader took nothing for {} s; it hangs or is stopped",
                self.topic,
                STALL_TIMEOUT.as_secs()
            )),
            e => Failure::run(format!("topic \"{}\": cannot send: {e:?}", self.topic)),
        })
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
        let mut end = W::default();
        end.header_mut().seq = seq;
        end.header_mut().joints = joints;
        end.header_mut().flags = flag::END_OF_STREAM;
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
        while self.readers() > 0 {
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

/// A sample in shared memory, or the end of the stream.
pub enum Received<W: Wire> {
    /// A sample; `missing` samples before it were lost (always 0 in a replay).
    Sample {
        /// The message, still in shared memory.
        sample: Sample<ipc::Service, Envelope<W>, ()>,
        /// Samples lost before it.
        missing: u64,
    },
    /// The sentinel: nothing comes after it.
    End,
}

/// The reading end of a topic. Dropping it after [`Received::End`] tells the writer that all was taken.
pub struct Input<W: Wire> {
    topic: String,
    port: Subscriber<ipc::Service, Envelope<W>, ()>,
    mode: Mode,
    last_seq: Option<u64>,
    received: u64,
    missing: u64,
}

impl<W: Wire> Input<W> {
    /// Opens the reading end of `topic`.
    ///
    /// # Errors
    /// [`Failure`] if the topic carries another message, or the bus refuses.
    pub fn open(domain: &Domain, graph: &GraphFile, topic: &str) -> Result<Self, Failure> {
        let port = open_topic::<W>(domain, graph, topic)?
            .subscriber_builder()
            .buffer_size(graph.buffer)
            .create()
            .map_err(|e| Failure::run(format!("topic \"{topic}\": cannot read from it: {e:?}")))?;
        Ok(Self { topic: topic.to_owned(), port, mode: graph.mode, last_seq: None, received: 0, missing: 0 })
    }

    /// Topic name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Samples received so far.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Samples missing in the sequence so far.
    pub fn missing(&self) -> u64 {
        self.missing
    }

    /// Next sample, if one is there.
    ///
    /// # Errors
    /// [`Failure`] on a hole in a replay's sequence, or if the bus fails.
    pub fn receive(&mut self) -> Result<Option<Received<W>>, Failure> {
        loop {
            let sample = self
                .port
                .receive()
                .map_err(|e| Failure::run(format!("topic \"{}\": cannot receive: {e:?}", self.topic)))?;
            let Some(sample) = sample else { return Ok(None) };
            let header = sample.payload().0.header();
            let (seq, end) = (header.seq, header.has(flag::END_OF_STREAM));
            // A replay begins at 1; a live reader may join later.
            let expected = match (self.last_seq, self.mode) {
                (Some(last), _) => last + 1,
                (None, Mode::Replay) => 1,
                (None, Mode::Live) => seq,
            };
            if seq < expected {
                continue;
            }
            let missing = seq - expected;
            if missing > 0 && self.mode == Mode::Replay {
                return Err(Failure::run(format!(
                    "topic \"{}\": sample {seq} came where {expected} was expected; {missing} samples were lost",
                    self.topic
                )));
            }
            self.missing += missing;
            self.last_seq = Some(seq);
            if end {
                return Ok(Some(Received::End));
            }
            self.received += 1;
            return Ok(Some(Received::Sample { sample, missing }));
        }
    }
}
