//! The supervisor of a run: starts the nodes, lets the stream begin when all are ready, watches them, and
//! brings them down in order. One thread looks at everything in turn; a thread per node reads its lines.

mod node;
mod report;
mod status;

pub use report::RunReport;

use crate::runs::{self, State};
use indicatif::{ProgressBar, ProgressStyle};
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_stage::clock::monotonic_ns;
use lacuna_stage::{Domain, Event, Failure, Order, RunDir, Sweeper};
use node::{NodeState, describe};
use rustix::process::Signal;
use status::StatusFile;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long a node may take to end after SIGTERM, before SIGKILL.
const GRACE: Duration = Duration::from_secs(3);
/// How long the rest of the graph may take to drain after the source was stopped.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(30);
/// How long the last lines of a process that has ended may take.
const LAST_WORDS: Duration = Duration::from_millis(500);
const TICK: Duration = Duration::from_millis(3);

/// Owner of a run's processes. Dropping it kills what is left and removes the domain.
pub struct Supervisor<'a> {
    graph: &'a GraphFile,
    graph_path: &'a Path,
    executables: &'a [PathBuf],
    run: RunDir,
    domain: Domain,
    /// Without it what a process leaves unfinished would stop whoever waits for it.
    _sweeper: Sweeper,
    nodes: Vec<NodeState>,
    lines: Receiver<(usize, Event)>,
    sender: Sender<(usize, Event)>,
    interrupted: Arc<AtomicBool>,
    bar: Option<ProgressBar>,
    /// When the stream began [ns], once it has.
    began_ns: Option<u64>,
    status_file: StatusFile,
    status_written: Instant,
    /// True if the status has changed since it was last written.
    changed: bool,
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
        let sweeper = Sweeper::start(&run);
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
            _sweeper: sweeper,
            nodes: Vec::new(),
            lines,
            sender,
            interrupted,
            bar: show_progress.then(progress_bar),
            began_ns: None,
            status_file: StatusFile::new(dir.to_path_buf()),
            status_written: Instant::now(),
            changed: true,
            started_s: runs::now_s(),
            reason: None,
        };
        for index in 0..graph.nodes.len() {
            supervisor.nodes.push(NodeState::new());
            supervisor.spawn(index)?;
        }
        supervisor.keep_status(State::Starting);
        Ok(supervisor)
    }

    fn spawn(&mut self, index: usize) -> Result<(), Failure> {
        let node = &self.graph.nodes[index];
        let lines = (index, self.sender.clone());
        self.nodes[index].spawn(node, &self.executables[index], &self.run, lines)?;
        // Of writers that left before it was started it would hear nothing.
        for topic in &node.inputs {
            let writer = self.graph.nodes.iter().position(|n| n.output.as_ref() == Some(topic));
            if writer.is_some_and(|w| self.nodes.get(w).is_some_and(NodeState::has_left)) {
                self.nodes[index].tell(&Order::Ended(topic.clone()));
            }
        }
        self.changed = true;
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
        self.last_status(if result.is_ok() { State::Done } else { State::Failed });
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
                return Err(self.not_ready(READY_TIMEOUT.as_secs()));
            }
        }
        let go = Instant::now();
        self.began_ns = Some(monotonic_ns());
        for index in 0..self.nodes.len() {
            self.let_go(index);
        }
        self.changed = true;
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
        self.keep_status(if self.began_ns.is_some() { State::Running } else { State::Starting });
        Ok(())
    }

    fn drain_lines(&mut self) {
        while let Ok((index, event)) = self.lines.try_recv() {
            self.handle(index, event);
        }
    }

    fn handle(&mut self, index: usize, event: Event) {
        let node = &mut self.nodes[index];
        match event {
            Event::Ready => {
                node.ready = true;
                node.state = State::Running;
                if let Some(fault) = node.faults.last_mut() {
                    fault.ready_ns = Some(monotonic_ns());
                }
                self.changed = true;
                self.let_go(index);
            }
            Event::Flowing { at_ns } => {
                if let Some(fault) = node.faults.last_mut() {
                    fault.flowing_ns = Some(at_ns);
                }
            }
            Event::Progress { samples, fraction, gauge } => {
                node.progressed(samples, gauge);
                if let (Some(fraction), Some(bar)) = (fraction, &self.bar) {
                    bar.set_position((fraction * 1000.0) as u64);
                    bar.set_message(format!("{samples} samples"));
                }
            }
            Event::Done { report } => {
                node.samples = report.published.max(report.received.values().copied().max().unwrap_or(0));
                node.gauge.dropped = report.dropped;
                node.gauge.missing = report.missing;
                node.report = Some(report);
            }
            Event::Failed { reason, code } => {
                node.failure = Some(if code == 2 { Failure::usage(reason) } else { Failure::run(reason) });
            }
        }
    }

    /// Lets a source begin, once the stream has begun.
    fn let_go(&mut self, index: usize) {
        if let Some(began_ns) = self.began_ns
            && self.graph.nodes[index].inputs.is_empty()
        {
            let running_s = monotonic_ns().saturating_sub(began_ns) as f64 / 1e9;
            let again = self.nodes[index].restarts > 0;
            let after_seq = if again { self.nodes[index].beyond(running_s) } else { 0 };
            self.nodes[index].tell(&Order::Go { began_ns, after_seq });
        }
    }

    fn exited(&mut self, index: usize, status: ExitStatus) -> Result<(), Failure> {
        let noticed_ns = monotonic_ns();
        // Its last lines may still be on the way; the reader ends with the process's standard output.
        if let Some(reader) = self.nodes[index].reader.take() {
            let until = Instant::now() + LAST_WORDS;
            while !reader.is_finished() && Instant::now() < until {
                std::thread::sleep(Duration::from_micros(200));
            }
        }
        self.drain_lines();
        self.changed = true;
        let graph = self.graph;
        let spec = &graph.nodes[index];
        let stopping = self.interrupted.load(Ordering::Relaxed);
        let node = &mut self.nodes[index];
        node.gone();
        let fine = status.success() && node.report.is_some();
        if fine {
            node.state = State::Done;
        } else {
            let reason = node.failure.as_ref().map_or_else(|| describe(status), ToString::to_string);
            node.failed(&spec.name, reason, noticed_ns);
        }
        let bad_use = matches!(node.failure, Some(Failure::Usage(_)));
        let live = graph.mode == Mode::Live && !bad_use;
        let left = fine && spec.inputs.iter().all(|t| self.writer_has_left(t));
        let node = &mut self.nodes[index];
        if live && !left && node.again(spec, fine, stopping) {
            node.plan_restart(spec);
            self.domain.clean_dead_nodes();
            return Ok(());
        }
        if !fine {
            node.state = State::Failed;
            if node.failure.is_none() {
                node.failure = Some(Failure::run(describe(status)));
            }
            // A source that dies while the graph is being stopped: what it sent is drained all the same.
            if !(live && stopping && spec.inputs.is_empty()) {
                return Err(self.cause());
            }
            self.domain.clean_dead_nodes();
        }
        self.tell_readers(index);
        Ok(())
    }

    fn writer_has_left(&self, topic: &str) -> bool {
        let writer = self.graph.nodes.iter().position(|n| n.output.as_deref() == Some(topic));
        writer.is_some_and(|w| self.nodes[w].has_left())
    }

    /// Says that this node's topic has ended to those who read it. Usually they know by the sentinel; one that was
    /// started again in the meantime does not.
    fn tell_readers(&mut self, index: usize) {
        let Some(topic) = &self.graph.nodes[index].output else { return };
        for (node, state) in self.graph.nodes.iter().zip(&mut self.nodes) {
            if node.inputs.contains(topic) {
                state.tell(&Order::Ended(topic.clone()));
            }
        }
    }

    fn stop_sources(&mut self) {
        for (node, state) in self.graph.nodes.iter().zip(&self.nodes) {
            if node.inputs.is_empty() {
                state.signal(Signal::TERM);
            }
        }
    }

    /// SIGTERM to all that is left, SIGKILL after the grace period, then everything off the bus.
    fn terminate_all(&mut self) {
        for state in &self.nodes {
            state.signal(Signal::TERM);
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
}

impl Drop for Supervisor<'_> {
    fn drop(&mut self) {
        self.terminate_all();
    }
}

fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent}% {msg} ({eta})") {
        bar.set_style(style);
    }
    bar
}
