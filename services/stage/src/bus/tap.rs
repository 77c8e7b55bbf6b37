//! A tap on a live topic: a service of its own beside the edge, for observers that come and go.
//!
//! On the edge itself an observer would be counted among the readers: its place would hide that one of them missed a
//! sample, and the writer would wait for it at the end. The tap overwrites what an observer does not take, so nobody
//! ever waits for one, and while there is none it costs a look at a counter.

use super::{Envelope, Factory, Room, open_service, service_name, topic_type};
use crate::domain::Domain;
use crate::process::Failure;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use lacuna_interfaces::{Wire, flag};

/// Samples an observer may be behind before it misses some.
const BUFFER: usize = 256;
/// Observers of a topic at a time.
const OBSERVERS: usize = 4;
/// Writers and observers that were killed hold their places until they are cleaned up.
const SPARE: usize = 2;

fn tap_name(topic: &str) -> String {
    format!("tap/{topic}")
}

/// Type name of the message that the tap of `topic` carries, if its writer has one.
pub fn tap_type(topic: &str) -> Option<String> {
    topic_type(&tap_name(topic))
}

fn open<W: Wire>(domain: &Domain, topic: &str) -> Result<Factory<W>, Failure> {
    let room = Room {
        overflow: true,
        buffer: BUFFER,
        writers: 1 + SPARE,
        readers: OBSERVERS + SPARE,
        nodes: 1 + OBSERVERS + 2 * SPARE,
    };
    open_service(domain, &service_name(&tap_name(topic))?, &room)
        .map_err(|e| Failure::run(format!("topic \"{topic}\": its tap cannot be opened on the bus: {e:?}")))
}

/// The writer's side.
pub(super) struct Tap<W: Wire> {
    factory: Factory<W>,
    port: Publisher<ipc::Service, Envelope<W>, ()>,
}

impl<W: Wire> Tap<W> {
    pub(super) fn open(domain: &Domain, topic: &str) -> Result<Self, Failure> {
        let factory = open(domain, topic)?;
        let port = factory
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(|e| Failure::run(format!("topic \"{topic}\": cannot write to its tap: {e:?}")))?;
        Ok(Self { factory, port })
    }

    /// Whether anybody looks.
    pub(super) fn is_watched(&self) -> bool {
        self.factory.dynamic_config().number_of_subscribers() > 0
    }

    /// Shows a sample to the observers. What goes wrong here is theirs alone.
    pub(super) fn show(&self, message: W) {
        if let Ok(sample) = self.port.loan_uninit() {
            let _ = sample.write_payload(Envelope(message)).send();
        }
    }
}

/// An observer's side.
pub struct TapInput<W: Wire> {
    topic: String,
    port: Subscriber<ipc::Service, Envelope<W>, ()>,
    last_seq: Option<u64>,
}

impl<W: Wire> TapInput<W> {
    /// Attaches to the tap of `topic`.
    ///
    /// # Errors
    /// [`Failure`] if the bus refuses, e.g. because there are observers enough.
    pub fn open(domain: &Domain, topic: &str) -> Result<Self, Failure> {
        let port = open::<W>(domain, topic)?.subscriber_builder().buffer_size(BUFFER).create().map_err(|e| {
            Failure::run(format!(
                "topic \"{topic}\": cannot be observed: {e:?} (at most {OBSERVERS} observers a topic)"
            ))
        })?;
        Ok(Self { topic: topic.to_owned(), port, last_seq: None })
    }

    /// Topic name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Calls `take(message, missing)` for every sample that is there; `true` at the end of the stream. What is missing was
    /// lost on the way to this observer or before.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails, or `take` does.
    pub fn drain(&mut self, take: &mut dyn FnMut(&W, u64) -> Result<(), Failure>) -> Result<bool, Failure> {
        // As many as there can be: an observer of a quick topic must come back to the others.
        for _ in 0..BUFFER {
            let sample = self.port.receive();
            let sample =
                sample.map_err(|e| Failure::run(format!("topic \"{}\": cannot be observed: {e:?}", self.topic)))?;
            let Some(sample) = sample else { break };
            let message = &sample.payload().0;
            let header = message.header();
            if header.has(flag::END_OF_STREAM) {
                return Ok(true);
            }
            let missing = self.last_seq.map_or(0, |last| header.seq.saturating_sub(last + 1));
            self.last_seq = Some(header.seq);
            take(message, missing)?;
        }
        Ok(false)
    }
}
