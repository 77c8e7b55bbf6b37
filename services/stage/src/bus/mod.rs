//! Typed edges on the bus.
//!
//! Facts this rests on (measured with iceoryx2 0.10): the default edge drops silently; a struct is
//! recognised by name, size and alignment only; a writer that starts before its reader sends into the void;
//! a killed reader blocks a waiting writer until somebody cleans up after it; notifications coalesce, so a
//! reader must drain before it waits.

mod input;
mod link;
mod output;
mod tap;

pub use input::{Input, Received};
pub(crate) use link::shift_hops;
pub use link::{LinkReader, LinkWriter, link_topic};
pub use output::Output;
pub use tap::{TapInput, tap_type};

use crate::clock::monotonic_ns;
use crate::domain::Domain;
use crate::process::{Failure, Stop};
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe as publish_subscribe_builder;
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::{Header, Wire, flag};
use std::any::TypeId;
use std::collections::HashMap;
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

/// How long ports may take to come up, and how long a reader may hold back its writer in a replay.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);
const STALL_TIMEOUT: Duration = Duration::from_secs(60);

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
type Batches<W> = publish_subscribe::PortFactory<ipc::Service, [Envelope<W>], ()>;

fn service_name(text: &str) -> Result<ServiceName, Failure> {
    text.try_into().map_err(|e| Failure::run(format!("\"{text}\" is not usable as a topic name: {e:?}")))
}

/// Type name of the message that `topic` carries, once somebody has opened it.
pub fn topic_type(topic: &str) -> Option<String> {
    let name = service_name(topic).ok()?;
    let details = ipc::Service::details(&name, Config::global_config(), MessagingPattern::PublishSubscribe).ok()??;
    Some(details.static_details.publish_subscribe().message_type_details().payload.type_name().to_string())
}

/// Waits until somebody has opened `topic` and returns the type name of its message; `None` once it `ended`.
///
/// # Errors
/// [`Failure`] on a stop request, or if nobody opens it in time.
pub(crate) fn wait_for_type(topic: &str, stop: &Stop, ended: impl Fn() -> bool) -> Result<Option<String>, Failure> {
    let started = Instant::now();
    loop {
        if let Some(name) = topic_type(topic) {
            return Ok(Some(name));
        }
        // Its writer left while this process was being started again.
        if ended() {
            return Ok(None);
        }
        if stop.requested() {
            return Err(Failure::Stopped);
        }
        if started.elapsed() > OPEN_TIMEOUT {
            return Err(Failure::run(format!(
                "topic \"{topic}\": nobody opened it within {} s",
                OPEN_TIMEOUT.as_secs()
            )));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// How long to wait before a service that is just being made or removed is tried again.
const TRY_AGAIN: Duration = Duration::from_millis(5);

/// Room that a topic has on the bus.
struct Room {
    /// Whether a full reader loses its oldest sample; otherwise the writer is told.
    overflow: bool,
    /// Samples a reader may be behind.
    buffer: usize,
    writers: usize,
    readers: usize,
    nodes: usize,
}

impl Room {
    fn of<P: std::fmt::Debug + IceoryxSend + ?Sized>(
        &self,
        builder: publish_subscribe_builder::Builder<P, (), ipc::Service>,
    ) -> publish_subscribe_builder::Builder<P, (), ipc::Service> {
        builder
            .enable_safe_overflow(self.overflow)
            .history_size(0)
            .subscriber_max_buffer_size(self.buffer)
            .subscriber_max_borrowed_samples(2)
            .max_publishers(self.writers)
            .max_subscribers(self.readers)
            .max_nodes(self.nodes)
    }
}

/// Opens or makes a topic, again and again while the bus is busy creating or removing it. Another message under its name
/// is final.
fn open_service<W: Wire>(
    domain: &Domain,
    name: &ServiceName,
    room: &Room,
) -> Result<Factory<W>, PublishSubscribeOpenOrCreateError> {
    again_while_busy(|| {
        room.of(domain.node().service_builder(name).publish_subscribe::<Envelope<W>>()).open_or_create()
    })
}

/// The same for messages that each hold several samples.
fn open_batches<W: Wire>(
    domain: &Domain,
    name: &ServiceName,
    room: &Room,
) -> Result<Batches<W>, PublishSubscribeOpenOrCreateError> {
    again_while_busy(|| {
        room.of(domain.node().service_builder(name).publish_subscribe::<[Envelope<W>]>()).open_or_create()
    })
}

fn again_while_busy<T>(
    mut attempt: impl FnMut() -> Result<T, PublishSubscribeOpenOrCreateError>,
) -> Result<T, PublishSubscribeOpenOrCreateError> {
    let started = Instant::now();
    loop {
        match attempt() {
            Err(e) if !speaks_otherwise(&e) && started.elapsed() <= OPEN_TIMEOUT => std::thread::sleep(TRY_AGAIN),
            done => return done,
        }
    }
}

/// Whether the topic is there and carries another message.
fn speaks_otherwise(error: &PublishSubscribeOpenOrCreateError) -> bool {
    matches!(
        error,
        PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(PublishSubscribeOpenError::IncompatibleTypes)
    )
}

/// Opens a topic with room for the readers that `graph` names.
fn open_topic<W: Wire>(domain: &Domain, graph: &GraphFile, topic: &str) -> Result<Factory<W>, Failure> {
    let readers = graph.readers(topic).count();
    // A live reader or writer that was killed holds its place until it is cleaned up.
    let spare = if graph.mode == Mode::Live { 2 } else { 0 };
    let room = Room {
        overflow: false,
        buffer: graph.buffers(topic).1,
        writers: 1 + spare,
        readers: (readers + spare).max(1),
        nodes: readers + 2 + 2 * spare,
    };
    open_service(domain, &service_name(topic)?, &room).map_err(|error| {
        if speaks_otherwise(&error) {
            let other = topic_type(topic).unwrap_or_else(|| "another message".to_owned());
            return Failure::usage(format!(
                "topic \"{topic}\": this stage speaks {}, the topic carries {other}; expected the same message and layout on both sides",
                W::type_name()
            ));
        }
        Failure::run(format!("topic \"{topic}\": cannot be opened on the bus: {error:?}"))
    })
}

/// Stamps a message that leaves this process: the time of the hop, and what was dropped here so far.
fn stamp_hop(header: &mut Header, dropped: u64) {
    if let Some(at) = header.hop_ns.get_mut(header.hops as usize) {
        *at = monotonic_ns();
    }
    header.hops += 1;
    header.dropped += dropped;
}

/// The sentinel after the last sample.
pub(crate) fn end_of_stream<W: Wire>(seq: u64, joints: u32) -> W {
    let mut end = W::default();
    let header = end.header_mut();
    header.seq = seq;
    header.joints = joints;
    header.flags = flag::END_OF_STREAM;
    end
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
            Err(_) => std::thread::sleep(TRY_AGAIN),
        }
    }
}

/// How long a reader sleeps at first. In iceoryx2 0.10 a ring can be lost when it comes while the listener empties
/// its socket, and all further rings are then held back as "already notified" until the listener looks again by
/// itself (eclipse-iceoryx/iceoryx2 issue 1811): the sleep bounds that stall.
const SHORTEST_SLEEP: Duration = Duration::from_millis(1);
/// How long it sleeps once nothing has come for a while. A signal ends it, too.
const LONGEST_SLEEP: Duration = Duration::from_millis(100);

/// The bell that writers ring for one reading node.
#[derive(Debug)]
pub struct Wake {
    listener: Listener<ipc::Service>,
    sleep: Duration,
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
        Ok(Self { listener, sleep: SHORTEST_SLEEP })
    }

    /// Sleeps until a writer rings, a signal arrives or a while passes: short after a ring, longer the longer nothing
    /// came. Drain the inputs before and after.
    pub fn wait(&mut self) {
        match self.listener.timed_wait(|_| {}, self.sleep) {
            Ok(0) => self.sleep = (2 * self.sleep).min(LONGEST_SLEEP),
            Ok(_) => self.sleep = SHORTEST_SLEEP,
            // An interrupt is a signal; the caller looks at its stop flag next. Other errors end as a timeout.
            Err(_) => std::thread::sleep(Duration::from_micros(100)),
        }
    }
}
