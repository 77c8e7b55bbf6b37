//! One node as the supervisor sees it: its process, its pipes, its counts, and when it is started again.

use super::report::Fault;
use crate::runs::State;
use lacuna_interfaces::graph::{Node, Restart};
use lacuna_stage::{Event, Failure, Gauge, Order, RunDir, StageReport};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::Sender;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A node that lasted this long was well; what happens to it next is a new story.
const WELL: Duration = Duration::from_secs(1);
/// No source is quicker than this.
const FASTEST_HZ: f64 = 20_000.0;
/// How far a source's numbers are set ahead after a restart: what a progress line may have waited on its way.
const MARGIN: Duration = Duration::from_millis(20);
/// How long flags are shown.
const REMEMBER: Duration = Duration::from_secs(5);
/// The pause before a restart doubles this often at most.
const MOST_DOUBLINGS: u32 = 6;

/// State of one node.
pub(super) struct NodeState {
    pub child: Option<Child>,
    stdin: Option<ChildStdin>,
    pub reader: Option<JoinHandle<()>>,
    pub ready: bool,
    pub samples: u64,
    pub rate_hz: f64,
    rated: (Instant, u64),
    /// When its last process told of how many samples at which rate.
    reached: Option<(Instant, u64, f64)>,
    /// Progress lines of the present process.
    lines: u32,
    pub gauge: Gauge,
    /// All flags of the last [`REMEMBER`] or less, and since when: a viewer must not miss an alarm of a moment.
    pub flags: u32,
    flags_since: Instant,
    /// Counts of the processes of this node that died, as they last reported them.
    pub carried: Gauge,
    pub restarts: u32,
    /// Deaths in a row after less than [`WELL`].
    quick_deaths: u32,
    pub restart_at: Option<Instant>,
    started: Instant,
    pub failure: Option<Failure>,
    pub report: Option<StageReport>,
    pub state: State,
    pub faults: Vec<Fault>,
}

impl NodeState {
    pub fn new() -> Self {
        Self {
            child: None,
            stdin: None,
            reader: None,
            ready: false,
            samples: 0,
            rate_hz: 0.0,
            rated: (Instant::now(), 0),
            reached: None,
            lines: 0,
            gauge: Gauge::default(),
            flags: 0,
            flags_since: Instant::now(),
            carried: Gauge::default(),
            restarts: 0,
            quick_deaths: 0,
            restart_at: None,
            started: Instant::now(),
            failure: None,
            report: None,
            state: State::Starting,
            faults: Vec::new(),
        }
    }

    /// Starts the process; its lines arrive at `lines` under `index`.
    pub fn spawn(
        &mut self,
        node: &Node,
        executable: &Path,
        run: &RunDir,
        lines: (usize, Sender<(usize, Event)>),
    ) -> Result<(), Failure> {
        let log = run.path().join(format!("{}.log", node.name));
        let log = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&log)
            .map_err(|e| Failure::run(format!("{}: cannot write: {e}", log.display())))?;
        let mut child = Command::new(executable)
            .args(&node.args)
            .arg("--run")
            .arg(run.path())
            .args(["--node", &node.name, "--restarts", &self.restarts.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log)
            // A group of its own: Ctrl-C reaches the supervisor alone, which stops the graph in order.
            .process_group(0)
            .spawn()
            .map_err(|e| {
                Failure::usage(format!("node \"{}\": cannot start {}: {e}", node.name, executable.display()))
            })?;
        self.stdin = child.stdin.take();
        self.started = Instant::now();
        self.ready = false;
        self.state = State::Starting;
        if let Some(stdout) = child.stdout.take() {
            let (index, sender) = lines;
            self.reader = Some(std::thread::spawn(move || {
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
        self.child = Some(child);
        Ok(())
    }

    /// Tells the process something. One that has died meanwhile is noticed by its exit.
    pub fn tell(&mut self, order: &Order) {
        if let Some(stdin) = &mut self.stdin {
            let _ = stdin.write_all(order.line().as_bytes()).and_then(|()| stdin.flush());
        }
    }

    pub fn signal(&self, signal: Signal) {
        if let Some(pid) = self.child.as_ref().and_then(|c| Pid::from_raw(c.id() as i32)) {
            let _ = kill_process(pid, signal);
        }
    }

    /// A progress line came.
    pub fn progressed(&mut self, samples: u64, gauge: Gauge) {
        let (since, before) = self.rated;
        let seconds = since.elapsed().as_secs_f64();
        if seconds > 0.1 {
            // A restarted process counts anew.
            self.rate_hz = samples.saturating_sub(before) as f64 / seconds;
            self.rated = (Instant::now(), samples);
        }
        self.samples = samples;
        // The first line of a process covers its start as well: its rate says nothing.
        self.lines += 1;
        if self.lines > 1 {
            self.reached = Some((Instant::now(), samples, self.rate_hz));
        }
        if self.flags_since.elapsed() > REMEMBER {
            (self.flags, self.flags_since) = (0, Instant::now());
        }
        self.flags |= gauge.flags;
        self.gauge = gauge;
    }

    /// True if this node is to be started again after it ended, well (`fine`) or not.
    pub fn again(&self, node: &Node, fine: bool, stopping: bool) -> bool {
        let source = node.inputs.is_empty();
        match node.restart {
            Restart::Never => false,
            // Where a source ended by itself the stream ended.
            Restart::Always if fine => !source && !stopping,
            Restart::Always | Restart::OnFailure => !(fine || stopping && source),
        }
    }

    /// Forgets the process that ended and plans the next one.
    pub fn plan_restart(&mut self, node: &Node) {
        // Quick at first; a node that keeps dying is retried more and more slowly.
        self.quick_deaths = if self.started.elapsed() > WELL { 0 } else { self.quick_deaths + 1 };
        let doublings = self.quick_deaths.saturating_sub(1).min(MOST_DOUBLINGS);
        let pause = Duration::from_millis(node.backoff_ms.saturating_mul(1 << doublings));
        self.restarts += 1;
        self.lines = 0;
        self.report = None;
        self.failure = None;
        self.state = State::Starting;
        self.carried.dropped += self.gauge.dropped;
        self.carried.missing += self.gauge.missing;
        self.gauge = Gauge::default();
        self.rated = (Instant::now(), 0);
        self.rate_hz = 0.0;
        self.restart_at = Some(Instant::now() + pause);
    }

    /// True if the node ended for good: nothing comes from it any more.
    pub fn has_left(&self) -> bool {
        self.child.is_none() && self.restart_at.is_none() && matches!(self.state, State::Done | State::Failed)
    }

    /// A number that the stream of this source, which began `running_s` ago, has not reached yet: where it would be by
    /// now had it gone on, and a little more, since numbers that come twice would be taken for old samples. Before
    /// its rate is known the fastest fieldbus is assumed: rather a hole too long than samples that nobody takes.
    pub fn beyond(&self, running_s: f64) -> u64 {
        let (from, rate_hz, since_s) = match self.reached {
            Some((when, samples, rate_hz)) => (samples, rate_hz, when.elapsed().as_secs_f64()),
            None => (0, FASTEST_HZ, running_s),
        };
        from + (rate_hz * (since_s + MARGIN.as_secs_f64())).ceil() as u64 + 1
    }

    /// The process is gone.
    pub fn gone(&mut self) {
        self.child = None;
        self.stdin = None;
        self.ready = false;
    }
}

/// How a process ended.
pub(super) fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(9), _) => "was killed (SIGKILL)".to_owned(),
        (Some(s), _) => format!("was killed by signal {s}"),
        (None, Some(code)) => format!("exited with code {code} without a reason"),
        (None, None) => "ended".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lacuna_interfaces::graph::GraphFile;

    fn node(restart: &str, inputs: &str) -> Node {
        let text = format!(
            "name = \"g\"\nmode = \"live\"\n[[node]]\nname = \"n\"\nexec = \"x\"\nrestart = \"{restart}\"\ninputs = [{inputs}]\n"
        );
        GraphFile::parse(&text).unwrap().nodes.remove(0)
    }

    #[test]
    fn who_is_started_again() {
        let again = |restart: &str, inputs: &str, fine, stopping| {
            NodeState::new().again(&node(restart, inputs), fine, stopping)
        };
        let (stage, source) = ("\"t\"", "");
        assert!(!again("never", stage, false, false));
        assert!(again("on-failure", stage, false, false) && !again("on-failure", stage, true, false));
        assert!(again("always", stage, true, false) && !again("always", stage, true, true));
        // While a graph is being stopped its stages still drain it; its sources have nothing more to do.
        assert!(again("on-failure", stage, false, true) && !again("on-failure", source, false, true));
        assert!(!again("always", source, true, false), "a source that reached its end has ended");
    }

    #[test]
    fn numbers_of_a_live_source_go_on_beyond_those_it_gave() {
        let mut state = NodeState::new();
        assert!(state.beyond(0.3) > 6000, "nothing is known of its rate yet");
        for samples in [800, 1200] {
            std::thread::sleep(Duration::from_millis(110));
            state.progressed(samples, Gauge::default());
        }
        let first = state.beyond(99.0);
        assert!(first > 1200 && first < 4000, "{first}");
        std::thread::sleep(Duration::from_millis(20));
        assert!(state.beyond(99.0) > first, "the stream would have gone on");
    }

    #[test]
    fn pauses_grow_only_while_a_node_dies_young() {
        let spec = node("on-failure", "");
        let mut state = NodeState::new();
        let mut pause = || {
            state.plan_restart(&spec);
            state.restart_at.unwrap().saturating_duration_since(Instant::now()).as_millis()
        };
        let pauses: Vec<u128> = (0..9).map(|_| pause()).collect();
        assert!(pauses[0] <= 5 && pauses[3] > 30 && pauses[8] <= 320 && pauses[8] > 300, "{pauses:?}");
        assert_eq!(state.restarts, 9);
    }
}
