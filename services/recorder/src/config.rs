//! What the recorder is told: by the graph file, and by the run.

use crate::streams::{Stream, in_namespace};
use crate::{Attachment, Facts, WriteError};
use lacuna_interfaces::graph::split_topic;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_recording::container::{Compression, WhenFull, WriterOptions};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The node's `config` table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// File to write; with `bag`, the folder.
    pub path: PathBuf,
    /// `"zstd"`, `"lz4"` or `"none"`.
    #[serde(default)]
    pub compression: Compression,
    /// Compression level: zstd −7 to 22, lz4 0 to 16.
    #[serde(default = "default_level")]
    pub level: i32,
    /// Size of a chunk before compression [KiB].
    #[serde(default = "default_chunk_kib")]
    pub chunk_kib: u32,
    /// Chunks that may wait for the disk.
    #[serde(default = "default_queue")]
    pub queue_chunks: u32,
    /// What a crash may cost at most [s].
    #[serde(default = "default_flush")]
    pub flush_s: f64,
    /// How often the file is synced to the disk [s]; 0 leaves that to the operating system.
    #[serde(default = "default_sync")]
    pub sync_s: f64,
    /// Whether an existing file is replaced.
    #[serde(default)]
    pub overwrite: bool,
    /// Whether a ROS 2 bag folder (`metadata.yaml` beside the file) is written instead of a bare file.
    #[serde(default)]
    pub bag: bool,
}

fn default_level() -> i32 {
    1
}

fn default_chunk_kib() -> u32 {
    256
}

/// 8 MiB: at 4 kHz over a second, which a sync to a slow disk may take.
fn default_queue() -> u32 {
    32
}

fn default_flush() -> f64 {
    0.5
}

fn default_sync() -> f64 {
    3.0
}

/// Streams of a namespace: their topics stand below it, `/before/residual`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Branch {
    /// Namespace, not empty, distinct.
    pub namespace: String,
    /// Messages that will come in it.
    pub streams: Vec<Stream>,
}

/// Topics of the graph, sorted by namespace.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lanes {
    /// Messages of topics without a namespace.
    pub streams: Vec<Stream>,
    /// Messages of topics with one.
    pub branches: Vec<Branch>,
}

impl Lanes {
    /// Sorts topics of the graph, each with the name of its message.
    ///
    /// # Errors
    /// [`BadInput`] for a message that has no topics, or one that comes twice in a namespace.
    pub fn of(topics: &[(String, &str)]) -> Result<Self, BadInput> {
        let mut lanes = Self::default();
        for (topic, message) in topics {
            let stream = Stream::of_message(message).ok_or_else(|| {
                BadInput::new(format!("topic \"{topic}\": found a {message}; expected a message that can be recorded"))
            })?;
            let namespace = split_topic(topic).0;
            let lane = lanes.lane(namespace);
            if lane.contains(&stream) {
                return Err(BadInput::new(format!(
                    "topic \"{topic}\": a second topic of {message}; expected one of each in a namespace, as in \"before/{topic}\""
                )));
            }
            lane.push(stream);
        }
        Ok(lanes)
    }

    fn lane(&mut self, namespace: &str) -> &mut Vec<Stream> {
        if namespace.is_empty() {
            return &mut self.streams;
        }
        let at = self.branches.iter().position(|b| b.namespace == namespace).unwrap_or_else(|| {
            self.branches.push(Branch { namespace: namespace.to_owned(), streams: Vec::new() });
            self.branches.len() - 1
        });
        &mut self.branches[at].streams
    }

    /// Lane of a topic: 0 for those without a namespace, then the branches from 1.
    pub fn index_of(&self, topic: &str) -> usize {
        let namespace = split_topic(topic).0;
        self.branches.iter().position(|b| b.namespace == namespace).map_or(0, |i| i + 1)
    }
}

/// What the recorder is told about the run.
#[derive(Debug, Clone)]
pub struct Run<'a> {
    /// The robot.
    pub robot: &'a RobotFile,
    /// Messages that will come, those of branches aside.
    pub streams: &'a [Stream],
    /// Messages that will come in namespaces of their own.
    pub branches: &'a [Branch],
    /// `true`: an earlier recorder of this run died, and this file goes on; see [`crate::Recorder::continues`].
    pub resumed: bool,
    /// `true`: what the disk cannot take is dropped and counted; `false`: the caller waits.
    pub live: bool,
    /// Robot, model and graph files.
    pub attachments: Vec<Attachment>,
    /// Further facts for the recording's metadata (source file, run name, …).
    pub facts: Facts,
}

impl Config {
    /// Checks the values and that the file may be written, without writing anything.
    ///
    /// # Errors
    /// [`WriteError`] as [`crate::Recorder::new`] would give it.
    pub fn check(&self, live: bool) -> Result<(), WriteError> {
        self.options(live)?;
        if self.path.exists() && !self.overwrite {
            return Err(BadInput::new("found an existing file; expected none, or overwrite = true")
                .in_file(&self.path)
                .into());
        }
        match self.path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            Some(folder) if folder.exists() && !folder.is_dir() => {
                Err(BadInput::new("found a file; expected a folder").in_file(folder).into())
            }
            // A bag's folders are made; a file's are the user's to choose, before the robot moves.
            Some(folder) if !folder.exists() && !self.bag => {
                Err(BadInput::new("found no folder for it; expected one that exists").in_file(&self.path).into())
            }
            _ => Ok(()),
        }
    }

    pub(crate) fn options(&self, live: bool) -> Result<WriterOptions, WriteError> {
        let bad = |key: &str, found: String, expected: &str| {
            Err(BadInput::new(format!("{key}: found {found}; expected {expected}")).into())
        };
        if self.path.as_os_str().is_empty() {
            return bad("path", "an empty one".to_owned(), "a file to write");
        }
        let levels = match self.compression {
            Compression::Zstd => -7..=22,
            Compression::Lz4 => 0..=16,
            Compression::None => i32::MIN..=i32::MAX,
        };
        if !levels.contains(&self.level) {
            return bad("level", self.level.to_string(), &format!("{} to {}", levels.start(), levels.end()));
        }
        if !(4..=65_536).contains(&self.chunk_kib) {
            return bad("chunk_kib", self.chunk_kib.to_string(), "4 to 65536");
        }
        if !(1..=1024).contains(&self.queue_chunks) {
            return bad("queue_chunks", self.queue_chunks.to_string(), "1 to 1024");
        }
        if !(0.001..=3600.0).contains(&self.flush_s) {
            return bad("flush_s", self.flush_s.to_string(), "0.001 to 3600");
        }
        if !(0.0..=86_400.0).contains(&self.sync_s) {
            return bad("sync_s", self.sync_s.to_string(), "0 (never) to 86400");
        }
        Ok(WriterOptions {
            compression: self.compression,
            level: self.level,
            chunk_bytes: (self.chunk_kib as usize) << 10,
            queue_chunks: self.queue_chunks as usize,
            flush: Duration::from_secs_f64(self.flush_s),
            sync: (self.sync_s > 0.0).then(|| Duration::from_secs_f64(self.sync_s)),
            overwrite: self.overwrite,
            when_full: if live { WhenFull::Drop } else { WhenFull::Block },
        })
    }

    /// The file to write and, for a bag, its folder (made here) and the file's name in it.
    pub(crate) fn place(&self) -> Result<(PathBuf, Option<(PathBuf, String)>), WriteError> {
        if !self.bag {
            return Ok((self.path.clone(), None));
        }
        let io = |action, source| WriteError::Io { path: self.path.clone(), action, source };
        let metadata = self.path.join("metadata.yaml");
        if self.path.exists() && !self.overwrite {
            return Err(BadInput::new("found an existing bag folder; expected none, or overwrite = true")
                .in_file(&self.path)
                .into());
        }
        std::fs::create_dir_all(&self.path).map_err(|e| io("created", e))?;
        // A description of the recording before must not stand beside half of the new one.
        if metadata.exists() {
            std::fs::remove_file(&metadata).map_err(|e| io("emptied", e))?;
        }
        let name = name_in_bag(&self.path);
        Ok((self.path.join(&name), Some((self.path.clone(), name))))
    }

    /// The file of a recording at `path`: itself, or the one in the bag folder.
    pub fn file_at(&self, path: PathBuf) -> PathBuf {
        if self.bag { path.join(name_in_bag(&path)) } else { path }
    }
}

fn name_in_bag(folder: &Path) -> String {
    let stem = folder.file_name().map_or_else(|| "recording".into(), |n| n.to_string_lossy().into_owned());
    format!("{stem}_0.mcap")
}

impl Run<'_> {
    /// The metadata record `lacuna`.
    pub(crate) fn facts_with(&self, path: &Path) -> Facts {
        let mut facts = self.facts.clone();
        let root = self.streams.iter().map(|s| s.name().to_owned());
        let branches =
            self.branches.iter().flat_map(|b| b.streams.iter().map(|s| in_namespace(&b.namespace, s.name())));
        let streams: Vec<String> = root.chain(branches).collect();
        for (key, value) in [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("robot", self.robot.name.clone()),
            ("joints", self.robot.joints.join(",")),
            ("torque_unit", self.robot.torque_unit.symbol().to_owned()),
            ("streams", streams.join(",")),
            ("mode", if self.live { "live" } else { "replay" }.to_owned()),
            ("file", path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())),
        ] {
            facts.insert(key.to_owned(), value);
        }
        facts
    }
}
