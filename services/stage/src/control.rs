//! What a stage process tells its supervisor: one JSON object a line on standard output.
//!
//! Any executable that prints these lines and speaks the messages of its edges can stand in a graph.

use serde::{Deserialize, Serialize};
use std::io::Write;

/// Latency percentiles of one hop [µs].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HopLatency {
    /// `source→1`, `1→2`, …, `end to end`: publish of the earlier hop to publish (or reception) of the later.
    pub hop: String,
    /// Median.
    pub p50_us: f64,
    /// 99th percentile.
    pub p99_us: f64,
    /// 99.9th percentile.
    pub p999_us: f64,
    /// Largest.
    pub max_us: f64,
    /// Samples counted.
    pub count: u64,
}

/// Counts of one stage process, final in [`Event::Done`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StageReport {
    /// Samples taken from each input, by topic.
    pub received: std::collections::BTreeMap<String, u64>,
    /// Samples published.
    pub published: u64,
    /// Number of the last sample (sources, and sinks that were started again; of these 32 bits will do).
    pub last_seq: u64,
    /// Deliveries that a live reader could not take (counted by the writer); of a sink, samples that it could not keep.
    pub dropped: u64,
    /// Samples missing in the input sequence (counted by the reader); of several inputs, in the one that lacks most.
    pub missing: u64,
    /// Samples that went by between this node's processes (recorders, which see it by their files).
    #[serde(skip_serializing_if = "is_zero")]
    pub while_down: u64,
    /// Largest resident size of the process [KiB].
    pub peak_rss_kib: u64,
    /// Latency per hop, from processes that end a chain.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub latency: Vec<HopLatency>,
    /// Whatever the stage itself reports (repairs of a reader, messages of a recorder).
    #[serde(skip_serializing_if = "serde_json::Value::is_null")]
    pub details: serde_json::Value,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// Counts of a process that is still running.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gauge {
    /// Deliveries that a live reader could not take, so far; of a sink, samples that it could not keep.
    pub dropped: u64,
    /// Samples missing in the input sequence, so far; of several inputs, in the one that lacks most.
    pub missing: u64,
    /// All flags of the samples handled since the last line ([`lacuna_interfaces::flag`]).
    pub flags: u32,
    /// Since the last line, live only: `in`, from the publication of the stage before to reception here, and
    /// `age`, from the publication of the source to reception here, less the smoother's lag.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub latency: Vec<HopLatency>,
}

/// A line on standard output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// Configuration accepted, ports open.
    Ready,
    /// About twice a second.
    Progress {
        /// Samples handled so far.
        samples: u64,
        /// Share of the input that is done, where the stage knows it.
        fraction: Option<f64>,
        /// Drops, holes, flags and latencies.
        #[serde(default)]
        gauge: Gauge,
    },
    /// After a restart: the first sample was passed on.
    Flowing {
        /// CLOCK_MONOTONIC [ns].
        at_ns: u64,
    },
    /// The stream ended and everything was passed on.
    Done {
        /// Final counts.
        report: StageReport,
    },
    /// The stage cannot go on.
    Failed {
        /// One line: place, what was found, what was expected.
        reason: String,
        /// Exit code that belongs to it: 2 for bad input or use, else 1.
        code: u8,
    },
}

/// What the supervisor tells a process: one line each on its standard input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Order {
    /// To sources: the stream begins, or has begun.
    Go {
        /// When: CLOCK_MONOTONIC [ns].
        began_ns: u64,
        /// After a restart: a number the stream had not reached yet, 0 at its beginning.
        after_seq: u64,
    },
    /// The writer of this topic has left for good; what is in the buffer is the last of it.
    Ended(String),
}

impl Order {
    /// The line, with its end.
    pub fn line(&self) -> String {
        match self {
            Self::Go { began_ns, after_seq } => format!("go {began_ns} {after_seq}\n"),
            Self::Ended(topic) => format!("ended {topic}\n"),
        }
    }

    /// Reads a line; `None` for one that is no order.
    pub fn parse(line: &str) -> Option<Self> {
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["go", ns, seq] => Some(Self::Go { began_ns: ns.parse().ok()?, after_seq: seq.parse().ok()? }),
            ["ended", topic] => Some(Self::Ended((*topic).to_owned())),
            _ => None,
        }
    }
}

impl Event {
    /// Prints the event. A closed standard output (no supervisor left) is not an error of the stage.
    pub fn emit(&self) {
        if let Ok(line) = serde_json::to_string(self) {
            let mut out = std::io::stdout().lock();
            let _ = writeln!(out, "{line}").and_then(|()| out.flush());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_survive_their_line() {
        for order in [Order::Go { began_ns: 123, after_seq: 7 }, Order::Ended("t0".to_owned())] {
            assert_eq!(Order::parse(&order.line()), Some(order));
        }
        for line in ["", "go", "go x", "go 1", "go 1 x", "ended", "stop"] {
            assert_eq!(Order::parse(line), None, "{line}");
        }
    }

    #[test]
    fn lines_of_other_makes_need_no_gauge() {
        let event: Event = serde_json::from_str("{\"event\":\"progress\",\"samples\":3,\"fraction\":null}").unwrap();
        assert_eq!(event, Event::Progress { samples: 3, fraction: None, gauge: Gauge::default() });
    }
}
