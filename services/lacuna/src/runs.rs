//! Runs of this user: where they live, what state they are in, how to stop them and read their logs.

use crate::{CommandResult, words};
use clap::Args;
use lacuna_stage::{Failure, HopLatency, RunDir};
use rustix::process::{Pid, Signal, getuid, kill_process, test_kill_process};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Finished runs that are kept for `lacuna logs`.
const KEEP: usize = 20;
const STATUS: &str = "status.json";
const STOP_TIMEOUT: Duration = Duration::from_secs(60);

/// State of a run or of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Not ready yet.
    Starting,
    /// Ready or streaming.
    Running,
    /// Ended as it should.
    Done,
    /// Ended otherwise.
    Failed,
}

impl State {
    /// As a user reads it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// A node as `lacuna status` shows it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NodeStatus {
    /// Node name.
    pub name: String,
    /// Process id, 0 before it was started.
    pub pid: u32,
    /// State.
    pub state: State,
    /// Restarts so far.
    pub restarts: u32,
    /// Samples handled, as last reported.
    pub samples: u64,
    /// Samples per second over the last half second or so.
    #[serde(default)]
    pub rate_hz: f64,
    /// Deliveries that a reader could not take.
    #[serde(default)]
    pub dropped: u64,
    /// Samples missing in what it reads.
    #[serde(default)]
    pub missing: u64,
    /// All flags of the last five seconds or so.
    #[serde(default)]
    pub flags: u32,
    /// Latencies of the last half second or so (live).
    #[serde(default)]
    pub latency: Vec<HopLatency>,
    /// Why its last process died, if one did.
    #[serde(default)]
    pub fault: Option<String>,
}

/// `status.json` of a run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunStatus {
    /// Run name.
    pub run: String,
    /// Graph file as given.
    pub graph: String,
    /// Process id of the supervisor.
    pub pid: u32,
    /// State.
    pub state: State,
    /// One line, if it failed.
    pub reason: Option<String>,
    /// Start, seconds since the epoch.
    pub started_s: u64,
    /// Nodes.
    pub nodes: Vec<NodeStatus>,
}

impl RunStatus {
    /// Writes the file in one step, so that a reader never sees half of it.
    pub fn write(&self, dir: &Path) {
        let tmp = dir.join("status.json.new");
        if let Ok(text) = serde_json::to_string_pretty(self)
            && std::fs::write(&tmp, text).is_ok()
        {
            let _ = std::fs::rename(&tmp, dir.join(STATUS));
        }
    }

    /// Reads the file; a run whose supervisor is gone has failed.
    pub fn read(dir: &Path) -> Option<Self> {
        let mut status: Self = serde_json::from_str(&std::fs::read_to_string(dir.join(STATUS)).ok()?).ok()?;
        if matches!(status.state, State::Starting | State::Running) && !alive(status.pid) {
            status.state = State::Failed;
            status.reason.get_or_insert_with(|| "the supervisor is gone".to_owned());
        }
        Some(status)
    }
}

fn alive(pid: u32) -> bool {
    Pid::from_raw(pid as i32).is_some_and(|p| test_kill_process(p).is_ok())
}

/// Directory of all runs of this user, made with mode 0700.
pub fn root() -> Result<PathBuf, Failure> {
    let uid = getuid().as_raw();
    let dir = PathBuf::from(format!("/tmp/lacuna-{uid}"));
    let fail = |what: &dyn std::fmt::Display| Failure::run(format!("{}: {what}", dir.display()));
    match std::fs::DirBuilder::new().mode(0o700).create(&dir) {
        Ok(()) => {}
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(fail(&format_args!("cannot create: {e}"))),
    }
    // Somebody else could have made it first, in a folder that everybody can write.
    let meta = std::fs::symlink_metadata(&dir).map_err(|e| fail(&e))?;
    if !meta.is_dir() || meta.uid() != uid || meta.mode() & 0o077 != 0 {
        return Err(fail(
            &"is not a directory that this user alone can read; expected mode 0700 and this user as owner",
        ));
    }
    Ok(dir)
}

/// Makes the directory of a new run and forgets the oldest finished ones.
pub fn create(graph_name: &str) -> Result<PathBuf, Failure> {
    let root = root()?;
    forget_old(&root);
    let now = now_s();
    let dir = root.join(format!("lacuna-{graph_name}-{}-{}", std::process::id(), now % 1_000_000));
    std::fs::DirBuilder::new()
        .mode(0o700)
        .create(&dir)
        .map_err(|e| Failure::run(format!("{}: cannot create: {e}", dir.display())))?;
    Ok(dir)
}

/// Seconds since the epoch.
pub fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// Also sweeps the bus of runs whose supervisor was killed, once their stages are gone too.
fn forget_old(root: &Path) {
    for (dir, status) in list(root) {
        let orphaned = status.state == State::Failed && !status.nodes.iter().any(|n| n.pid > 0 && alive(n.pid));
        if orphaned {
            RunDir::open(&dir).remove_domain();
        }
    }
    let mut finished: Vec<(u64, PathBuf)> = list(root)
        .into_iter()
        .filter(|(_, s)| matches!(s.state, State::Done | State::Failed))
        .map(|(dir, s)| (s.started_s, dir))
        .collect();
    finished.sort_unstable();
    for (_, dir) in finished.iter().rev().skip(KEEP) {
        let _ = std::fs::remove_dir_all(dir);
    }
}

fn list(root: &Path) -> Vec<(PathBuf, RunStatus)> {
    let Ok(entries) = std::fs::read_dir(root) else { return Vec::new() };
    let mut runs: Vec<(PathBuf, RunStatus)> =
        entries.flatten().filter_map(|e| Some((e.path(), RunStatus::read(&e.path())?))).collect();
    runs.sort_by_key(|(_, s)| s.started_s);
    runs
}

/// Which run.
#[derive(Args)]
pub struct RunArgs {
    /// Run name, or part of it; the newest run if not given.
    run: Option<String>,
}

impl RunArgs {
    /// As if the user had given `name`.
    pub fn named(name: &str) -> Self {
        Self { run: Some(name.to_owned()) }
    }
}

#[derive(Args)]
pub struct StatusArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct LogsArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Of this node only.
    #[arg(long)]
    node: Option<String>,
}

/// The newest run that `args` names.
pub fn find(args: &RunArgs) -> Result<(PathBuf, RunStatus), Failure> {
    let runs = list(&root()?);
    let wanted = args.run.as_deref().unwrap_or("");
    runs.into_iter().rfind(|(_, s)| s.run.contains(wanted)).ok_or_else(|| {
        Failure::usage(if wanted.is_empty() {
            "no run found".to_owned()
        } else {
            format!("no run with '{wanted}' in its name")
        })
    })
}

/// `lacuna down`.
pub fn down(args: &RunArgs) -> CommandResult {
    let (dir, status) = find(args)?;
    if !matches!(status.state, State::Starting | State::Running) {
        return Err(Failure::usage(format!("{}: is not running ({})", status.run, status.state.word())));
    }
    let pid =
        Pid::from_raw(status.pid as i32).ok_or_else(|| Failure::run(format!("{}: has no process id", status.run)))?;
    kill_process(pid, Signal::TERM)
        .map_err(|e| Failure::run(format!("{}: cannot signal its supervisor: {e}", status.run)))?;
    let started = Instant::now();
    while started.elapsed() < STOP_TIMEOUT {
        match RunStatus::read(&dir) {
            Some(s) if matches!(s.state, State::Starting | State::Running) => {
                std::thread::sleep(Duration::from_millis(20))
            }
            _ => {
                words::line(format_args!("{}: stopped", status.run))?;
                return Ok(ExitCode::SUCCESS);
            }
        }
    }
    Err(Failure::run(format!("{}: still running {} s after the stop request", status.run, STOP_TIMEOUT.as_secs())))
}

/// `lacuna status`.
pub fn status(args: &StatusArgs) -> CommandResult {
    let runs: Vec<RunStatus> = if args.run.run.is_some() {
        vec![find(&args.run)?.1]
    } else {
        list(&root()?).into_iter().map(|(_, s)| s).collect()
    };
    if args.json {
        words::print_json(&runs)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut out = String::new();
    // Writing to a String cannot fail.
    if runs.is_empty() {
        let _ = writeln!(out, "no runs");
    }
    for run in &runs {
        let age = now_s().saturating_sub(run.started_s);
        let _ = writeln!(
            out,
            "{}  {}  started {age} s ago  {}",
            run.run,
            run.state.word(),
            run.reason.as_deref().unwrap_or("")
        );
        if args.run.run.is_some() || matches!(run.state, State::Starting | State::Running) {
            for n in &run.nodes {
                let _ = writeln!(
                    out,
                    "  {:<12} {:<9} pid {:<8} {:>12} samples  {} restarts",
                    n.name,
                    n.state.word(),
                    n.pid,
                    n.samples,
                    n.restarts
                );
            }
        }
    }
    words::say(&out)?;
    Ok(ExitCode::SUCCESS)
}

/// `lacuna logs`.
pub fn logs(args: &LogsArgs) -> CommandResult {
    let (dir, status) = find(&args.run)?;
    let names: Vec<&str> = status.nodes.iter().map(|n| n.name.as_str()).collect();
    if let Some(node) = &args.node
        && !names.contains(&node.as_str())
    {
        return Err(Failure::usage(format!("--node {node}: the run has {}", names.join(", "))));
    }
    for name in names.iter().filter(|n| args.node.as_deref().is_none_or(|wanted| wanted == **n)) {
        let text = std::fs::read_to_string(dir.join(format!("{name}.log"))).unwrap_or_default();
        words::say(&text.lines().map(|line| format!("{name}: {line}\n")).collect::<String>())?;
    }
    Ok(ExitCode::SUCCESS)
}
