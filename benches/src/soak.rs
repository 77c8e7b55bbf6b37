//! A live graph over a long time: memory and open files of every process, and the counts at the end.

use crate::balance::{self, Edge};
use crate::chain::remaining;
use crate::faults::kill;
use crate::{BenchError, beside, launch_file, motion};
use lacuna_interfaces::graph::GraphFile;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Length of the recording that is played again and again [s].
const LOOP_S: f64 = 20.0;
/// Shorter runs say nothing about memory.
const SETTLED_S: f64 = 120.0;

/// One process.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Process {
    /// Node, or `supervisor`.
    pub node: String,
    /// Resident memory, median of the second tenth and of the last tenth of the run [MiB].
    pub rss_mib: [f64; 2],
    /// Open files, largest in the second tenth and in the last tenth.
    pub files: [usize; 2],
}

/// Result of a soak.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Soak {
    /// Sample rate [Hz].
    pub rate_hz: f64,
    /// Length [s].
    pub seconds: f64,
    /// Samples published by the source.
    pub samples: u64,
    /// Restarts: 0 is what is asked for.
    pub restarts: u64,
    /// Processes.
    pub processes: Vec<Process>,
    /// Counts per topic.
    pub edges: Vec<Edge>,
    /// Everything that was not as it should be.
    pub problems: Vec<String>,
}

/// Runs the live graph at `rate_hz` for about `seconds`.
///
/// # Errors
/// If the run fails.
pub fn run(launch: &Path, rate_hz: f64, seconds: f64, progress: &mut dyn FnMut(&str)) -> Result<Soak, BenchError> {
    let live = launch_file(&launch.join("live.toml"))?;
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name).display().to_string();
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    let each = LOOP_S.min(seconds);
    motion::write_csv(Path::new(&file("run.csv")), (rate_hz * each) as u64, rate_hz)?;
    let turns = (seconds / each).ceil() as usize;
    let text = graph_text(&live, &file("run.csv"), turns, rate_hz)?;
    std::fs::write(file("graph.toml"), text)?;
    let child = Command::new(beside("lacuna")?)
        .arg("up")
        .arg(file("graph.toml"))
        .arg("--json")
        .args(["--set", "recording=-", "--set", &format!("robot={}", file("robot.toml"))])
        .args(["--set", &format!("model={}", file("model.toml"))])
        .args(["--set", &format!("out={}", file("run.mcap"))])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()?;
    let seen = watch(child, progress, seconds)?;
    let report: Value = serde_json::from_slice(&seen.report)?;
    let graph = GraphFile::parse(&std::fs::read_to_string(file("graph.toml"))?)?;
    let edges = balance::edges(&graph, &report);
    let mut problems = balance::disagreements(&edges);
    let processes: Vec<Process> = seen.samples.into_iter().map(|(node, list)| summary(node, &list)).collect();
    for p in &processes {
        let [early, late] = p.rss_mib;
        // An allocator settles within a few per cent; a leak at this rate does not stop there. In the first minutes
        // the buffers of the recorder are touched one by one.
        if seconds >= SETTLED_S && late > early * 1.05 + 1.0 {
            problems.push(format!("{}: memory grew from {early:.1} to {late:.1} MiB", p.node));
        }
        if p.files[1] > p.files[0] {
            problems.push(format!("{}: open files grew from {} to {}", p.node, p.files[0], p.files[1]));
        }
    }
    let left = report["run"].as_str().map_or(1, remaining);
    if left > 0 {
        problems.push(format!("{left} files were left in /dev/shm"));
    }
    let restarts = report["restarts"].as_u64().unwrap_or(0);
    if restarts > 0 {
        problems.push(format!("{restarts} restarts"));
    }
    let samples = report["samples"].as_u64().unwrap_or(0);
    let seconds = report["seconds"].as_f64().unwrap_or(0.0);
    Ok(Soak { rate_hz, seconds, samples, restarts, processes, edges, problems })
}

/// The live graph with its recording played `turns` times.
fn graph_text(text: &str, csv: &str, turns: usize, rate_hz: f64) -> Result<String, BenchError> {
    let mut table: toml::Table = toml::from_str(text)?;
    let nodes = table.get_mut("node").and_then(toml::Value::as_array_mut).ok_or("the graph has no nodes")?;
    let source = nodes.first_mut().and_then(|n| n.get_mut("config")).and_then(toml::Value::as_table_mut);
    let config = source.ok_or("the source has no configuration")?;
    let list = vec![toml::Value::String(csv.to_owned()); turns];
    config.insert("recording".to_owned(), toml::Value::Array(list));
    config.insert("between_s".to_owned(), toml::Value::Float(1.0 / rate_hz));
    Ok(toml::to_string(&table)?)
}

type Samples = Vec<(f64, usize)>;

struct Seen {
    report: Vec<u8>,
    samples: BTreeMap<String, Samples>,
}

fn watch(mut child: std::process::Child, progress: &mut dyn FnMut(&str), seconds: f64) -> Result<Seen, BenchError> {
    let mut samples: BTreeMap<String, Samples> = BTreeMap::new();
    let started = Instant::now();
    let every = Duration::from_secs_f64((seconds / 600.0).clamp(0.1, 5.0));
    let supervisor = child.id();
    while child.try_wait()?.is_none() {
        let mut all = kill::processes(supervisor);
        all.push((supervisor, "supervisor".to_owned()));
        for (pid, node) in all {
            if let Some(sample) = look(pid) {
                samples.entry(node).or_default().push(sample);
            }
        }
        progress(&format!("{:.0} of {seconds:.0} s", started.elapsed().as_secs_f64()));
        std::thread::sleep(every);
    }
    let out = child.wait_with_output()?;
    if !matches!(out.status.code(), Some(0 | 3)) {
        return Err(format!("the run ended with {}", out.status).into());
    }
    Ok(Seen { report: out.stdout, samples })
}

/// Resident memory without what is shared [MiB] and open files of a process.
fn look(pid: u32) -> Option<(f64, usize)> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let kib = |key: &str| -> Option<f64> {
        status.lines().find_map(|l| l.strip_prefix(key))?.split_whitespace().next()?.parse().ok()
    };
    let files = std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count();
    Some(((kib("RssAnon:")? + kib("RssShmem:")?) / 1024.0, files))
}

fn summary(node: String, list: &[(f64, usize)]) -> Process {
    let n = list.len();
    let part = |from: usize, to: usize| {
        let part = &list[from.min(n)..to.min(n)];
        let files = part.iter().map(|s| s.1).max().unwrap_or(0);
        (crate::median(&mut part.iter().map(|s| s.0).collect::<Vec<_>>()), files)
    };
    // The first tenth is starting up, the very last look may be a process on its way out.
    let (early, late) = (part(n / 10, n / 5 + 1), part(n - n / 10 - 1, n.saturating_sub(1).max(1)));
    Process { node, rss_mib: [early.0, late.0], files: [early.1, late.1] }
}
