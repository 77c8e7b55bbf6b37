//! Recordings as files: CSV, manifest, truth.

use crate::log::Logged;
use crate::random::Random;
use crate::simulation::Simulation;
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Start and duration of one file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ManifestFile {
    /// File name.
    pub file: String,
    /// Time of its first sample since the cold drives were switched on [s].
    pub start_time_s: f64,
    /// Duration [s].
    pub duration_s: f64,
}

/// `manifest.json`: what a user knows of the recordings beside their columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The files in order.
    pub files: Vec<ManifestFile>,
    /// What the columns mean.
    pub note: String,
}

impl Manifest {
    /// What the columns mean.
    pub const NOTE: &'static str = "q: motor encoder over gear ratio, homed; tau: joint-side torque from the executed drive command (nominal torque constant), mean over one sample period centred on t";
}

/// Decimals in the CSV; recordings in memory are rounded alike, so that a file read back is the same recording.
const TIME_DECIMALS: u32 = 6;
const POSITION_DECIMALS: u32 = 9;
const TORQUE_DECIMALS: u32 = 5;
const TEMPERATURE_DECIMALS: u32 = 1;

/// Nearest number of `decimals` decimals, exactly as it parses back.
fn rounded(v: f64, decimals: u32) -> f64 {
    let scale = f64::from(10u32.pow(decimals));
    let r = (v * scale).round() / scale;
    // No "-0.00000" in files.
    if r == 0.0 { 0.0 } else { r }
}

/// Time constant of a drive's temperature where no effect says another [s], and its rise [K].
const WARM_UP_S: f64 = 60.0;
const WARM_UP_K: f64 = 14.0;

/// The recording of a run; with `warm_up`, the time constants per joint, temperature columns too.
pub(crate) fn recording_of(
    robot: &RobotFile,
    logged: &Logged,
    index: usize,
    warm_up: Option<&[Option<f64>]>,
    start_s: f64,
    random: &mut Random,
) -> Recording {
    let round = |columns: &[Vec<f64>], decimals| {
        columns.iter().map(|c| c.iter().map(|&v| rounded(v, decimals)).collect()).collect()
    };
    let mut extra = BTreeMap::new();
    for (i, time_constant) in warm_up.unwrap_or_default().iter().enumerate() {
        let tau = time_constant.unwrap_or(WARM_UP_S);
        let rise = WARM_UP_K * random.uniform(0.8, 1.2);
        let mut at = |t: &f64| {
            let mean = 24.0 + rise * (1.0 - (-(start_s + t) / tau).exp());
            rounded(mean + 0.15 * random.normal(), TEMPERATURE_DECIMALS)
        };
        extra.insert(format!("temp{}", i + 1), logged.t_s.iter().map(&mut at).collect());
    }
    Recording {
        name: format!("traj_{:02}.csv", index + 1),
        joints: robot.joints.clone(),
        t_s: logged.t_s.iter().map(|&t| rounded(t, TIME_DECIMALS)).collect(),
        q_rad: round(&logged.q_rad, POSITION_DECIMALS),
        tau_nm: round(&logged.tau_nm, TORQUE_DECIMALS),
        extra,
        repairs: Vec::new(),
    }
}

/// The commanded positions by column name.
pub(crate) fn reference_columns(logged: &Logged) -> impl Iterator<Item = (String, Vec<f64>)> + '_ {
    let of = |(i, q): (usize, &Vec<f64>)| {
        (format!("qref{}", i + 1), q.iter().map(|&v| rounded(v, POSITION_DECIMALS)).collect())
    };
    logged.reference_rad.iter().enumerate().map(of)
}

/// Writes a recording as CSV: `t,q1…,tau1…` and the further columns by name. Numbers are written with the
/// fewest digits that read back as the same value.
///
/// # Errors
/// What the writer returns.
pub fn write_csv(recording: &Recording, out: &mut impl Write) -> std::io::Result<()> {
    let n = recording.q_rad.len();
    let mut line = String::from("t");
    (1..=n).for_each(|i| line.push_str(&format!(",q{i}")));
    (1..=n).for_each(|i| line.push_str(&format!(",tau{i}")));
    recording.extra.keys().for_each(|k| {
        line.push(',');
        line.push_str(k);
    });
    line.push('\n');
    out.write_all(line.as_bytes())?;
    for k in 0..recording.len() {
        line.clear();
        let columns = recording.q_rad.iter().chain(&recording.tau_nm).chain(recording.extra.values());
        push_number(&mut line, recording.t_s.get(k));
        for column in columns {
            line.push(',');
            push_number(&mut line, column.get(k));
        }
        line.push('\n');
        out.write_all(line.as_bytes())?;
    }
    Ok(())
}

/// The text of a robot file that reads back as the same robot.
///
/// # Errors
/// [`BadInput`] if it does not.
pub fn robot_toml(robot: &RobotFile) -> Result<String, BadInput> {
    let text =
        toml::to_string(robot).map_err(|e| BadInput::new(format!("robot file cannot be written as TOML: {e}")))?;
    match RobotFile::parse(&text) {
        Ok(same) if same == *robot => Ok(text),
        Ok(_) => Err(BadInput::new("robot file: what was written does not read back as the same robot")),
        Err(e) => Err(BadInput::new(format!("robot file: what was written does not read back: {e}"))),
    }
}

fn push_number(line: &mut String, value: Option<&f64>) {
    use std::fmt::Write as _;
    if let Some(v) = value {
        // Writing to a String cannot fail.
        let _ = write!(line, "{v}");
    }
}

impl Simulation {
    /// Writes the recordings and `manifest.json` into `folder` (made if absent). The truth is not written:
    /// it is the caller's to seal ([`crate::Truth::to_json`]).
    ///
    /// # Errors
    /// The operating system's, in words that name the file.
    pub fn write(&self, folder: &Path) -> std::io::Result<Vec<PathBuf>> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |e: std::io::Error| {
                std::io::Error::new(e.kind(), format!("{}: cannot be written: {e}", path.display()))
            }
        };
        std::fs::create_dir_all(folder).map_err(failed(folder))?;
        let mut written = Vec::new();
        for recording in &self.recordings {
            let path = folder.join(&recording.name);
            let file = std::fs::File::create(&path).map_err(failed(&path))?;
            let mut out = std::io::BufWriter::new(file);
            write_csv(recording, &mut out).and_then(|()| out.flush()).map_err(failed(&path))?;
            written.push(path);
        }
        let path = folder.join("manifest.json");
        let text = serde_json::to_string_pretty(&self.manifest)
            .map_err(|e| std::io::Error::other(format!("manifest cannot be written as JSON: {e}")))?;
        std::fs::write(&path, text).map_err(failed(&path))?;
        written.push(path);
        Ok(written)
    }
}
