//! The process around a stage, and the only crate that links the bus (iceoryx2).
//!
//! A stage's `main` is one call: [`run_stage`], [`run_source`], [`run_sink`] or [`run_link`]. The harness reads the
//! graph from the run directory, opens the ports, says `ready` on standard output, moves messages, passes
//! the end of the stream on and says `done` with its counts. Standard output carries one JSON object a line
//! ([`control::Event`]) for the supervisor; standard error carries the log.
//!
//! # What an edge promises
//! *Replay*: nothing is lost. A writer waits until every reader is connected before its first sample, a
//! full buffer holds the writer back, a reader fails on a hole in the sequence, and a writer leaves only
//! after its readers have taken the end-of-stream sentinel and let go.
//! *Live*: nothing waits. What a reader cannot take is dropped and counted by the writer; the reader sees
//! the hole in the sequence, counts it and flags the next sample. Beside the edge a live writer keeps a tap, for
//! observers that come and go ([`observe`]); the edge knows nothing of them.

mod any;
pub mod bus;
pub mod clock;
pub mod control;
pub mod domain;
mod latency;
mod link_loop;
pub mod observe;
mod process;
mod realtime;
mod sink_loop;
mod source_loop;
mod stage_loop;
mod sweep;
pub mod usage;

pub use any::AnyMessage;
pub use control::{Event, Gauge, HopLatency, Order, StageReport};
pub use domain::{Domain, RunDir};
pub use link_loop::{Carrier, Clocks, LinkContext, run_link};
pub use process::Failure;
pub use sink_loop::{Resumption, Sink, SinkContext, run_sink};
pub use source_loop::{Next, Source, SourceContext, run_source};
pub use stage_loop::run_stage;
pub use sweep::Sweeper;
