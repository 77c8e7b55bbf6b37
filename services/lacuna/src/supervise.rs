//! The supervisor of a run: starts the nodes, lets the stream begin when all are ready, watches them, and
//! brings them down in order. One thread looks at everything in turn; a thread per node reads its lines.

use crate::runs::{self, NodeStatus, RunStatus, State};
use indicatif::{ProgressBar, ProgressStyle};
use lacuna_interfaces::graph::{GraphFile, Mode, Restart};
use lacuna_stage::{Domain, Event, Failure, RunDir, StageReport};
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long a node may take to end after SIGTERM, before SIGKILL.
const GRACE: Duration = Duration::from_secs(3);
/// How long the rest of the graph may take to drain after the source was stopped.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(30);
/// After the first sign of failure: time for the others to say what they saw, so that the cause can be told.
const CAUSE_WINDOW: Duration = Duration::from_millis(150);
/// How long the last lines of a process that has ended may take.
const LAST_WORDS: Duration = Duration::from_millis(500);
const TICK: Duration = Duration::from_millis(3);

/// Result of a run.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    /// Run name.
    pub run: String,
    /// Samples that entered the graph.
    pub samples: u64,
    /// Seconds from "go" to the end of the last node.
    pub seconds: f64,
    /// Samples that some node of the graph did not get.
    pub lost: u64,
    /// True if the stream was ended by a stop request.
    pub stopped: bool,
    /// Restarts of all nodes.
    pub restarts: u32,
    /// Report of each node.
    pub nodes: BTreeMap<String, StageReport>,
}

struct NodeState {
    child: Option<Child>,
    stdin: Option<ChildStdin>,
    reader: Option<JoinHandle<()>>,
    ready: bool,
    samples: u64,
    restarts: u32,
    restart_at: Option<Instant>,
    started: Instant,
    failure: Option<Failure>,
    report: Option<StageReport>,
    state: State,
}

/// Owner of a run's processes. Dropping it kills what is left and removes the domain.
pub struct Supervisor<'a> {
    graph: &'a GraphFile,
    graph_path: &'a Path,
    executables: &'a [PathBuf],
    run: RunDir,
    domain: Domain,
    nodes: Vec<NodeState>,
    lines: Receiver<(usize, Event)>,
    sender: Sender<(usize, Event)>,
    interrupted: Arc<AtomicBool>,
    bar: Option<ProgressBar>,
    status_written: Instant,
    started_s: u64,
    reason: Option<String>,
}

impl<'a> Supervisor<'a> {
    /// Makes the domain and starts every node.
    pub fn start(
        graph_path: &'a Path,
        graph: &'a GraphFile,
        executables: &'a [PathBuf],
        dir: &Path,
        show_progress: bool,
    ) -> Result<Self, Failure> {
        let run = RunDir::create(dir, graph)?;
        let domain = Domain::join(&run, "supervisor").inspect_err(|_| run.remove_domain())?;
        let interrupted = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&interrupted))
                .map_err(|e| Failure::run(format!("cannot handle signals: {e}")))?;
        }
        let (sender, lines) = channel();
        let mut supervisor = Self {
            graph,
            graph_path,
            executables,
            run,
            domain,
            nodes: Vec::new(),
            lines,
            sender,
            interrupted,
            bar: show_progress.then(progress_bar),
            status_written: Instant::now(),
            started_s: runs::now_s(),
            reason: None,
        };
        for index in 0..graph.nodes.len() {
            supervisor.nodes.push(NodeState {
                child: None,
                stdin: None,
                reader: None,
                ready: false,
                samples: 0,
                restarts: 0,
                restart_at: None,
                started: Instant::now(),
                failure: None,
                report: None,
                state: State::Starting,
            });
            supervisor.spawn(index)?;
        }
        supervisor.write_status(State::Starting);
        Ok(supervisor)
    }

    fn spawn(&mut self, index: usize) -> Result<(), Failure> {
        let node = &self.graph.nodes[index];
        let log = self.run.path().join(format!("{}.log", node.name));
        let log = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&log)
            .map_err(|e| Failure::run(format!("{}: cannot write: {e}", log.display())))?;
        let state = &mut self.nodes[index];
        let mut child = Command::new(&self.executables[index])
            .args(&node.args)
            .arg("--run")
            .arg(self.run.path())
            .args(["--node", &node.name, "--restarts", &state.restarts.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log)
            // A group of its own: Ctrl-C reaches the supervisor alone, which stops the graph in order.
            .process_group(0)
            .spawn()
            .map_err(|e| {
                Failure::usage(format!(
                    "node \"{}\": cannot start {}: {e}",
                    node.name,
                    self.executables[index].display()
                ))
            })?;
        state.stdin = child.stdin.take();
        state.started = Instant::now();
        state.ready = false;
        state.state = State::Starting;
        if let Some(stdout) = child.stdout.take() {
            let sender = self.sender.clone();
            state.reader = Some(std::thread::spawn(move || {
                for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                    // Lines that are no events (a library's own print) are not the supervisor's business.
                    if let Ok(event) = serde_json::from_str::<Event>(&line)
                        && sender.send((index, event)).is_err()
                    {
                        break;
                    }
                }
            }));
        }
        state.child = Some(child);
        Ok(())
    }

    /// Runs the graph to its end.
    pub fn run(mut self) -> Result<RunReport, Failure> {
        let result = self.stream();
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        self.terminate_all();
        self.reason = result.as_ref().err().map(ToString::to_string);
        for node in &mut self.nodes {
            if node.state != State::Done {
                node.state = State::Failed;
            }
        }
        self.write_status(if result.is_ok() { State::Done } else { State::Failed });
        if let Ok(report) = &result
            && let Ok(text) = serde_json::to_string_pretty(report)
        {
            let _ = std::fs::write(self.run.path().join("report.json"), text);
        }
        result
    }

    fn stream(&mut self) -> Result<RunReport, Failure> {
        let begun = Instant::now();
        while !self.nodes.iter().all(|n| n.ready) {
            self.tick()?;
            if self.interrupted.load(Ordering::Relaxed) {
                return Err(Failure::Stopped);
            }
            if begun.elapsed() > READY_TIMEOUT {
                let waiting: Vec<&str> = self
                    .graph
                    .nodes
                    .iter()
                    .zip(&self.nodes)
                    .filter(|(_, s)| !s.ready)
                    .map(|(n, _)| n.name.as_str())
                    .collect();
                return Err(Failure::run(format!(
                    "not ready after {} s: {}",
                    READY_TIMEOUT.as_secs(),
                    waiting.join(", ")
                )));
            }
        }
        let go = Instant::now();
        for index in 0..self.nodes.len() {
            self.let_go(index);
        }
        self.write_status(State::Running);
        let mut stopping: Option<Instant> = None;
        while self.nodes.iter().any(|n| n.child.is_some() || n.restart_at.is_some()) {
            self.tick()?;
            if self.interrupted.load(Ordering::Relaxed) && stopping.is_none() {
                stopping = Some(Instant::now());
                self.stop_sources();
            }
            if stopping.is_some_and(|s| s.elapsed() > DRAIN_TIMEOUT) {
                return Err(Failure::run(format!(
                    "the graph did not drain within {} s of the stop request",
                    DRAIN_TIMEOUT.as_secs()
                )));
            }
        }
        let seconds = go.elapsed().as_secs_f64();
        self.drain_lines();
        self.report(seconds, stopping.is_some())
    }

    /// One look at everything.
    fn tick(&mut self) -> Result<(), Failure> {
        if let Ok((index, event)) = self.lines.recv_timeout(TICK) {
            self.handle(index, event);
        }
        self.drain_lines();
        for index in 0..self.nodes.len() {
            let exited = match &mut self.nodes[index].child {
                Some(child) => child.try_wait().ok().flatten(),
                None => None,
            };
            if let Some(status) = exited {
                self.exited(index, status)?;
            }
            if self.nodes[index].restart_at.is_some_and(|at| Instant::now() >= at) {
                self.nodes[index].restart_at = None;
                self.spawn(index)?;
            }
        }
        if self.status_written.elapsed() > Duration::from_millis(500) {
            self.write_status(State::Running);
        }
        Ok(())
    }

    fn drain_lines(&mut self) {
        while let Ok((index, event)) = self.lines.try_recv() {
            self.handle(index, event);
        }
    }

    fn handle(&mut self, index: usize, event: Event) {
        let restarted = self.nodes[index].restarts > 0;
        let node = &mut self.nodes[index];
        match event {
            Event::Ready => {
                node.ready = true;
                node.state = State::Running;
                if restarted {
                    self.let_go(index);
                }
            }
            Event::Progress { samples, fraction } => {
                node.samples = samples;
                if let (Some(fraction), Some(bar)) = (fraction, &self.bar) {
                    bar.set_position((fraction * 1000.0) as u64);
                    bar.set_message(format!("{samples} samples"));
                }
            }
            Event::Done { report } => {
                node.samples = report.published.max(report.received.values().copied().max().unwrap_or(0));
                node.report = Some(report);
            }
            Event::Failed { reason, code } => {
                node.failure = Some(if code == 2 { Failure::usage(reason) } else { Failure::run(reason) });
            }
        }
    }

    fn let_go(&mut self, index: usize) {
        if self.graph.nodes[index].inputs.is_empty()
            && let Some(stdin) = &mut self.nodes[index].stdin
        {
            // A source that has died meanwhile is noticed by its exit.
            let _ = stdin.write_all(b"go\n").and_then(|()| stdin.flush());
        }
    }

    fn exited(&mut self, index: usize, status: ExitStatus) -> Result<(), Failure> {
        // Its last lines may still be on the way; the reader ends with the process's standard output.
        if let Some(reader) = self.nodes[index].reader.take() {
            let until = Instant::now() + LAST_WORDS;
            while !reader.is_finished() && Instant::now() < until {
                std::thread::sleep(Duration::from_micros(200));
            }
        }
        self.drain_lines();
        let policy = self.graph.nodes[index].restart;
        let node = &mut self.nodes[index];
        node.child = None;
        node.stdin = None;
        let fine = status.success() && node.report.is_some();
        let over = self.interrupted.load(Ordering::Relaxed);
        let again = !over
            && self.graph.mode == Mode::Live
            && (policy == Restart::Always || (policy == Restart::OnFailure && !fine));
        let bad_use = matches!(node.failure, Some(Failure::Usage(_)));
        if again && !bad_use {
            // Quick at first; a node that keeps dying is retried more and more slowly.
            let lasted = node.started.elapsed();
            let doublings = if lasted > Duration::from_secs(5) { 0 } else { node.restarts.min(6) };
            let pause = Duration::from_millis(self.graph.nodes[index].backoff_ms << doublings);
            node.restarts += 1;
            node.report = None;
            node.failure = None;
            node.state = State::Starting;
            node.restart_at = Some(Instant::now() + pause);
            self.domain.clean_dead_nodes();
            return Ok(());
        }
        if fine {
            node.state = State::Done;
            return Ok(());
        }
        node.state = State::Failed;
        if node.failure.is_none() {
            node.failure = Some(Failure::run(describe(status)));
        }
        Err(self.cause())
    }

    /// The failure to report: what a stage says of bad input first, then a process that died without a word,
    /// then the complaint furthest down the stream (a writer complains of the reader it lost, not the other way).
    fn cause(&mut self) -> Failure {
        let until = Instant::now() + CAUSE_WINDOW;
        while Instant::now() < until {
            if let Ok((index, event)) = self.lines.recv_timeout(TICK) {
                self.handle(index, event);
            }
            for node in &mut self.nodes {
                let status = node.child.as_mut().and_then(|c| c.try_wait().ok().flatten());
                if let Some(status) = status {
                    node.child = None;
                    if !status.success() && node.failure.is_none() {
                        node.failure = Some(Failure::run(describe(status)));
                    }
                }
            }
        }
        let rank = |f: &Failure| match f {
            Failure::Usage(_) => 0,
            Failure::Run(what) if what.starts_with("was killed") => 1,
            Failure::Run(_) => 2,
            Failure::Stopped => 3,
        };
        let named = self.graph.nodes.iter().zip(&self.nodes).filter_map(|(n, s)| Some((n, s.failure.as_ref()?)));
        match named.rev().min_by_key(|(_, f)| rank(f)) {
            Some((_, f @ Failure::Usage(_))) => f.clone(),
            Some((node, f)) => {
                Failure::run(format!("node \"{}\" {}{f}", node.name, if rank(f) == 1 { "" } else { "failed: " }))
            }
            None => Failure::run("a node failed without saying why"),
        }
    }

    fn stop_sources(&mut self) {
        for (node, state) in self.graph.nodes.iter().zip(&self.nodes) {
            if node.inputs.is_empty()
                && let Some(child) = &state.child
            {
                signal(child, Signal::TERM);
            }
        }
    }

    /// SIGTERM to all that is left, SIGKILL after the grace period, then everything off the bus.
    fn terminate_all(&mut self) {
        for state in &self.nodes {
            if let Some(child) = &state.child {
                signal(child, Signal::TERM);
            }
        }
        let until = Instant::now() + GRACE;
        for state in &mut self.nodes {
            let Some(child) = &mut state.child else { continue };
            while Instant::now() < until && matches!(child.try_wait(), Ok(None)) {
                std::thread::sleep(TICK);
            }
            if matches!(child.try_wait(), Ok(None)) {
                let _ = child.kill();
            }
            let _ = child.wait();
            state.child = None;
        }
        self.domain.clean_dead_nodes();
        self.run.remove_domain();
    }

    fn report(&self, seconds: f64, stopped: bool) -> Result<RunReport, Failure> {
        let mut nodes = BTreeMap::new();
        for (node, state) in self.graph.nodes.iter().zip(&self.nodes) {
            let report = state
                .report
                .clone()
                .ok_or_else(|| Failure::run(format!("node \"{}\" ended without a report", node.name)))?;
            nodes.insert(node.name.clone(), report);
        }
        let samples = self
            .graph
            .nodes
            .iter()
            .filter(|n| n.inputs.is_empty())
            .filter_map(|n| nodes.get(&n.name))
            .map(|r: &StageReport| r.published)
            .max()
            .unwrap_or(0);
        let restarts = self.nodes.iter().map(|n| n.restarts).sum();
        // Every reader against the writer of its topic. A restarted node counts anew, so then the holes are
        // what the readers themselves saw.
        let mut lost = nodes.values().map(|r| r.missing).max().unwrap_or(0);
        if restarts == 0 {
            for node in &self.graph.nodes {
                for topic in &node.inputs {
                    let written = self
                        .graph
                        .nodes
                        .iter()
                        .find(|w| w.output.as_ref() == Some(topic))
                        .and_then(|w| nodes.get(&w.name));
                    let got = nodes.get(&node.name).and_then(|r| r.received.get(topic)).copied().unwrap_or(0);
                    lost = lost.max(written.map_or(0, |w| w.published.saturating_sub(got)));
                }
            }
        }
        Ok(RunReport {
            run: self.run.path().file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            samples,
            seconds,
            lost,
            stopped,
            restarts,
            nodes,
        })
    }

    fn write_status(&mut self, state: State) {
        self.status_written = Instant::now();
        let nodes = self
            .graph
            .nodes
            .iter()
            .zip(&self.nodes)
            .map(|(n, s)| NodeStatus {
                name: n.name.clone(),
                pid: s.child.as_ref().map_or(0, Child::id),
                state: s.state,
                restarts: s.restarts,
                samples: s.samples,
            })
            .collect();
        RunStatus {
            run: self.run.path().file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            graph: self.graph_path.display().to_string(),
            pid: std::process::id(),
            state,
            reason: self.reason.clone(),
            started_s: self.started_s,
            nodes,
        }
        .write(self.run.path());
    }
}

impl Drop for Supervisor<'_> {
    fn drop(&mut self) {
        self.terminate_all();
    }
}

fn signal(child: &Child, signal: Signal) {
    if let Some(pid) = Pid::from_raw(child.id() as i32) {
        let _ = kill_process(pid, signal);
    }
}

fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(9), _) => "was killed (SIGKILL)".to_owned(),
        (Some(s), _) => format!("was killed by signal {s}"),
        (None, Some(code)) => format!("exited with code {code} without a reason"),
        (None, None) => "ended".to_owned(),
    }
}

fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent}% {msg} ({eta})") {
        bar.set_style(style);
    }
    bar
}
