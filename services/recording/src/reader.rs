//! Opening a recording and reading it, sample by sample or whole.

use crate::condition::{Conditioner, Verdict};
use crate::files::open_error;
use crate::formats::{self, Request};
use crate::sample::{About, RawReader, Sample};
use lacuna_interfaces::{BadInput, Recording, Repair, RobotFile};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Stamps from here on [s] are taken for times since 1970, and [`read_all`] counts from the first sample: as
/// an f64, seconds since 1970 resolve only 0.24 µs.
pub const EPOCH_FROM_S: f64 = 1e8;

/// Most numbers [`read_all`] holds in memory (4 GB of f64).
pub const MAX_VALUES: usize = 500_000_000;

/// Which stamp of a bag's message is the measurement time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeSource {
    /// The header stamp; the log time if the first message's header stamp is 0 and its log time is not.
    #[default]
    Auto,
    /// The header stamp.
    Header,
    /// The time at which the bag's recorder wrote the message.
    Log,
}

/// What a user may choose about reading.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Topic of an MCAP file; otherwise its only JointState topic, else `/measured`, else `/joint_states`.
    pub topic: Option<String>,
    /// Which stamp counts.
    pub time: TimeSource,
    /// Whether further columns are read into [`Sample::extra`].
    pub extra: bool,
}

/// A recording being read, in constant memory.
pub struct Reader {
    raw: Box<dyn RawReader>,
    conditioner: Conditioner,
    sample: Sample,
    path: PathBuf,
    bytes: u64,
    seq: u64,
    failed: Option<BadInput>,
}

impl std::fmt::Debug for Reader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reader").field("path", &self.path).field("about", self.about()).finish_non_exhaustive()
    }
}

/// Opens a recording for reading in constant memory, with the default options.
///
/// # Errors
/// See [`open_with`].
pub fn open(path: impl AsRef<Path>, robot: &RobotFile) -> Result<Reader, BadInput> {
    open_with(path, robot, &ReadOptions::default())
}

/// Opens a recording: a CSV or MCAP file, or a ROS 2 bag folder with one MCAP file.
///
/// # Errors
/// [`BadInput`] with file (and line): absent, of no known format, or without the robot's joints.
pub fn open_with(path: impl AsRef<Path>, robot: &RobotFile, options: &ReadOptions) -> Result<Reader, BadInput> {
    let path = file_of(path.as_ref())?;
    let mut first = [0; formats::SNIFF_BYTES];
    let mut file = File::open(&path).map_err(|e| open_error(&path, &e))?;
    let len = read_up_to(&mut file, &mut first).map_err(|e| open_error(&path, &e))?;
    let format = formats::detect(&path, &first[..len])?;
    let raw = (format.open)(&Request { path: &path, robot, options }).map_err(|e| e.in_file(&path))?;
    let mut sample = Sample::default();
    sample.measured.header.joints = robot.joint_count() as u32;
    let bytes = file.metadata().map_or(0, |m| m.len());
    Ok(Reader { raw, conditioner: Conditioner::new(robot), sample, path, bytes, seq: 0, failed: None })
}

/// The file itself, or the only MCAP file of a bag folder.
///
/// # Errors
/// [`BadInput`] for a folder with none or several.
pub fn file_of(path: &Path) -> Result<PathBuf, BadInput> {
    if !path.is_dir() {
        return Ok(path.to_path_buf());
    }
    let entries = std::fs::read_dir(path).map_err(|e| open_error(path, &e))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    files.retain(|p| p.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap")));
    match files.len() {
        1 => Ok(files.swap_remove(0)),
        n => Err(BadInput::new(format!("found a folder with {n} .mcap files; expected a file, or a folder with one"))
            .in_file(path)),
    }
}

/// True if the recording is an MCAP file, or a bag folder with one.
///
/// # Errors
/// [`BadInput`] if it is absent or of no known format.
pub fn is_mcap(path: impl AsRef<Path>) -> Result<bool, BadInput> {
    let path = file_of(path.as_ref())?;
    let mut first = [0; formats::SNIFF_BYTES];
    let mut file = File::open(&path).map_err(|e| open_error(&path, &e))?;
    let len = read_up_to(&mut file, &mut first).map_err(|e| open_error(&path, &e))?;
    Ok(formats::detect(&path, &first[..len])?.name == "mcap")
}

fn read_up_to(file: &mut File, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut len = 0;
    while len < buffer.len() {
        match file.read(&mut buffer[len..]) {
            Ok(0) => break,
            Ok(n) => len += n,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(len)
}

impl Reader {
    /// What is in the recording.
    pub fn about(&self) -> &About {
        self.raw.about()
    }

    /// Share of the file that has been read, 0 to 1.
    pub fn fraction(&self) -> f64 {
        if self.bytes == 0 { 1.0 } else { (self.raw.bytes_read() as f64 / self.bytes as f64).min(1.0) }
    }

    /// The file that is read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next sample, `None` at the end. Sequence numbers count from 1; flags are those of the judgement in
    /// [`crate::condition`]. After an error every further call returns the same error.
    ///
    /// # Errors
    /// [`BadInput`] with file and line (or message), if what follows cannot be used; also if the recording
    /// ends without a sample.
    pub fn next_sample(&mut self) -> Result<Option<&Sample>, BadInput> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        match self.advance() {
            Ok(true) => Ok(Some(&self.sample)),
            Ok(false) => Ok(None),
            Err(error) => {
                let error = error.in_file(&self.path);
                self.failed = Some(error.clone());
                Err(error)
            }
        }
    }

    fn advance(&mut self) -> Result<bool, BadInput> {
        loop {
            self.sample.measured.header.flags = 0;
            if !self.raw.next_sample(&mut self.sample)? {
                if self.conditioner.kept() == 0 {
                    return Err(BadInput::new("found no sample; expected at least one"));
                }
                return Ok(false);
            }
            let verdict = self.conditioner.judge(&mut self.sample.measured);
            if verdict.map_err(|e| self.raw.locate(e))? == Verdict::Keep {
                self.seq += 1;
                self.sample.measured.header.seq = self.seq;
                return Ok(true);
            }
        }
    }

    /// What was repaired so far; only what occurred.
    pub fn repairs(&self) -> Vec<Repair> {
        let mut all = self.conditioner.repairs();
        all.extend(self.raw.repairs());
        let file = file_name(&self.path);
        for repair in &mut all {
            repair.file.clone_from(&file);
        }
        all
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Reads a whole recording into memory, further columns included. Times from [`EPOCH_FROM_S`] on are counted
/// from the first sample.
///
/// # Errors
/// [`BadInput`] with file and line; also for a recording larger than [`MAX_VALUES`].
pub fn read_all(path: impl AsRef<Path>, robot: &RobotFile) -> Result<Recording, BadInput> {
    read_all_with(path, robot, &ReadOptions::default())
}

/// [`read_all`] with options; further columns are read in any case.
///
/// # Errors
/// As [`read_all`].
pub fn read_all_with(path: impl AsRef<Path>, robot: &RobotFile, options: &ReadOptions) -> Result<Recording, BadInput> {
    let mut reader = open_with(path, robot, &ReadOptions { extra: true, ..options.clone() })?;
    let n = robot.joint_count();
    let names = reader.about().extra_names.clone();
    let width = 1 + 2 * n + names.len();
    let mut stamps_ns: Vec<i64> = Vec::new();
    let mut q_rad = vec![Vec::new(); n];
    let mut tau_nm = vec![Vec::new(); n];
    let mut extra = vec![Vec::new(); names.len()];
    while let Some(sample) = reader.next_sample()? {
        if stamps_ns.len().saturating_mul(width) >= MAX_VALUES {
            let most = MAX_VALUES / width;
            return Err(BadInput::new(format!(
                "found more than {most} samples; expected fewer, or a streaming command"
            ))
            .in_file(&reader.path));
        }
        stamps_ns.push(sample.measured.header.stamp_ns);
        for j in 0..n {
            q_rad[j].push(sample.measured.q_rad[j]);
            tau_nm[j].push(sample.measured.tau_nm[j]);
        }
        for (column, value) in extra.iter_mut().zip(&sample.extra) {
            column.push(*value);
        }
    }
    let first = stamps_ns.first().copied().unwrap_or(0);
    let origin = if first as f64 >= EPOCH_FROM_S * 1e9 { first } else { 0 };
    Ok(Recording {
        name: file_name(&reader.path),
        joints: robot.joints.clone(),
        // Dividing (not multiplying by 1e-9) gives back the decimal that the file holds.
        t_s: stamps_ns.iter().map(|ns| (ns - origin) as f64 / 1e9).collect(),
        q_rad,
        tau_nm,
        extra: names.into_iter().zip(extra).collect::<BTreeMap<_, _>>(),
        repairs: reader.repairs(),
    })
}
