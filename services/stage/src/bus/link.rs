//! The two ends of a link: a topic that a tunnel carries to another machine.
//!
//! The tunnel attaches to the topic on both machines with a writer and a reader of its own, so a link's topic has room
//! for them and a name of its own, `link/NAME`, which no other edge of a graph has. Its type name holds the layout of the
//! message: machines whose messages are laid out otherwise are not connected.

use super::{Batches, Envelope, Room, open_batches, service_name, stamp_hop};
use crate::clock::wall_ahead_ns;
use crate::domain::Domain;
use crate::process::Failure;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use lacuna_interfaces::wire::MAX_HOPS;
use lacuna_interfaces::{Header, Wire};
use std::time::{Duration, Instant};

/// Samples in one message. The tunnel lets 64 messages wait on the far side, whatever is in them (0.10: `Inbox`), and drops
/// what comes beyond: sample by sample that would be 16 ms of a 4 kHz stream.
const BATCH: usize = 32;
/// How long a sample may wait for others to go with it.
const COLLECT: Duration = Duration::from_millis(2);
/// Messages that may wait for the tunnel: half a second.
const BUFFER: usize = 256;

/// Name of the topic that a tunnel carries for `topic`.
pub fn link_topic(topic: &str) -> String {
    format!("link/{topic}")
}

fn open<W: Wire>(domain: &Domain, topic: &str) -> Result<Batches<W>, Failure> {
    let room = Room { overflow: false, buffer: BUFFER, writers: 4, readers: 4, nodes: 8 };
    open_batches(domain, &service_name(&link_topic(topic))?, &room)
        .map_err(|e| Failure::run(format!("link \"{topic}\": cannot be opened on the bus: {e:?}")))
}

/// Sets the stamps of all hops ahead.
pub(crate) fn shift_hops(header: &mut Header, by_ns: i64) {
    let hops = (header.hops as usize).min(MAX_HOPS);
    header.hop_ns.iter_mut().take(hops).for_each(|at| *at = at.saturating_add_signed(by_ns));
}

/// The end that the stream goes into.
pub struct LinkWriter<W: Wire> {
    topic: String,
    port: Publisher<ipc::Service, [Envelope<W>], ()>,
    // Keeps the topic's settings in place while the tunnel comes and goes.
    _factory: Batches<W>,
    /// Samples that wait for others to go with them, and since when.
    batch: Vec<Envelope<W>>,
    since: Instant,
    /// Samples handed to the tunnel.
    pub sent: u64,
    /// Samples that the tunnel could not take.
    pub dropped: u64,
}

impl<W: Wire> LinkWriter<W> {
    /// Opens it.
    ///
    /// # Errors
    /// [`Failure`] if the bus refuses.
    pub fn open(domain: &Domain, topic: &str) -> Result<Self, Failure> {
        let factory = open::<W>(domain, topic)?;
        let port = factory
            .publisher_builder()
            .initial_max_slice_len(BATCH)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| Failure::run(format!("link \"{topic}\": cannot write to it: {e:?}")))?;
        Ok(Self {
            topic: topic.to_owned(),
            port,
            _factory: factory,
            batch: Vec::with_capacity(BATCH),
            since: Instant::now(),
            sent: 0,
            dropped: 0,
        })
    }

    /// Takes a message with the stamp of this hop; it goes with those that come within two milliseconds. Never waits. With
    /// `by_wall` all stamps are those of the wall clock.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn send(&mut self, message: &W, by_wall: bool) -> Result<(), Failure> {
        let mut message = *message;
        let header = message.header_mut();
        stamp_hop(header, self.dropped);
        if by_wall {
            shift_hops(header, wall_ahead_ns());
        }
        if self.batch.is_empty() {
            self.since = Instant::now();
        }
        self.batch.push(Envelope(message));
        if self.batch.len() >= BATCH { self.flush() } else { self.flush_if_due().map(|_| ()) }
    }

    /// Hands over what has waited long enough; true while something waits.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn flush_if_due(&mut self) -> Result<bool, Failure> {
        if !self.batch.is_empty() && self.since.elapsed() >= COLLECT {
            self.flush()?;
        }
        Ok(!self.batch.is_empty())
    }

    /// Hands over what waits.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn flush(&mut self) -> Result<(), Failure> {
        if self.batch.is_empty() {
            return Ok(());
        }
        let fail = |e: &dyn std::fmt::Debug| Failure::run(format!("link \"{}\": cannot send: {e:?}", self.topic));
        let loan = self.port.loan_slice_uninit(self.batch.len()).map_err(|e| fail(&e))?;
        let count = self.batch.len() as u64;
        match loan.write_from_slice(&self.batch).send().map_err(|e| fail(&e))? {
            0 => self.dropped += count,
            _ => self.sent += count,
        }
        self.batch.clear();
        Ok(())
    }
}

/// A message of the tunnel: a few samples.
type Batch<W> = Sample<ipc::Service, [Envelope<W>], ()>;

/// The end that the stream comes out of.
pub struct LinkReader<W: Wire> {
    topic: String,
    port: Subscriber<ipc::Service, [Envelope<W>], ()>,
    _factory: Batches<W>,
    /// The message being handed out, and how far.
    batch: Option<(Batch<W>, usize)>,
}

impl<W: Wire> LinkReader<W> {
    /// Opens it.
    ///
    /// # Errors
    /// [`Failure`] if the bus refuses.
    pub fn open(domain: &Domain, topic: &str) -> Result<Self, Failure> {
        let factory = open::<W>(domain, topic)?;
        let port = factory
            .subscriber_builder()
            .buffer_size(BUFFER)
            .create()
            .map_err(|e| Failure::run(format!("link \"{topic}\": cannot read from it: {e:?}")))?;
        Ok(Self { topic: topic.to_owned(), port, _factory: factory, batch: None })
    }

    /// The next sample, if one is there; a copy, since it is changed before it goes on.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn receive(&mut self) -> Result<Option<W>, Failure> {
        loop {
            if let Some((message, at)) = &mut self.batch {
                if let Some(envelope) = message.payload().get(*at) {
                    *at += 1;
                    return Ok(Some(envelope.0));
                }
                self.batch = None;
            }
            let message = self.port.receive();
            let message =
                message.map_err(|e| Failure::run(format!("link \"{}\": cannot receive: {e:?}", self.topic)))?;
            let Some(message) = message else { return Ok(None) };
            self.batch = Some((message, 0));
        }
    }
}
