//! Finding the processes of a graph and killing them.

use rustix::process::{Pid, Signal, kill_process};
use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// One SIGKILL.
#[derive(Debug, Clone)]
pub struct Kill {
    /// Node.
    pub node: String,
    /// CLOCK_MONOTONIC just before [ns].
    pub at_ns: u64,
    /// The graph was still starting.
    pub at_start: bool,
    /// The process had just been restarted.
    pub again: bool,
    /// Until the graph was whole again (while starting: until the node was ready) [ms]; `None` if the node was killed
    /// once more before.
    pub whole_ms: Option<f64>,
    /// CLOCK_MONOTONIC when the next process passed on its first sample [ns]; `None` if it was killed before.
    pub flowing_ns: Option<u64>,
}

/// CLOCK_MONOTONIC [ns].
pub fn monotonic_ns() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Process of `node`, a child of the supervisor.
pub fn pid_of(supervisor: u32, node: &str) -> Option<u32> {
    processes(supervisor).into_iter().find(|(_, name)| name == node).map(|(pid, _)| pid)
}

/// The supervisor's children that are nodes already (and not still copies of the supervisor), with their names.
pub fn processes(supervisor: u32) -> Vec<(u32, String)> {
    let children = std::fs::read_to_string(format!("/proc/{supervisor}/task/{supervisor}/children"));
    let pids = children.unwrap_or_default();
    let pids = pids.split_whitespace().filter_map(|p| p.parse::<u32>().ok());
    pids.filter_map(|pid| Some((pid, node_name(pid)?))).collect()
}

fn node_name(pid: u32) -> Option<String> {
    let line = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    let mut args = line.split(|b| *b == 0);
    args.find(|a| *a == b"--node")?;
    args.next().map(|name| String::from_utf8_lossy(name).into_owned())
}

/// Waits until `node` has a process other than `not`.
pub fn wait_for(supervisor: u32, node: &str, not: Option<u32>, limit: Duration) -> Option<u32> {
    let started = Instant::now();
    while started.elapsed() < limit {
        if let Some(pid) = pid_of(supervisor, node)
            && Some(pid) != not
        {
            return Some(pid);
        }
        std::thread::sleep(Duration::from_micros(500));
    }
    None
}

/// Kills a process; the time just before, or `None` if it was gone already.
pub fn kill(pid: u32) -> Option<u64> {
    let at = monotonic_ns();
    kill_process(Pid::from_raw(pid as i32)?, Signal::KILL).ok().map(|()| at)
}
