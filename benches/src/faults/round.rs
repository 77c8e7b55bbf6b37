//! One run of the graph with its kills.

use super::Options;
use super::kill::{self, Kill, monotonic_ns};
use super::recorded::{self, Recorded};
use crate::{BenchError, beside};
use rand::RngExt;
use rand_pcg::Pcg64;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How long a killed node may take to have a process again before that counts as a problem.
const BACK: Duration = Duration::from_secs(5);
/// Pauses between kills [ms]: the graph is whole again in between.
const PAUSE_MS: std::ops::Range<u64> = 150..450;
/// The last part of a round is left alone, so that the graph ends by itself.
const QUIET_END_S: f64 = 1.0;

pub struct Setup<'a> {
    pub launch: &'a Path,
    /// Folder with robot, model and recording.
    pub files: &'a Path,
    /// Nodes of the graph.
    pub nodes: &'a [String],
    /// Folder of this round.
    pub folder: &'a Path,
    pub samples: u64,
    pub options: &'a Options,
}

pub struct Round {
    pub kills: Vec<Kill>,
    pub recorded: Recorded,
    pub problems: Vec<String>,
}

/// A graph that is running.
struct Graph {
    child: Child,
    kills: Vec<Kill>,
    problems: Vec<String>,
    most: usize,
}

/// Starts the graph, kills at most `most` times, waits for its end and looks at what is left.
pub fn run(setup: &Setup<'_>, most: usize, random: &mut Pcg64) -> Result<Round, BenchError> {
    let file = |name: &str| setup.files.join(name).display().to_string();
    let out = setup.folder.join("run.mcap");
    let child = Command::new(beside("lacuna")?)
        .arg("up")
        .arg(setup.launch.join("live.toml"))
        .arg("--json")
        .args(["--set", &format!("recording={}", file("run.csv"))])
        .args(["--set", &format!("robot={}", file("robot.toml"))])
        .args(["--set", &format!("model={}", file("model.toml"))])
        .args(["--set", &format!("out={}", out.display())])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let mut graph = Graph { child, kills: Vec::new(), problems: Vec::new(), most };
    let began = Instant::now();
    graph.kill_at_start(setup.nodes, random);
    if let Err(what) = graph.wait_running() {
        graph.problems.push(what);
    }
    // The stream began a moment ago; kills stop a while before its end.
    let until = began.elapsed().as_secs_f64() + setup.options.round_s - QUIET_END_S;
    while graph.kills.len() < graph.most && graph.alive() {
        std::thread::sleep(Duration::from_millis(random.random_range(PAUSE_MS)));
        if began.elapsed().as_secs_f64() > until {
            break;
        }
        graph.kill_running(setup.nodes, random);
    }
    graph.end(setup, &out)
}

impl Graph {
    fn alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    fn kill(&mut self, node: &str, pid: u32, at_start: bool, again: bool) {
        if let Some(at_ns) = kill::kill(pid) {
            self.kills.push(Kill { node: node.to_owned(), at_ns, at_start, again, whole_ms: None, flowing_ns: None });
        }
    }

    /// One process of a graph that is still starting, somewhere between its first instruction and "go".
    fn kill_at_start(&mut self, nodes: &[String], random: &mut Pcg64) {
        let node = &nodes[random.random_range(0..nodes.len())];
        let Some(pid) = kill::wait_for(self.child.id(), node, None, BACK) else { return };
        std::thread::sleep(Duration::from_micros(random.random_range(0..30_000)));
        self.kill(node, pid, true, false);
    }

    /// Waits for the supervisor's word that the stream has begun.
    fn wait_running(&mut self) -> Result<(), String> {
        let started = Instant::now();
        while started.elapsed() < Duration::from_secs(20) {
            if !self.alive() {
                return Err("the graph ended while it was starting".to_owned());
            }
            if status(self.child.id()).is_some_and(|s| s["state"] == "running") {
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        Err("the graph was not running after 20 s".to_owned())
    }

    fn kill_running(&mut self, nodes: &[String], random: &mut Pcg64) {
        let supervisor = self.child.id();
        let node = &nodes[random.random_range(0..nodes.len())];
        let Some(pid) = kill::pid_of(supervisor, node) else {
            self.problems.push(format!("{node}: had no process when it was to be killed"));
            return;
        };
        self.kill(node, pid, false, false);
        let Some(next) = kill::wait_for(supervisor, node, Some(pid), BACK) else {
            self.problems.push(format!("{node}: no new process within {} s of its kill", BACK.as_secs()));
            return;
        };
        if self.kills.len() < self.most && random.random_bool(0.2) {
            std::thread::sleep(Duration::from_micros(random.random_range(0..15_000)));
            self.kill(node, next, false, true);
            if kill::wait_for(supervisor, node, Some(next), BACK).is_none() {
                self.problems.push(format!("{node}: no new process within {} s of its second kill", BACK.as_secs()));
            }
        }
    }

    fn end(mut self, setup: &Setup<'_>, out: &Path) -> Result<Round, BenchError> {
        let supervisor = self.child.id();
        let started = Instant::now();
        let limit = Duration::from_secs_f64(setup.options.round_s + 60.0);
        let mut pids = kill::processes(supervisor);
        while self.alive() && started.elapsed() < limit {
            pids.extend(kill::processes(supervisor));
            pids.sort_unstable();
            pids.dedup();
            std::thread::sleep(Duration::from_millis(20));
        }
        if self.alive() {
            self.problems.push(format!("the graph did not end within {} s", limit.as_secs()));
            self.child.kill()?;
        }
        let name = run_name(supervisor);
        let mut problems = self.problems;
        let output = self.child.wait_with_output()?;
        let code = output.status.code();
        if !matches!(code, Some(0 | 3)) {
            let why = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            problems.push(format!("the run ended with {}: {why}", output.status));
        }
        left_behind(name.as_deref(), &pids, &mut problems);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let mut kills = self.kills;
        time_kills(setup.nodes, &mut kills, &report, &mut problems);
        let files = recordings(out)?;
        let recorded = recorded::check(setup, &files, &kills, &report, &mut problems)?;
        let lost = report["lost"].as_u64().unwrap_or(0);
        let missing = setup.samples.saturating_sub(recorded.raw);
        if code == Some(0) && (recorded.holes > 0 || missing > 0) {
            problems.push(format!(
                "exit code 0 and {lost} lost, but the recording has {} holes and lacks {missing} raw samples",
                recorded.holes
            ));
        }
        Ok(Round { kills, recorded, problems })
    }
}

/// The recording and those that went on after a restart.
fn recordings(out: &Path) -> Result<Vec<PathBuf>, BenchError> {
    let folder = out.parent().ok_or("no folder")?;
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?.flatten().map(|e| e.path()).collect();
    files.retain(|p| p.extension().is_some_and(|e| e == "mcap"));
    Ok(files)
}

/// Directory of the run that this supervisor owns.
fn run_dir(supervisor: u32) -> Option<PathBuf> {
    let root = PathBuf::from(format!("/tmp/lacuna-{}", rustix::process::getuid().as_raw()));
    let part = format!("-{supervisor}-");
    std::fs::read_dir(root).ok()?.flatten().map(|e| e.path()).find(|p| p.to_string_lossy().contains(&part))
}

pub(crate) fn run_name(supervisor: u32) -> Option<String> {
    Some(run_dir(supervisor)?.file_name()?.to_string_lossy().into_owned())
}

pub(crate) fn status(supervisor: u32) -> Option<Value> {
    serde_json::from_str(&std::fs::read_to_string(run_dir(supervisor)?.join("status.json")).ok()?).ok()
}

/// Processes and shared memory that should be gone.
fn left_behind(run: Option<&str>, pids: &[(u32, String)], problems: &mut Vec<String>) {
    let Some(run) = run else {
        problems.push("the run has no directory".to_owned());
        return;
    };
    let of_run = |pid: u32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&line).contains(run)
    };
    for (pid, node) in pids.iter().filter(|(pid, _)| of_run(*pid)) {
        problems.push(format!("{node}: process {pid} was left behind"));
    }
    for entry in std::fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(run) {
            problems.push(format!("{} was left behind", entry.path().display()));
        }
    }
}

/// Holds the kills against the faults the supervisor saw: the k-th kill of a node is its k-th fault.
fn time_kills(nodes: &[String], kills: &mut [Kill], report: &Value, problems: &mut Vec<String>) {
    let faults = report["faults"].as_array().cloned().unwrap_or_default();
    for node in nodes {
        let of_node: Vec<&Value> = faults.iter().filter(|f| f["node"] == node.as_str()).collect();
        let killed: Vec<&mut Kill> = kills.iter_mut().filter(|k| k.node == *node).collect();
        if of_node.len() != killed.len() {
            let why: Vec<&str> = of_node.iter().filter_map(|f| f["reason"].as_str()).collect();
            problems.push(format!(
                "{node}: killed {} times, seen to end {} times ({})",
                killed.len(),
                of_node.len(),
                why.join("; ")
            ));
        }
        for (kill, fault) in killed.into_iter().zip(of_node) {
            let until = if kill.at_start { &fault["ready_ns"] } else { &fault["flowing_ns"] };
            kill.whole_ms = until.as_u64().map(|ns| ns.saturating_sub(kill.at_ns) as f64 / 1e6);
            kill.flowing_ns = fault["flowing_ns"].as_u64();
            if kill.at_ns > monotonic_ns() {
                problems.push("the clock ran backwards".to_owned());
            }
        }
    }
}
