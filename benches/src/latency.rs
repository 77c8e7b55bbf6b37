//! Live latency per hop and end to end at a given rate, beside the bare chain at the same rate.

use crate::chain::{BareResult, bare, graph};
use crate::{BenchError, motion};
use lacuna_interfaces::graph::GraphFile;
use serde::Serialize;
use std::path::Path;

/// Latency at one rate.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Sample rate [Hz].
    pub rate_hz: f64,
    /// Hop, or `bare, end to end`.
    pub hop: String,
    /// Percentiles [µs]: median, 99 %, 99.9 %, largest.
    pub us: [f64; 4],
    /// Samples lost on the way.
    pub lost: u64,
}

/// Runs the live graph and the bare chain for `seconds` at `rate_hz`.
///
/// # Errors
/// If a run fails.
pub fn run(launch: &Path, rate_hz: f64, seconds: f64, progress: &mut dyn FnMut(&str)) -> Result<Vec<Row>, BenchError> {
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    let samples = (rate_hz * seconds) as u64;
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    motion::write_csv(&file("run.csv"), samples, rate_hz)?;
    progress(&format!("bare chain at {rate_hz} Hz"));
    let BareResult { p50_us, p99_us, p999_us, max_us, .. } = bare(6, samples, 512, (1e9 / rate_hz) as u64)?;
    let mut rows =
        vec![Row { rate_hz, hop: "bare chain, end to end".to_owned(), us: [p50_us, p99_us, p999_us, max_us], lost: 0 }];
    progress(&format!("live graph at {rate_hz} Hz"));
    let live = launch.join("live.toml");
    let text = |name: &str| file(name).display().to_string();
    let sets = [
        ("recording", text("run.csv")),
        ("robot", text("robot.toml")),
        ("model", text("model.toml")),
        ("out", text("run.mcap")),
    ];
    let report = graph(&live, &sets)?;
    let lost = report["lost"].as_u64().unwrap_or(0);
    let names: Vec<String> =
        GraphFile::parse(&std::fs::read_to_string(&live)?)?.nodes.into_iter().map(|n| n.name).collect();
    let hops = report["nodes"]["recorder"]["latency"].as_array().cloned().unwrap_or_default();
    for hop in hops {
        let value = |key: &str| hop[key].as_f64().unwrap_or(f64::NAN);
        let name = named(hop["hop"].as_str().unwrap_or("?"), &names);
        rows.push(Row { rate_hz, hop: name, us: ["p50_us", "p99_us", "p999_us", "max_us"].map(value), lost });
    }
    Ok(rows)
}

/// A hop as the sink numbers it (`2→3`, `4→here`), with the names of the graph's nodes.
pub fn named(hop: &str, names: &[String]) -> String {
    let node = |text: &str| match text {
        "here" => names.last().cloned(),
        number => number.parse::<usize>().ok().and_then(|i| names.get(i).cloned()),
    };
    let (pair, rest) = hop.split_once(' ').map_or((hop, String::new()), |(a, b)| (a, format!(" {b}")));
    match pair.split_once('→').map(|(a, b)| (node(a), node(b))) {
        Some((Some(a), Some(b))) => format!("{a} → {b}{rest}"),
        _ => hop.to_owned(),
    }
}
