//! Writing an MCAP file so that a crash costs at most the last flush interval.
//!
//! The caller appends messages to a chunk in memory; full chunks go through a bounded queue to a thread that
//! compresses and writes each with one `write` call and never seeks. If a chunk does not fill within the
//! flush interval the thread takes it as it is. So at any moment the file is a sequence of whole records, and
//! only the end mark and the index are missing; these are written by [`Writer::finish`].

use super::chunk::{Chunk, Compression, MessageAt, Packer};
use super::format::{
    AttachmentFields, ChannelRecord, Fields, attachment_content, put_channel, put_header, put_map, put_record,
    put_schema, put_str,
};
use super::summary::{self, Totals};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError};
use lacuna_interfaces::BadInput;
use mcap::records::op;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

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

/// Work for the thread.
enum Job {
    Chunk(Chunk),
    /// Schema and channel records, to be repeated in the summary.
    Declare {
        schema: Option<Vec<u8>>,
        channel: Vec<u8>,
    },
    /// Content of an attachment record.
    Attach(Vec<u8>),
    /// Content of a metadata record.
    Metadata(Vec<u8>),
    Finish,
}

/// What caller and thread share: the chunk being filled and the way out for it.
struct Front {
    chunk: Chunk,
    jobs: Sender<Job>,
    empty: Receiver<Chunk>,
    chunk_bytes: usize,
    when_full: WhenFull,
    dropped: u64,
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

fn lock(front: &Mutex<Front>) -> MutexGuard<'_, Front> {
    // Nothing between lock and unlock leaves the chunk half-changed except a panic in the caller's filler;
    // even then a chunk of whole records before it is worth writing.
    front.lock().unwrap_or_else(PoisonError::into_inner)
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
        let packer = Packer::new(options.compression, options.level).map_err(|e| io("compressed", e))?;
        let queue = options.queue_chunks.clamp(1, 4096);
        // One chunk is being filled, `queue` wait or are being written: the pool is what bounds the queue, and the
        // job channel holds all of them and a few declarations besides.
        let (jobs, job_queue) = crossbeam_channel::bounded(queue + 8);
        let (give_back, empty) = crossbeam_channel::bounded(queue + 1);
        for _ in 0..queue {
            let _ = give_back.try_send(Chunk::with_capacity(options.chunk_bytes + (64 << 10), 16));
        }
        let front = Arc::new(Mutex::new(Front {
            chunk: Chunk::with_capacity(options.chunk_bytes + (64 << 10), 16),
            jobs,
            empty,
            chunk_bytes: options.chunk_bytes.max(1),
            when_full: options.when_full,
            dropped: 0,
        }));
        let readable = File::open(&path).map_err(|e| io("read back", e))?;
        let mut back = Back {
            path: path.clone(),
            file,
            readable,
            at: 0,
            crc: crc32fast::Hasher::new(),
            out: Vec::new(),
            packer,
            totals: Totals::default(),
            sync: options.sync,
            synced: Instant::now(),
            synced_to: 0,
            give_back,
        };
        put_header(&mut back.out, profile);
        back.write_out()?;
        let shared = Arc::clone(&front);
        let flush = options.flush.max(Duration::from_millis(1));
        let thread = std::thread::Builder::new()
            .name("mcap-writer".to_owned())
            .spawn(move || back.run(&job_queue, &shared, flush))
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
        MessageBatch { front: lock(&self.front), failed: false }
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
    options.write(true);
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
}

impl std::fmt::Debug for Front {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Front").field("chunk_bytes", &self.chunk.records.len()).finish_non_exhaustive()
    }
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
                front.dropped += 1;
                false
            }
        }
    }

    /// Ends the batch; `false` if the writing thread is gone ([`Writer::failure`] says why).
    #[must_use]
    pub fn end(self) -> bool {
        !self.failed
    }
}

/// The thread's side.
struct Back {
    path: PathBuf,
    file: File,
    /// For reading the chunk headers back at the end.
    readable: File,
    at: u64,
    crc: crc32fast::Hasher,
    out: Vec<u8>,
    packer: Packer,
    totals: Totals,
    sync: Option<Duration>,
    synced: Instant,
    synced_to: u64,
    give_back: Sender<Chunk>,
}

impl Back {
    fn run(mut self, jobs: &Receiver<Job>, front: &Mutex<Front>, flush: Duration) -> Result<Finished, WriteError> {
        let mut due = Instant::now() + flush;
        loop {
            match jobs.recv_deadline(due) {
                Ok(Job::Finish) => return self.finish(),
                Ok(job) => self.work(job)?,
                Err(RecvTimeoutError::Disconnected) => return self.abandon(),
                Err(RecvTimeoutError::Timeout) => {
                    // If the caller holds the lock it is writing; then it is its turn, and this one comes back.
                    let Ok(mut front) = front.try_lock() else {
                        due = Instant::now() + Duration::from_millis(1);
                        continue;
                    };
                    // Chunks sent before come first.
                    while let Ok(job) = jobs.try_recv() {
                        if matches!(job, Job::Finish) {
                            return self.finish();
                        }
                        self.work(job)?;
                    }
                    if front.chunk.messages > 0 {
                        self.chunk(&front.chunk)?;
                        front.chunk.clear();
                    }
                    drop(front);
                    self.sync_if_due()?;
                }
            }
            due = Instant::now() + flush;
        }
    }

    fn work(&mut self, job: Job) -> Result<(), WriteError> {
        match job {
            Job::Chunk(mut chunk) => {
                self.chunk(&chunk)?;
                chunk.clear();
                // Nobody takes it back only when the writer is being dropped.
                let _ = self.give_back.try_send(chunk);
            }
            Job::Declare { schema, channel } => {
                for (record, kept) in [(schema, &mut self.totals.schemas), (Some(channel), &mut self.totals.channels)] {
                    if let Some(record) = record {
                        self.out.extend_from_slice(&record);
                        kept.push(record);
                    }
                }
                self.write_out()?;
            }
            Job::Attach(content) => {
                put_record(&mut self.out, op::ATTACHMENT, |o| o.extend_from_slice(&content));
                if let Some(fields) = AttachmentFields::parse(&content) {
                    self.totals.attachments.push(summary::attachment_index(self.at, self.out.len(), &fields));
                }
                self.write_out()?;
            }
            Job::Metadata(content) => {
                put_record(&mut self.out, op::METADATA, |o| o.extend_from_slice(&content));
                let name = Fields::new(&content).text().unwrap_or_default();
                self.totals.metadata.push(summary::metadata_index(self.at, self.out.len(), &name));
                self.write_out()?;
            }
            Job::Finish => {}
        }
        Ok(())
    }

    fn chunk(&mut self, chunk: &Chunk) -> Result<(), WriteError> {
        self.packer.append(chunk, &mut self.out).map_err(|e| self.io("compressed", e))?;
        self.totals.count(chunk, self.at);
        self.write_out()?;
        self.sync_if_due()
    }

    fn sync_if_due(&mut self) -> Result<(), WriteError> {
        if self.at > self.synced_to && self.sync.is_some_and(|every| self.synced.elapsed() >= every) {
            self.file.sync_data().map_err(|e| self.io("synced", e))?;
            self.synced = Instant::now();
            self.synced_to = self.at;
        }
        Ok(())
    }

    /// One `write` call for all that was gathered.
    fn write_out(&mut self) -> Result<(), WriteError> {
        self.file.write_all(&self.out).map_err(|e| self.io("written", e))?;
        self.crc.update(&self.out);
        self.at += self.out.len() as u64;
        self.out.clear();
        Ok(())
    }

    fn finish(self) -> Result<Finished, WriteError> {
        let crc = self.crc.clone().finalize();
        let written = summary::write(&self.file, &self.readable, self.at, crc, &self.totals);
        let bytes = written.map_err(|e| self.io("completed", e))?;
        if self.sync.is_some() {
            self.file.sync_all().map_err(|e| self.io("synced", e))?;
        }
        let messages = self.totals.messages.iter().map(|(&c, &n)| (ChannelId(c), n)).collect();
        Ok(Finished { messages, dropped: 0, times: self.totals.times, bytes })
    }

    fn abandon(mut self) -> Result<Finished, WriteError> {
        self.write_out()?;
        Ok(Finished::default())
    }

    fn io(&self, action: &'static str, source: io::Error) -> WriteError {
        WriteError::Io { path: self.path.clone(), action, source }
    }
}
