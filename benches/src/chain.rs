//! Runs the bare chain and Lacuna's graphs as processes.

use crate::{BenchError, beside};
use serde::Deserialize;
use std::path::Path;
use std::process::{Command, Stdio};

/// What the sink of the bare chain prints.
#[derive(Debug, Clone, Deserialize)]
pub struct BareResult {
    /// Samples that arrived.
    pub samples: u64,
    /// Seconds from the first to the last.
    pub seconds: f64,
    /// Median latency [µs].
    pub p50_us: f64,
    /// 99th percentile [µs].
    pub p99_us: f64,
    /// 99.9th percentile [µs].
    pub p999_us: f64,
    /// Largest [µs].
    pub max_us: f64,
}

impl BareResult {
    /// Samples per second.
    pub fn rate(&self) -> f64 {
        self.samples as f64 / self.seconds.max(1e-9)
    }
}

/// Runs a bare chain of `processes` (source, relays, sink) for `samples` samples, `period_ns` apart (0: as fast
/// as possible).
///
/// # Errors
/// If a process fails.
pub fn bare(processes: usize, samples: u64, buffer: usize, period_ns: u64) -> Result<BareResult, BenchError> {
    let exe = beside("lacuna-bare-chain")?;
    let name = format!("lacuna-bare-{}", std::process::id());
    let root = Path::new("/dev/shm").join(&name);
    std::fs::create_dir_all(&root)?;
    let dir = tempfile::tempdir()?;
    let domain = dir.path().join("domain.toml");
    std::fs::write(&domain, format!("[global]\nroot-path = \"{}\"\nprefix = \"{name}_\"\n", root.display()))?;
    let edges = processes - 1;
    let mut children = Vec::new();
    for i in (0..processes).rev() {
        let role = if i == 0 {
            "source"
        } else if i == edges {
            "sink"
        } else {
            "relay"
        };
        let numbers = [i as u64, edges as u64, samples, buffer as u64, period_ns].map(|n| n.to_string());
        let child = Command::new(&exe).arg(&domain).arg(role).args(numbers).stdout(Stdio::piped()).spawn()?;
        children.push((role, child));
    }
    let mut result = None;
    let mut failed = None;
    for (role, child) in children {
        let out = child.wait_with_output()?;
        if !out.status.success() {
            failed = Some(format!("bare chain: {role} ended with {}", out.status));
        } else if role == "sink" {
            result = Some(serde_json::from_slice(&out.stdout)?);
        }
    }
    let _ = std::fs::remove_dir_all(&root);
    for entry in std::fs::read_dir("/dev/shm")?.flatten() {
        if entry.file_name().to_string_lossy().starts_with(&format!("{name}_")) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    if let Some(what) = failed {
        return Err(what.into());
    }
    result.ok_or_else(|| "bare chain: no result".into())
}

/// Runs `lacuna up GRAPH --json ARGS` and returns the report.
///
/// # Errors
/// If the run fails; samples that were lost are in the report.
pub fn graph(graph: &Path, sets: &[(&str, String)]) -> Result<serde_json::Value, BenchError> {
    let mut command = Command::new(beside("lacuna")?);
    command.arg("up").arg(graph).arg("--json");
    for (key, value) in sets {
        command.arg("--set").arg(format!("{key}={value}"));
    }
    let out = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output()?;
    // 3: it finished and counted losses, which a live graph under load may have.
    if !matches!(out.status.code(), Some(0 | 3)) {
        return Err(format!("{} ended with {}", graph.display(), out.status).into());
    }
    Ok(serde_json::from_slice(&out.stdout)?)
}

/// Files of a run that are left in shared memory.
pub fn remaining(run: &str) -> usize {
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    entries.filter(|e| e.file_name().to_string_lossy().starts_with(run)).count()
}
