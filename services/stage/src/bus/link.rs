//! The two ends of a link: a topic that a tunnel carries to another machine.
//!
//! The tunnel attaches to the topic on both machines with a writer and a reader of its own, so a link's topic has room
//! for them and a name of its own, `link/NAME`, which no other edge of a graph has. Its type name holds the layout of the
//! message: machines whose messages are laid out otherwise are not connected.

use super::{Envelope, Factory, Room, open_service, service_name, stamp_hop};
use crate::clock::wall_ahead_ns;
use crate::domain::Domain;
use crate::process::Failure;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use lacuna_interfaces::wire::MAX_HOPS;
use lacuna_interfaces::{Header, Wire};

/// Messages that may wait for the tunnel: half a second at 4 kHz.
const BUFFER: usize = 2048;

/// Name of the topic that a tunnel carries for `topic`.
pub fn link_topic(topic: &str) -> String {
    format!("link/{topic}")
}

fn open<W: Wire>(domain: &Domain, topic: &str) -> Result<Factory<W>, Failure> {
    let room = Room { overflow: false, buffer: BUFFER, writers: 4, readers: 4, nodes: 8 };
    open_service(domain, &service_name(&link_topic(topic))?, &room)
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
    port: Publisher<ipc::Service, Envelope<W>, ()>,
    // Keeps the topic's settings in place while the tunnel comes and goes.
    _factory: Factory<W>,
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
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| Failure::run(format!("link \"{topic}\": cannot write to it: {e:?}")))?;
        Ok(Self { topic: topic.to_owned(), port, _factory: factory, sent: 0, dropped: 0 })
    }

    /// Hands a message to the tunnel with the stamp of this hop; never waits. With `by_wall` all stamps are those of the
    /// wall clock.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn send(&mut self, message: &W, by_wall: bool) -> Result<(), Failure> {
        let fail = |e: &dyn std::fmt::Debug| Failure::run(format!("link \"{}\": cannot send: {e:?}", self.topic));
        let mut sample = self.port.loan_uninit().map_err(|e| fail(&e))?.write_payload(Envelope(*message));
        let header = sample.payload_mut().0.header_mut();
        stamp_hop(header, self.dropped);
        if by_wall {
            shift_hops(header, wall_ahead_ns());
        }
        match sample.send().map_err(|e| fail(&e))? {
            0 => self.dropped += 1,
            _ => self.sent += 1,
        }
        Ok(())
    }
}

/// The end that the stream comes out of.
pub struct LinkReader<W: Wire> {
    topic: String,
    port: Subscriber<ipc::Service, Envelope<W>, ()>,
    _factory: Factory<W>,
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
        Ok(Self { topic: topic.to_owned(), port, _factory: factory })
    }

    /// The next message, if one is there; a copy, since it is changed before it goes on.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails.
    pub fn receive(&self) -> Result<Option<W>, Failure> {
        let sample = self.port.receive();
        let sample = sample.map_err(|e| Failure::run(format!("link \"{}\": cannot receive: {e:?}", self.topic)))?;
        Ok(sample.map(|s| s.payload().0))
    }
}
