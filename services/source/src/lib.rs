//! The source: recordings, or a live tap on a fieldbus ([`tap`]), as a stream of [`JointMeasured`].
//!
//! Pure: it reads and says when a sample is due; waiting until then is the process's business. One or more
//! recordings run one after the other under one sequence 1, 2, 3, …; memory stays constant.

pub mod steady;
pub mod tap;

use lacuna_interfaces::{BadInput, JointMeasured, Repair, RobotFile, flag};
use lacuna_recording::{ReadOptions, Reader, TimeSource};
use serde::{Deserialize, Deserializer};
use std::path::PathBuf;

/// The node's `config` table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Recording, or list of recordings, played one after the other.
    #[serde(default, deserialize_with = "one_or_many")]
    pub recording: Vec<PathBuf>,
    /// In place of a recording: network interface on which EtherCAT traffic is listened to ([`tap::Tap`]), live.
    pub interface: Option<String>,
    /// `"max"`, or a factor on recorded speed (1 = as recorded).
    #[serde(default)]
    pub rate: Rate,
    /// Skip what lies before this time after a recording's first sample [s].
    #[serde(default)]
    pub from_s: f64,
    /// Stop each recording at this time after its first sample [s].
    pub to_s: Option<f64>,
    /// Stop after this many samples in all.
    pub limit: Option<u64>,
    /// Pause between the end of one recording and the start of the next [s]; a later stamp of the next one is
    /// kept as it is.
    #[serde(default = "default_between")]
    pub between_s: f64,
    /// Joint names that the robot file must have, in this order; not checked if empty.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Topic of MCAP recordings.
    pub topic: Option<String>,
    /// Which stamp of MCAP messages counts.
    #[serde(default)]
    pub time: TimeSource,
}

fn default_between() -> f64 {
    1.0
}

fn one_or_many<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<PathBuf>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a path or a list of paths")]
    enum Paths {
        One(PathBuf),
        Many(Vec<PathBuf>),
    }
    Ok(match Paths::deserialize(d)? {
        Paths::One(path) => vec![path],
        Paths::Many(paths) => paths,
    })
}

/// How fast to play.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Rate {
    /// As fast as the graph takes it.
    #[default]
    Max,
    /// This many times the recorded speed.
    Factor(f64),
}

impl<'de> Deserialize<'de> for Rate {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        /// A number may come as text, since `--set rate=2` on a default of `"max"` stays a string.
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected \"max\" or a factor")]
        enum Value {
            Number(f64),
            Text(String),
        }
        let factor = match Value::deserialize(d)? {
            Value::Text(text) if text == "max" => return Ok(Self::Max),
            Value::Text(text) => text.parse().ok(),
            Value::Number(factor) => Some(factor),
        };
        match factor {
            Some(f) if f.is_finite() && f > 0.0 => Ok(Self::Factor(f)),
            _ => Err(serde::de::Error::custom("rate: expected \"max\" or a positive factor")),
        }
    }
}

/// Streams the recordings of a [`Config`].
#[derive(Debug)]
pub struct Source {
    config: Config,
    robot: RobotFile,
    next_file: usize,
    open: Option<OpenFile>,
    seq: u64,
    first_stamp_ns: Option<i64>,
    last_stamp_ns: i64,
    finished_repairs: Vec<Repair>,
}

#[derive(Debug)]
struct OpenFile {
    reader: Reader,
    /// Added to the file's stamps so that it follows the one before.
    shift_ns: i64,
    /// Stamp of its first sample, before the shift.
    origin_ns: Option<i64>,
    /// Whether a sample of it was handed over already.
    started: bool,
}

impl Source {
    /// Checks the configuration and opens the first recording; the others are opened in turn.
    ///
    /// # Errors
    /// [`BadInput`] for a configuration that makes no sense, a joint list that is not the robot's, or a
    /// recording that is absent or does not fit the robot.
    pub fn new(config: Config, robot: &RobotFile) -> Result<Self, BadInput> {
        check(&config, robot)?;
        let mut source = Self {
            config,
            robot: robot.clone(),
            next_file: 0,
            open: None,
            seq: 0,
            first_stamp_ns: None,
            last_stamp_ns: 0,
            finished_repairs: Vec::new(),
        };
        // A missing second file is found now, not after an hour of the first.
        for path in &source.config.recording[1..] {
            source.open_path(path)?;
        }
        source.open_next()?;
        Ok(source)
    }

    fn open_path(&self, path: &std::path::Path) -> Result<Reader, BadInput> {
        let options = ReadOptions { topic: self.config.topic.clone(), time: self.config.time, extra: false };
        lacuna_recording::open_with(path, &self.robot, &options)
    }

    fn open_next(&mut self) -> Result<bool, BadInput> {
        if let Some(done) = self.open.take() {
            self.finished_repairs.extend(done.reader.repairs());
        }
        let Some(path) = self.config.recording.get(self.next_file) else { return Ok(false) };
        let reader = self.open_path(path)?;
        self.next_file += 1;
        self.open = Some(OpenFile { reader, shift_ns: 0, origin_ns: None, started: false });
        Ok(true)
    }

    /// Overwrites `out` with the next sample (`seq` 1, 2, …; stamps increasing over all recordings; the first
    /// sample of a further recording carries `flag::GAP`). `false` at the end of the stream.
    ///
    /// # Errors
    /// [`BadInput`] with file and line.
    pub fn next_sample(&mut self, out: &mut JointMeasured) -> Result<bool, BadInput> {
        if self.config.limit.is_some_and(|limit| self.seq >= limit) {
            return Ok(false);
        }
        loop {
            let Some(open) = &mut self.open else { return Ok(false) };
            let first_file = self.next_file == 1;
            if !open.next_in_range(&self.config, out)? {
                self.open_next()?;
                continue;
            }
            if !open.started {
                open.started = true;
                if !first_file {
                    let earliest = self.last_stamp_ns + (self.config.between_s * 1e9) as i64;
                    open.shift_ns = (earliest - out.header.stamp_ns).max(0);
                    out.header.flags |= flag::GAP;
                }
            }
            out.header.stamp_ns += open.shift_ns;
            self.seq += 1;
            out.header.seq = self.seq;
            self.last_stamp_ns = out.header.stamp_ns;
            self.first_stamp_ns.get_or_insert(out.header.stamp_ns);
            return Ok(true);
        }
    }

    /// When a sample of this stamp is due, in nanoseconds after the first one; `None` if it is due at once
    /// (rate `"max"`).
    pub fn due_ns(&self, stamp_ns: i64) -> Option<u64> {
        match self.config.rate {
            Rate::Max => None,
            Rate::Factor(factor) => {
                let since = stamp_ns.saturating_sub(self.first_stamp_ns.unwrap_or(stamp_ns));
                Some((since.max(0) as f64 / factor) as u64)
            }
        }
    }

    /// Share of all recordings that has been read, each counted alike.
    pub fn fraction(&self) -> f64 {
        let before = self.next_file.saturating_sub(usize::from(self.open.is_some()));
        let current = self.open.as_ref().map_or(0.0, |o| o.reader.fraction());
        (before as f64 + current) / self.config.recording.len().max(1) as f64
    }

    /// Samples handed over so far.
    pub fn count(&self) -> u64 {
        self.seq
    }

    /// What was repaired so far, over all recordings.
    pub fn repairs(&self) -> Vec<Repair> {
        let mut all = self.finished_repairs.clone();
        if let Some(open) = &self.open {
            all.extend(open.reader.repairs());
        }
        all
    }
}

impl OpenFile {
    /// The next sample within `from_s`…`to_s`, stamps as in the file; `false` when there is none.
    fn next_in_range(&mut self, config: &Config, out: &mut JointMeasured) -> Result<bool, BadInput> {
        while let Some(sample) = self.reader.next_sample()? {
            let stamp = sample.measured.header.stamp_ns;
            let since_s = (stamp - *self.origin_ns.get_or_insert(stamp)) as f64 / 1e9;
            if config.to_s.is_some_and(|to| since_s >= to) {
                return Ok(false);
            }
            if since_s < config.from_s {
                continue;
            }
            *out = sample.measured;
            return Ok(true);
        }
        Ok(false)
    }
}

fn check(config: &Config, robot: &RobotFile) -> Result<(), BadInput> {
    let bad = |what: String| Err(BadInput::new(what));
    if let (Some(interface), false) = (&config.interface, config.recording.is_empty()) {
        return bad(format!("found both recording and interface {interface}; expected one of them"));
    }
    if config.recording.is_empty() || config.recording.iter().any(|p| p.as_os_str().is_empty()) {
        return bad("recording: found no path; expected one or a list of paths, or an interface".to_owned());
    }
    if !(config.from_s.is_finite() && config.from_s >= 0.0) {
        return bad(format!("from_s: found {}; expected zero or a positive number", config.from_s));
    }
    if let Some(to) = config.to_s
        && !(to.is_finite() && to > config.from_s)
    {
        return bad(format!("to_s: found {to}; expected a number above from_s = {}", config.from_s));
    }
    if !(config.between_s.is_finite() && config.between_s > 0.0 && config.between_s < 1e6) {
        return bad(format!("between_s: found {}; expected a positive number below 1e6", config.between_s));
    }
    if !config.joints.is_empty() && config.joints != robot.joints {
        return bad(format!(
            "joints: found {}; expected {}, as in the robot file",
            config.joints.join(", "),
            robot.joints.join(", ")
        ));
    }
    Ok(())
}
