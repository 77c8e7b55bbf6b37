//! The reading end of a topic.

use super::{Envelope, open_topic};
use crate::domain::Domain;
use crate::process::Failure;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::{Wire, flag};

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
    /// Opens the reading end of `topic` with room for `buffer` messages ([`GraphFile::buffer_of`]).
    ///
    /// # Errors
    /// [`Failure`] if the topic carries another message, or the bus refuses.
    pub fn open(domain: &Domain, graph: &GraphFile, topic: &str, buffer: usize) -> Result<Self, Failure> {
        let port = open_topic::<W>(domain, graph, topic)?
            .subscriber_builder()
            .buffer_size(buffer)
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
                // A live writer that was started again and had nothing left to send does not know the last number.
                if end && self.mode == Mode::Live {
                    return Ok(Some(Received::End));
                }
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
