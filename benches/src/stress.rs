//! Lossless replay under stress: tiny buffers, a slow reader, readers that are stopped, starts in any order, busy
//! processors, all of it at once. Every sample arrives everywhere, or the run fails and says so.

use crate::chain::remaining;
use crate::faults::kill;
use crate::load::Hog;
use crate::{BenchError, beside, launch_file, motion};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A way to make life hard for a graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stress {
    /// Edges hold one message.
    BufferOfOne,
    /// The recorder compresses as hard as it can: the slowest reader of all.
    SlowReader,
    /// Processes are stopped (SIGSTOP) for up to half a second, again and again.
    StoppedReaders,
    /// Processes are stopped while they start and let go in any order.
    StartOrder,
    /// A busy thread for every processor.
    Hog,
    /// Edges that hold 16 messages, stops, any start order, busy processors: all at once.
    Everything,
}

/// All kinds, in the order in which they take turns.
pub const KINDS: [Stress; 6] = [
    Stress::BufferOfOne,
    Stress::SlowReader,
    Stress::StoppedReaders,
    Stress::StartOrder,
    Stress::Hog,
    Stress::Everything,
];

impl Stress {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::BufferOfOne => "buffer-of-one",
            Self::SlowReader => "slow-reader",
            Self::StoppedReaders => "stopped-readers",
            Self::StartOrder => "start-order",
            Self::Hog => "hog",
            Self::Everything => "everything",
        }
    }
}

/// One kind of stress over all its runs.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// Kind.
    pub stress: Stress,
    /// Runs.
    pub runs: u64,
    /// Samples of all runs that came through complete.
    pub samples: u64,
    /// Samples lost without the run failing: 0 is what is asked for.
    pub lost: u64,
    /// Runs that failed, each with one line.
    pub failed: Vec<String>,
    /// Median rate [samples/s].
    pub rate_per_s: f64,
}

/// Replays `samples` samples `repeats` times, the `kinds` of stress in turn.
///
/// # Errors
/// If a run could not be started.
pub fn run(
    launch: &Path,
    kinds: &[Stress],
    samples: u64,
    repeats: usize,
    seed: u64,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, BenchError> {
    let text = launch_file(&launch.join("replay.toml"))?;
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    progress("writing the recording");
    motion::write_csv(&file("run.csv"), samples, 1000.0)?;
    let mut random = Pcg64::seed_from_u64(seed);
    let new = |&stress: &Stress| Row { stress, runs: 0, samples: 0, lost: 0, failed: Vec::new(), rate_per_s: 0.0 };
    let mut rows: Vec<Row> = kinds.iter().map(new).collect();
    let mut rates = vec![Vec::new(); kinds.len()];
    for turn in 0..repeats {
        let kind = turn % kinds.len().max(1);
        let Some(row) = rows.get_mut(kind) else { break };
        progress(&format!("run {} of {repeats}: {:?}", turn + 1, row.stress));
        std::fs::write(file("graph.toml"), graph_text(&text, row.stress))?;
        row.runs += 1;
        match once(dir.path(), row.stress, samples, &mut random)? {
            Outcome::Complete { seconds } => {
                row.samples += samples;
                rates[kind].push(samples as f64 / seconds);
            }
            Outcome::Lost(n) => row.lost += n,
            Outcome::Failed(line) => row.failed.push(line),
        }
    }
    for (row, rates) in rows.iter_mut().zip(&mut rates) {
        row.rate_per_s = crate::median(rates);
    }
    Ok(rows)
}

enum Outcome {
    Complete { seconds: f64 },
    Lost(u64),
    Failed(String),
}

/// The replay graph with small buffers or a slow recorder.
fn graph_text(text: &str, stress: Stress) -> String {
    let mut text = text.to_owned();
    let buffer = match stress {
        Stress::BufferOfOne => Some(1),
        // With one message beside busy processors every sample would wait for a dozen time slices.
        Stress::Everything => Some(16),
        _ => None,
    };
    if let Some(n) = buffer {
        text = text.replacen("mode = \"replay\"\n", &format!("mode = \"replay\"\nbuffer = {n}\n"), 1);
    }
    if stress == Stress::SlowReader {
        text = text.replacen("compression = \"${compression}\" }", "compression = \"zstd\", level = 12 }", 1);
    }
    text
}

fn once(dir: &Path, stress: Stress, samples: u64, random: &mut Pcg64) -> Result<Outcome, BenchError> {
    let file = |name: &str| dir.join(name).display().to_string();
    let mut command = Command::new(beside("lacuna")?);
    command.arg("up").arg(dir.join("graph.toml")).arg("--json");
    for (key, value) in [
        ("recording", file("run.csv")),
        ("robot", file("robot.toml")),
        ("model", file("model.toml")),
        ("out", file("run.mcap")),
        ("overwrite", "true".to_owned()),
    ] {
        command.arg("--set").arg(format!("{key}={value}"));
    }
    let _hog = matches!(stress, Stress::Hog | Stress::Everything).then(Hog::everywhere);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    if matches!(stress, Stress::StartOrder | Stress::Everything) {
        disturb_start(child.id(), random);
    }
    if matches!(stress, Stress::StoppedReaders | Stress::Everything) {
        disturb(&mut child, random);
    }
    let out = child.wait_with_output()?;
    let report: Value = serde_json::from_slice(&out.stdout).unwrap_or_default();
    let came = report["nodes"]["recorder"]["received"].as_object();
    let fewest = came.and_then(|t| t.values().map(|n| n.as_u64().unwrap_or(0)).min()).unwrap_or(0);
    let written = report["nodes"]["recorder"]["details"]["messages"]["/residual"].as_u64().unwrap_or(0);
    if !out.status.success() {
        let line = String::from_utf8_lossy(&out.stderr).trim().to_owned();
        return Ok(if line.is_empty() { Outcome::Lost(samples) } else { Outcome::Failed(line) });
    }
    let left = report["run"].as_str().map_or(0, remaining);
    if left > 0 {
        return Ok(Outcome::Failed(format!("{left} files were left in /dev/shm")));
    }
    if fewest == samples && written == samples && report["lost"] == 0 {
        return Ok(Outcome::Complete { seconds: report["seconds"].as_f64().unwrap_or(f64::NAN) });
    }
    Ok(Outcome::Lost(samples.saturating_sub(fewest.min(written)).max(1)))
}

/// Stops each process as soon as it is seen and lets them go in an order of their own.
fn disturb_start(supervisor: u32, random: &mut Pcg64) {
    let mut stopped: Vec<(Instant, u32)> = Vec::new();
    let began = Instant::now();
    let mut seen = Vec::new();
    while began.elapsed() < Duration::from_millis(500) || !stopped.is_empty() {
        for (pid, _) in kill::processes(supervisor) {
            if !seen.contains(&pid) {
                seen.push(pid);
                signal(pid, Signal::STOP);
                stopped.push((Instant::now() + Duration::from_millis(random.random_range(0..300)), pid));
            }
        }
        stopped.retain(|(until, pid)| {
            let over = Instant::now() >= *until;
            if over {
                signal(*pid, Signal::CONT);
            }
            !over
        });
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Stops one process after the other until the graph ends.
fn disturb(child: &mut Child, random: &mut Pcg64) {
    while matches!(child.try_wait(), Ok(None)) {
        let nodes = kill::processes(child.id());
        if !nodes.is_empty() {
            let (pid, _) = nodes[random.random_range(0..nodes.len())];
            signal(pid, Signal::STOP);
            std::thread::sleep(Duration::from_millis(random.random_range(1..500)));
            signal(pid, Signal::CONT);
        }
        std::thread::sleep(Duration::from_millis(random.random_range(10..200)));
    }
}

fn signal(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
