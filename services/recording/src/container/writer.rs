//! Writing an MCAP file so that a crash costs at most the last flush interval.
//!
//! The caller appends messages to a chunk in memory; full chunks go through a bounded queue to a thread that
//! compresses and writes each with one `write` call and never seeks. If a chunk does not fill within the
//! flush interval the thread takes it as it is. So at any moment the file is a sequence of whole records, and
//! only the end mark and the index are missing; these are written by [`Writer::finish`].

use super::back::{Back, Front, Job, lock};
use super::chunk::{Compression, MessageAt};
use super::format::{ChannelRecord, attachment_content, put_channel, put_map, put_schema, put_str};
use crossbeam_channel::TryRecvError;
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

/// What happens when the disk is slower than the messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WhenFull {
    /// The caller waits (replay).
    #[default]
    Block,
    /// Messages are dropped and counted (live).
    Drop,
}

/// How a file is written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WriterOptions {
    /// Compression of chunks.
    pub compression: Compression,
    /// Compression level: zstd −7 to 22, lz4 0 to 16.
    pub level: i32,
    /// Size from which a chunk is closed [bytes, before compression].
    pub chunk_bytes: usize,
    /// Chunks that may wait for the disk.
    pub queue_chunks: usize,
    /// A chunk that has not filled within this time is written as it is.
    pub flush: Duration,
    /// How often the file is synced to the disk; `None` leaves that to the operating system.
    pub sync: Option<Duration>,
    /// Whether an existing file may be replaced.
    pub overwrite: bool,
    /// What happens when the disk is too slow.
    pub when_full: WhenFull,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self {
            compression: Compression::Zstd,
            level: 1,
            chunk_bytes: 256 << 10,
            queue_chunks: 8,
            flush: Duration::from_millis(500),
            sync: Some(Duration::from_secs(3)),
            overwrite: false,
            when_full: WhenFull::Block,
        }
    }
}

/// A channel to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Topic.
    pub topic: String,
    /// Schema name, empty for none.
    pub schema: String,
    /// Schema encoding (`ros2msg`).
    pub schema_encoding: String,
    /// Schema text.
    pub schema_text: Vec<u8>,
    /// Message encoding (`cdr`).
    pub encoding: String,
    /// Channel metadata.
    pub metadata: BTreeMap<String, String>,
}

/// A file inside the recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Media type (`application/toml`, …).
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

/// A channel of this writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChannelId(pub(crate) u16);

impl ChannelId {
    /// Channel `number` of a place that numbers its channels itself.
    pub fn new(number: u16) -> Self {
        Self(number)
    }

    /// Its number.
    pub fn number(self) -> u16 {
        self.0
    }
}

/// Why writing failed.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// What was asked for cannot be done.
    #[error(transparent)]
    Refused(#[from] BadInput),
    /// The operating system said no.
    #[error("{}: cannot be {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried (`created`, `written`, …).
        action: &'static str,
        /// Its reason.
        source: io::Error,
    },
    /// The writing thread ended without a reason; a defect.
    #[error("{}: the writing thread ended early", .0.display())]
    Lost(PathBuf),
}

/// What a finished file holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Finished {
    /// Messages per channel.
    pub messages: BTreeMap<ChannelId, u64>,
    /// Messages dropped because the disk was too slow.
    pub dropped: u64,
    /// First and last log time [ns].
    pub times: Option<(u64, u64)>,
    /// Size of the file [bytes].
    pub bytes: u64,
}

/// Writes one MCAP file.
pub struct Writer {
    path: PathBuf,
    front: Arc<Mutex<Front>>,
    thread: Option<JoinHandle<Result<Finished, WriteError>>>,
    schemas: Vec<(String, Vec<u8>)>,
    channels: u16,
}

impl std::fmt::Debug for Writer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Writer").field("path", &self.path).field("channels", &self.channels).finish_non_exhaustive()
    }
}

impl Writer {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// [`WriteError`]: the file exists and may not be replaced, or cannot be created.
    pub fn create(path: impl AsRef<Path>, profile: &str, options: &WriterOptions) -> Result<Self, WriteError> {
        let path = path.as_ref().to_path_buf();
        let file = create_file(&path, options.overwrite)?;
        let io = |action, source| WriteError::Io { path: path.clone(), action, source };
        let readable = File::open(&path).map_err(|e| io("read back", e))?;
        let (front, pool) = Front::new(options);
        let back = Back::start(path.clone(), (file, readable), profile, options, pool.give_back)
            // A full disk: an empty file is no recording.
            .inspect_err(|_| drop(std::fs::remove_file(&path)))?;
        let front = Arc::new(Mutex::new(front));
        let shared = Arc::clone(&front);
        let flush = options.flush.max(Duration::from_millis(1));
        let thread = std::thread::Builder::new()
            .name("mcap-writer".to_owned())
            .spawn(move || back.run(&pool.jobs, &shared, flush))
            .map_err(|e| io("written by a thread of its own", e))?;
        Ok(Self { path, front, thread: Some(thread), schemas: Vec::new(), channels: 0 })
    }

    /// Declares a channel. Channels of the same schema share its text.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed, or for more channels than a file can have.
    pub fn channel(&mut self, channel: Channel) -> Result<ChannelId, WriteError> {
        if self.channels == u16::MAX {
            return Err(BadInput::new("found more than 65535 channels; expected fewer").in_file(&self.path).into());
        }
        let known = self.schemas.iter().position(|(n, t)| *n == channel.schema && *t == channel.schema_text);
        let mut schema = None;
        let schema_id = match known {
            _ if channel.schema.is_empty() => 0,
            Some(i) => i + 1,
            None => {
                let id = self.schemas.len() + 1;
                let mut record = Vec::new();
                let encoding = &channel.schema_encoding;
                put_schema(&mut record, id as u16, &channel.schema, encoding, &channel.schema_text);
                schema = Some(record);
                self.schemas.push((channel.schema, channel.schema_text));
                id
            }
        };
        self.channels += 1;
        let mut record = Vec::new();
        let (id, schema_id) = (self.channels, schema_id as u16);
        let (topic, encoding, metadata) = (channel.topic, channel.encoding, channel.metadata);
        put_channel(&mut record, &ChannelRecord { id, schema_id, topic, encoding, metadata });
        self.send(Job::Declare { schema, channel: record })?;
        Ok(ChannelId(self.channels))
    }

    /// Attaches a file.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn attach(&mut self, attachment: &Attachment) -> Result<(), WriteError> {
        self.attach_raw(attachment_content(&attachment.name, &attachment.media_type, &attachment.data))
    }

    /// Writes an attachment record with this content.
    pub(crate) fn attach_raw(&mut self, content: Vec<u8>) -> Result<(), WriteError> {
        self.send(Job::Attach(content))
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn metadata(&mut self, name: &str, map: &BTreeMap<String, String>) -> Result<(), WriteError> {
        let mut content = Vec::new();
        put_str(&mut content, name);
        put_map(&mut content, map);
        self.metadata_raw(content)
    }

    /// Writes a metadata record with this content.
    pub(crate) fn metadata_raw(&mut self, content: Vec<u8>) -> Result<(), WriteError> {
        self.send(Job::Metadata(content))
    }

    /// Starts writing messages; those of one sample share one batch.
    pub fn batch(&self) -> MessageBatch<'_> {
        MessageBatch { front: lock(&self.front), failed: false, dropped: false }
    }

    /// Messages dropped so far because the disk was too slow.
    pub fn dropped(&self) -> u64 {
        lock(&self.front).dropped
    }

    /// Writes what is left, the index and the end mark, and syncs the file.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed now or earlier.
    pub fn finish(mut self) -> Result<Finished, WriteError> {
        let dropped = {
            let mut front = lock(&self.front);
            if front.chunk.messages > 0 {
                let last = std::mem::take(&mut front.chunk);
                let _ = front.jobs.send(Job::Chunk(last));
            }
            let _ = front.jobs.send(Job::Finish);
            front.dropped
        };
        let mut finished = self.join()?;
        finished.dropped = dropped;
        Ok(finished)
    }

    /// Why the thread ended: the error of a failed batch.
    ///
    /// # Errors
    /// Always an error, unless the thread is still there and well.
    pub fn failure(&mut self) -> WriteError {
        match self.join() {
            Err(error) => error,
            Ok(_) => WriteError::Lost(self.path.clone()),
        }
    }

    fn send(&mut self, job: Job) -> Result<(), WriteError> {
        let sent = lock(&self.front).jobs.send(job).is_ok();
        if sent { Ok(()) } else { Err(self.failure()) }
    }

    fn join(&mut self) -> Result<Finished, WriteError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            _ => Err(WriteError::Lost(self.path.clone())),
        }
    }
}

impl Drop for Writer {
    /// A writer dropped without `finish` leaves an incomplete file on purpose: everything written so far
    /// reads, nothing claims to be whole. The chunk in memory still goes out.
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            {
                let mut front = lock(&self.front);
                if front.chunk.messages > 0 {
                    let last = std::mem::take(&mut front.chunk);
                    let _ = front.jobs.send(Job::Chunk(last));
                }
                // The thread ends when nobody can send any more.
                front.jobs = crossbeam_channel::bounded(0).0;
            }
            let _ = thread.join();
        }
    }
}

fn create_file(path: &Path, overwrite: bool) -> Result<File, WriteError> {
    let mut options = OpenOptions::new();
    // A recording is its owner's, as the bus is; whoever may see it is for the owner to say.
    options.write(true).mode(0o600);
    if overwrite {
        options.create(true).truncate(true);
    } else {
        options.create_new(true);
    }
    options.open(path).map_err(|e| match e.kind() {
        io::ErrorKind::AlreadyExists => {
            BadInput::new("found an existing file; expected none, or overwrite = true").in_file(path).into()
        }
        _ => WriteError::Io { path: path.to_path_buf(), action: "created", source: e },
    })
}

/// A few messages written together.
#[derive(Debug)]
pub struct MessageBatch<'a> {
    front: MutexGuard<'a, Front>,
    failed: bool,
    dropped: bool,
}

impl MessageBatch<'_> {
    /// Appends a message whose bytes `fill` writes. Log time and publish time are `time_ns`.
    #[inline]
    pub fn message(&mut self, channel: ChannelId, sequence: u32, time_ns: u64, fill: impl FnOnce(&mut Vec<u8>)) {
        self.message_at(MessageAt { channel: channel.0, sequence, log_time: time_ns, publish_time: time_ns }, fill);
    }

    #[inline]
    pub(crate) fn message_at(&mut self, at: MessageAt, fill: impl FnOnce(&mut Vec<u8>)) {
        if self.front.chunk.records.len() >= self.front.chunk_bytes && !self.next_chunk() {
            return;
        }
        self.front.chunk.push(at, fill);
    }

    /// Sends the full chunk off and takes an empty one; `false` if the message must be dropped.
    #[cold]
    fn next_chunk(&mut self) -> bool {
        let front = &mut *self.front;
        let empty = match front.when_full {
            WhenFull::Block => front.empty.recv().map_err(|_| TryRecvError::Disconnected),
            WhenFull::Drop => front.empty.try_recv(),
        };
        match empty {
            Ok(empty) => {
                // The queue has room for every chunk there is, so this waits only behind declarations.
                let full = std::mem::replace(&mut front.chunk, empty);
                match front.jobs.send(Job::Chunk(full)) {
                    Ok(()) => true,
                    Err(_) => {
                        self.failed = true;
                        false
                    }
                }
            }
            Err(error) => {
                self.failed |= error == TryRecvError::Disconnected;
                self.dropped = true;
                front.dropped += 1;
                false
            }
        }
    }

    /// True if a message of the batch was dropped because the disk was too slow.
    pub fn is_short(&self) -> bool {
        self.dropped
    }

    /// Ends the batch; `false` if the writing thread is gone ([`Writer::failure`] says why).
    #[must_use]
    pub fn end(self) -> bool {
        !self.failed
    }
}
