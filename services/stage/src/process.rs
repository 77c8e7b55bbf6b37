//! What every process of a graph does the same way: arguments, signals, the files it is given, how it ends.

use crate::clock::monotonic_ns;
use crate::control::{Event, Gauge, Order};
use crate::domain::{Domain, RunDir};
use clap::{CommandFactory, Parser};
use lacuna_interfaces::graph::{GraphFile, Mode, Node};
use lacuna_interfaces::{BadInput, ModelFile};
use lacuna_recording::LoadedRobot;
use std::io::BufRead;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Why a process or a run ends early.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Failure {
    /// Bad input or use: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// Anything else: exit code 1.
    #[error("{0}")]
    Run(String),
    /// It was asked to stop.
    #[error("stopped on request")]
    Stopped,
}

impl Failure {
    /// Bad input or use.
    pub fn usage(what: impl Into<String>) -> Self {
        Self::Usage(what.into())
    }

    /// A failure while running.
    pub fn run(what: impl Into<String>) -> Self {
        Self::Run(what.into())
    }

    /// The operating system refused a file: bad use where the place is wrong, a failure where the place is right and
    /// the machine is not (a full disk).
    pub fn of_file(what: impl Into<String>, kind: std::io::ErrorKind) -> Self {
        use std::io::ErrorKind as Kind;
        match kind {
            Kind::NotFound
            | Kind::PermissionDenied
            | Kind::AlreadyExists
            | Kind::NotADirectory
            | Kind::IsADirectory
            | Kind::ReadOnlyFilesystem
            | Kind::InvalidFilename
            | Kind::InvalidInput => Self::usage(what),
            _ => Self::run(what),
        }
    }

    /// Exit code that belongs to it.
    pub fn code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Run(_) | Self::Stopped => 1,
        }
    }
}

impl From<BadInput> for Failure {
    fn from(e: BadInput) -> Self {
        Self::Usage(e.to_string())
    }
}

/// Stop request: SIGTERM, SIGINT, or the supervisor's end of the standard input closed.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// True once a stop was asked for.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Forgets the request: a source that was stopped still has to pass the end of the stream on.
    pub(crate) fn clear(&self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// A process of a Lacuna graph; started by `lacuna up`.
#[derive(Debug, Parser)]
#[command(version, about = "A stage process of a Lacuna graph; started by `lacuna up`, not by hand.")]
struct Args {
    /// Run directory with the resolved graph.
    #[arg(long)]
    run: PathBuf,
    /// Name of this node in the graph.
    #[arg(long)]
    node: String,
    /// How often this node has been restarted before.
    #[arg(long, default_value_t = 0)]
    restarts: u32,
    /// Start at once instead of waiting for the supervisor's "go" on standard input.
    #[arg(long)]
    unsupervised: bool,
}

/// Everything a process is given.
pub(crate) struct Process {
    pub graph: GraphFile,
    pub node: Node,
    pub restarts: u32,
    pub robot: LoadedRobot,
    pub model: Option<ModelFile>,
    pub model_text: Option<String>,
    pub run: RunDir,
    pub stop: Stop,
    orders: Arc<Orders>,
}

/// What the supervisor has said so far.
#[derive(Default)]
struct Orders {
    /// When the stream began [ns], 0 before.
    began_ns: AtomicU64,
    /// A number the stream had not reached when this process was told to go.
    after_seq: AtomicU64,
    /// Looked at before the lock is taken.
    any_ended: AtomicBool,
    ended: Mutex<Vec<String>>,
}

impl Process {
    fn start() -> Result<Self, Failure> {
        let args: Args = crate::usage::parse(Args::command())?;
        let run = RunDir::open(&args.run);
        let graph = run.graph()?;
        let node = graph
            .nodes
            .iter()
            .find(|n| n.name == args.node)
            .cloned()
            .ok_or_else(|| Failure::usage(format!("--node {}: the graph has no such node", args.node)))?;
        // Before all else that takes time: a restart beside busy processors must be quick as well.
        crate::realtime::apply(&node)?;
        let robot = lacuna_recording::load_robot(&graph.robot)?;
        let model_path = graph.model_of(&node);
        let (model, model_text) = if model_path.is_empty() {
            (None, None)
        } else {
            let (model, text) = lacuna_recording::load_model(model_path, &robot.file)?;
            (Some(model), Some(text))
        };
        let stop = Stop::default();
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&stop.0))
                .map_err(|e| Failure::run(format!("cannot handle signals: {e}")))?;
        }
        let orders = Arc::new(Orders::default());
        if args.unsupervised {
            orders.began_ns.store(monotonic_ns(), Ordering::Relaxed);
        } else {
            watch_supervisor(stop.clone(), Arc::clone(&orders));
        }
        Ok(Self { graph, node, restarts: args.restarts, robot, model, model_text, run, stop, orders })
    }

    /// The node's configuration as the stage's own type.
    pub fn config<C: serde::de::DeserializeOwned>(&self) -> Result<C, Failure> {
        toml::Value::Table(self.node.config.clone()).try_into().map_err(|e: toml::de::Error| {
            Failure::usage(format!(
                "node \"{}\", config: {}",
                self.node.name,
                e.message().split_whitespace().collect::<Vec<_>>().join(" ")
            ))
        })
    }

    /// Messages that each of its inputs can hold.
    pub fn buffer(&self) -> usize {
        self.graph.buffer_of(&self.node)
    }

    pub fn domain(&self) -> Result<Domain, Failure> {
        Domain::join(&self.run, &self.node.name)
    }

    /// What the source of this graph reads, as its configuration names it.
    pub fn recording(&self) -> String {
        let source = self.graph.nodes.iter().find(|n| n.inputs.is_empty());
        match source.and_then(|n| n.config.get("recording")) {
            Some(toml::Value::String(path)) => path.clone(),
            Some(other) => other.to_string(),
            None => source.map_or_else(|| "stream".to_owned(), |n| n.name.clone()),
        }
    }

    /// The one input of a stage.
    pub fn single_input(&self) -> Result<&str, Failure> {
        match self.node.inputs.as_slice() {
            [topic] => Ok(topic),
            other => {
                Err(Failure::usage(format!("node \"{}\": found {} inputs; expected one", self.node.name, other.len())))
            }
        }
    }

    /// Waits until the supervisor lets the stream begin (or a stop is asked for). Returns when it began, which for a
    /// source that was started again lies in the past, and a number it had not reached yet.
    pub fn wait_for_go(&self) -> (u64, u64) {
        loop {
            let began = self.orders.began_ns.load(Ordering::Acquire);
            if began > 0 || self.stop.requested() {
                return (began, self.orders.after_seq.load(Ordering::Relaxed));
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    }

    /// True if the writer of `topic` has left for good: an empty buffer then is the end of a live stream.
    pub fn ended(&self, topic: &str) -> bool {
        self.graph.mode == Mode::Live
            && self.orders.any_ended.load(Ordering::Acquire)
            && self.orders.ended.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|t| t == topic)
    }
}

/// Reads the standard input on a thread of its own: the supervisor's orders; its end (the supervisor died) stops
/// the process.
fn watch_supervisor(stop: Stop, orders: Arc<Orders>) {
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { break };
            match Order::parse(&line) {
                Some(Order::Go { began_ns, after_seq }) => {
                    orders.after_seq.store(after_seq, Ordering::Relaxed);
                    orders.began_ns.store(began_ns.max(1), Ordering::Release);
                }
                Some(Order::Ended(topic)) => {
                    orders.ended.lock().unwrap_or_else(PoisonError::into_inner).push(topic);
                    orders.any_ended.store(true, Ordering::Release);
                }
                None => {}
            }
        }
        stop.0.store(true, Ordering::Relaxed);
    });
}

/// Runs the body of a process and turns its end into control messages and an exit code.
pub(crate) fn main_with(body: impl FnOnce(&Process) -> Result<crate::StageReport, Failure>) -> ExitCode {
    tracing_subscriber::fmt().with_writer(std::io::stderr).with_max_level(tracing::Level::INFO).with_ansi(false).init();
    match Process::start().and_then(|p| body(&p)) {
        Ok(mut report) => {
            report.peak_rss_kib = peak_rss_kib();
            Event::Done { report }.emit();
            ExitCode::SUCCESS
        }
        Err(failure) => {
            tracing::error!("{failure}");
            Event::Failed { reason: failure.to_string(), code: failure.code() }.emit();
            ExitCode::from(failure.code())
        }
    }
}

/// Largest resident size so far, as the kernel counts it; 0 where it does not say.
fn peak_rss_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Rate limit for progress messages.
pub(crate) struct Pulse {
    last: std::time::Instant,
}

impl Pulse {
    pub fn new() -> Self {
        Self { last: std::time::Instant::now() }
    }

    /// Emits a progress event if half a second has passed since the last one.
    pub fn progress(&mut self, samples: u64, fraction: Option<f64>, gauge: impl FnOnce() -> Gauge) {
        if self.last.elapsed().as_millis() >= 500 {
            self.last = std::time::Instant::now();
            Event::Progress { samples, fraction, gauge: gauge() }.emit();
        }
    }
}
