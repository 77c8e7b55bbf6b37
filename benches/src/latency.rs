//! Live latency per hop and end to end at a given rate, beside the bare chain at the same rate; with busy processors
//! beside it, and with what real-time priority and pinning then buy.

use crate::balance;
use crate::chain::{BareResult, bare, graph};
use crate::load::Hog;
use crate::{BenchError, launch_file, motion};
use lacuna_interfaces::graph::GraphFile;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Latency at one rate.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// Sample rate [Hz].
    pub rate_hz: f64,
    /// What ran beside the graph, and how it was scheduled.
    pub load: String,
    /// Hop, or `bare, end to end`.
    pub hop: String,
    /// Percentiles [µs]: median, 99 %, 99.9 %, largest.
    pub us: [f64; 4],
    /// Samples lost on the way.
    pub lost: u64,
    /// Deliveries that the writers of the graph counted as dropped.
    pub dropped: u64,
    /// Samples that its readers miss; equal to `dropped`, or a count is wrong.
    pub gaps: u64,
}

/// How a graph is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variant {
    /// A busy thread for every processor.
    pub hog: bool,
    /// SCHED_FIFO priority of every stage.
    pub priority: Option<u8>,
    /// Every stage but the recorder on the last processor, the recorder on the first.
    pub pinned: bool,
}

impl Variant {
    /// Nothing special.
    pub const PLAIN: Self = Self { hog: false, priority: None, pinned: false };

    /// The variants of a run under load: idle, busy, busy with priority, busy with priority and pinning.
    pub fn under_load(priority: u8) -> [Self; 4] {
        let busy = Self { hog: true, ..Self::PLAIN };
        let fifo = Self { priority: Some(priority), ..busy };
        [Self::PLAIN, busy, fifo, Self { pinned: true, ..fifo }]
    }

    fn name(self) -> String {
        let mut parts = vec![if self.hog { "busy processors" } else { "nothing" }.to_owned()];
        parts.extend(self.priority.map(|p| format!("SCHED_FIFO {p}")));
        parts.extend(self.pinned.then(|| "pinned".to_owned()));
        parts.join(", ")
    }

    /// The launch file with this scheduling.
    fn graph_text(self, text: &str) -> Result<String, BenchError> {
        let mut table: toml::Table = toml::from_str(text)?;
        let last = std::thread::available_parallelism().map_or(1, usize::from) - 1;
        let nodes = table.get_mut("node").and_then(toml::Value::as_array_mut).ok_or("the graph has no nodes")?;
        for node in nodes.iter_mut().filter_map(toml::Value::as_table_mut) {
            if let Some(priority) = self.priority {
                node.insert("priority".to_owned(), toml::Value::Integer(priority.into()));
            }
            if self.pinned {
                let ends = node.get("output").is_none();
                let cpu = if ends { 0 } else { last as i64 };
                node.insert("cpus".to_owned(), toml::Value::Array(vec![toml::Value::Integer(cpu)]));
            }
        }
        Ok(toml::to_string(&table)?)
    }
}

/// Runs the live graph and the bare chain for `seconds` at `rate_hz`.
///
/// # Errors
/// If a run fails, or if the counts of its writers and readers do not agree.
pub fn run(
    launch: &Path,
    rate_hz: f64,
    seconds: f64,
    variant: Variant,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, BenchError> {
    let text = launch_file(&launch.join("live.toml"))?;
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    let samples = (rate_hz * seconds) as u64;
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    motion::write_csv(&file("run.csv"), samples, rate_hz)?;
    let load = variant.name();
    let mut rows = Vec::new();
    let _hog = variant.hog.then(Hog::everywhere);
    // The bare chain polls: beside busy processors it would only measure the scheduler.
    if variant == Variant::PLAIN {
        progress(&format!("bare chain at {rate_hz} Hz"));
        let BareResult { p50_us, p99_us, p999_us, max_us, .. } = bare(7, samples, 512, (1e9 / rate_hz) as u64)?;
        let (hop, us) = ("bare chain, end to end".to_owned(), [p50_us, p99_us, p999_us, max_us]);
        rows.push(Row { rate_hz, load: load.clone(), hop, us, lost: 0, dropped: 0, gaps: 0 });
    }
    progress(&format!("live graph at {rate_hz} Hz, {load}"));
    let live = file("live.toml");
    std::fs::write(&live, variant.graph_text(&text)?)?;
    let text = |name: &str| file(name).display().to_string();
    let sets = [
        ("recording", text("run.csv")),
        ("robot", text("robot.toml")),
        ("model", text("model.toml")),
        ("out", text("run.mcap")),
    ];
    let report = graph(&live, &sets)?;
    let file = GraphFile::parse(&std::fs::read_to_string(&live)?)?;
    let edges = balance::edges(&file, &report);
    if let Some(what) = balance::disagreements(&edges).first() {
        return Err(format!("at {rate_hz} Hz, {load}: {what}").into());
    }
    let (dropped, gaps) = edges.iter().fold((0, 0), |(d, g), e| (d + e.dropped, g + e.gaps));
    let lost = report["lost"].as_u64().unwrap_or(0);
    let names: Vec<String> = file.nodes.into_iter().map(|n| n.name).collect();
    let hops = report["nodes"]["recorder"]["latency"].as_array().cloned().unwrap_or_default();
    for hop in hops {
        let value = |key: &str| hop[key].as_f64().unwrap_or(f64::NAN);
        let name = named(hop["hop"].as_str().unwrap_or("?"), &names);
        let us = ["p50_us", "p99_us", "p999_us", "max_us"].map(value);
        rows.push(Row { rate_hz, load: load.clone(), hop: name, us, lost, dropped, gaps });
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
