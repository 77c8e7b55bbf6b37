//! Where and when figures were made: they say little without it.

use serde::{Deserialize, Serialize};

/// The machine and its mood.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Conditions {
    /// Processor.
    pub processor: String,
    /// Processors that may be used.
    pub cores: usize,
    /// Memory [GiB].
    pub memory_gib: f64,
    /// Kernel.
    pub kernel: String,
    /// Load average over the last minute before the start.
    pub load_before: f64,
    /// Version of Lacuna.
    pub version: String,
}

/// Reads them from the operating system; what it does not say is empty or 0.
pub fn now() -> Conditions {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let field = |text: &str, key: &str| {
        let line = text.lines().find(|l| l.starts_with(key)).unwrap_or_default();
        line.split_once(':').map_or_else(String::new, |(_, v)| v.trim().to_owned())
    };
    let memory = field(&read("/proc/meminfo"), "MemTotal");
    let kib: f64 = memory.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(0.0);
    let uname = rustix::system::uname();
    Conditions {
        processor: field(&read("/proc/cpuinfo"), "model name"),
        cores: std::thread::available_parallelism().map_or(0, usize::from),
        memory_gib: kib / f64::from(1 << 20),
        kernel: format!("{} {}", uname.sysname().to_string_lossy(), uname.release().to_string_lossy()),
        load_before: read("/proc/loadavg").split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(0.0),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

/// What a benchmark prints as JSON and `lacuna bench report` reads.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Document<R> {
    /// Which benchmark: `faults`, `latency`, …
    pub bench: String,
    /// The command that made it.
    pub command: String,
    /// Where and when.
    pub conditions: Conditions,
    /// What it took [s].
    pub took_s: f64,
    /// The figures.
    pub result: R,
}
