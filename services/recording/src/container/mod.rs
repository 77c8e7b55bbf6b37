//! MCAP files: reading them record by record, writing them crash-safe, completing cut ones.
//!
//! The record layouts are those of the MCAP specification, version 0 (<https://mcap.dev/spec>). Reading is
//! streaming and keeps within budgets whatever a file claims; writing never seeks back, keeps no index in
//! memory and hands whole chunks to a thread. The `mcap` crate's own writer was measured beside it (the bench of
//! `lacuna-recorder` does it again): it takes twice the CPU time per message, many small writes through its
//! compressor, and keeps every chunk index in memory; its linear reader can overflow on a corrupt uncompressed
//! chunk. It reads our files in the tests instead.

mod back;
mod chunk;
mod directory;
mod extent;
mod format;
mod inspect;
mod recover;
mod scan;
mod summary;
mod writer;

pub use chunk::Compression;
pub(crate) use directory::channels_of;
pub use extent::{Extent, extent};
pub(crate) use format::{ChannelRecord, SchemaRecord, metadata_of};
pub use inspect::{FileInfo, TopicInfo, inspect, leading_attachments, topics};
pub use recover::{Recovered, recover};
pub(crate) use scan::{Item, Scan};
pub use writer::{Attachment, Channel, ChannelId, Finished, MessageBatch, WhenFull, WriteError, Writer, WriterOptions};
