//! Resident memory of every process after a short and a long replay: constant, or it is a leak.

use crate::chain::graph;
use crate::{BenchError, launch_file, motion};
use serde::Serialize;
use std::path::Path;

/// Peak resident size of one process.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Node.
    pub node: String,
    /// Peak of the short replay [MiB].
    pub short_mib: f64,
    /// Peak of the long replay [MiB].
    pub long_mib: f64,
}

/// Replays `short` and `long` samples at 1 kHz through the whole graph with recorder.
///
/// # Errors
/// If a run fails.
pub fn run(launch: &Path, short: u64, long: u64, progress: &mut dyn FnMut(&str)) -> Result<Vec<Row>, BenchError> {
    let graph_file = launch.join("replay.toml");
    launch_file(&graph_file)?;
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    let mut peaks = Vec::new();
    for samples in [short, long] {
        progress(&format!("{samples} samples"));
        motion::write_csv(&file("run.csv"), samples, 1000.0)?;
        let text = |name: &str| file(name).display().to_string();
        let sets = [
            ("recording", text("run.csv")),
            ("robot", text("robot.toml")),
            ("model", text("model.toml")),
            ("out", text("run.mcap")),
            ("overwrite", "true".to_owned()),
        ];
        let report = graph(&graph_file, &sets)?;
        if report["samples"].as_u64() != Some(samples) || report["lost"].as_u64() != Some(0) {
            return Err(format!("{} of {samples} samples", report["samples"]).into());
        }
        let nodes = report["nodes"].as_object().cloned().unwrap_or_default();
        peaks.push(
            nodes
                .into_iter()
                .map(|(name, n)| (name, n["peak_rss_kib"].as_f64().unwrap_or(0.0) / 1024.0))
                .collect::<Vec<_>>(),
        );
    }
    let [short, long] = peaks.as_slice() else { return Err("two runs expected".into()) };
    Ok(short
        .iter()
        .zip(long)
        .map(|((node, a), (_, b))| Row { node: node.clone(), short_mib: *a, long_mib: *b })
        .collect())
}
