//! The thread behind a [`super::Writer`]: compresses, writes, flushes, syncs, finishes.

use super::chunk::{Chunk, Packer};
use super::format::{AttachmentFields, Fields, put_header, put_record};
use super::summary::{self, Totals};
use super::writer::{ChannelId, Finished, WhenFull, WriteError, WriterOptions};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use mcap::records::op;
use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Work for the thread.
pub(crate) enum Job {
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
pub(crate) struct Front {
    pub(crate) chunk: Chunk,
    pub(crate) jobs: Sender<Job>,
    pub(crate) empty: Receiver<Chunk>,
    pub(crate) chunk_bytes: usize,
    pub(crate) when_full: WhenFull,
    pub(crate) dropped: u64,
}

/// The thread's ends of the queues.
pub(crate) struct Pool {
    pub(crate) jobs: Receiver<Job>,
    pub(crate) give_back: Sender<Chunk>,
}

impl Front {
    /// One chunk is being filled, `queue_chunks` wait or are being written: the pool is what bounds the queue, and
    /// the job channel holds all of them and a few declarations besides.
    pub(crate) fn new(options: &WriterOptions) -> (Self, Pool) {
        let queue = options.queue_chunks.clamp(1, 4096);
        let (jobs, job_queue) = crossbeam_channel::bounded(queue + 8);
        let (give_back, empty) = crossbeam_channel::bounded(queue + 1);
        // A chunk is closed by the message that makes it full, which may be large.
        let chunk = || Chunk::with_capacity(options.chunk_bytes + (64 << 10), 16);
        for _ in 0..queue {
            let _ = give_back.try_send(chunk());
        }
        let front = Self {
            chunk: chunk(),
            jobs,
            empty,
            chunk_bytes: options.chunk_bytes.max(1),
            when_full: options.when_full,
            dropped: 0,
        };
        (front, Pool { jobs: job_queue, give_back })
    }
}

impl std::fmt::Debug for Front {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Front").field("chunk_bytes", &self.chunk.records.len()).finish_non_exhaustive()
    }
}

/// The chunk, whoever held it before.
pub(crate) fn lock(front: &Mutex<Front>) -> MutexGuard<'_, Front> {
    // Nothing between lock and unlock leaves the chunk half-changed except a panic in the caller's filler;
    // even then a chunk of whole records before it is worth writing.
    front.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread's side.
pub(crate) struct Back {
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
    /// Takes a new file (and a handle to read it back), and writes its header.
    pub(crate) fn start(
        path: PathBuf,
        (file, readable): (File, File),
        profile: &str,
        options: &WriterOptions,
        give_back: Sender<Chunk>,
    ) -> Result<Self, WriteError> {
        let packer = Packer::new(options.compression, options.level).map_err(|source| WriteError::Io {
            path: path.clone(),
            action: "compressed",
            source,
        })?;
        let mut back = Self {
            path,
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
        Ok(back)
    }

    pub(crate) fn run(
        mut self,
        jobs: &Receiver<Job>,
        front: &Mutex<Front>,
        flush: Duration,
    ) -> Result<Finished, WriteError> {
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
